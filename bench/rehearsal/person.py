"""A made-up operator whose whole body is known at any time, and what cameras make of it: exact poses, without images."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from posefuse.core.arrays import Array
from posefuse_teleop.hands import BODY
from posefuse_teleop.values import OperatorView

# of `hands.BODY`, facing +x, both arms hanging; the hands of moving arms are set by paths
_STANDING = np.array(
    [
        [0.1, 0.0, 1.6], [0.0, 0.2, 1.4], [0.0, -0.2, 1.4], [0.0, 0.25, 1.1], [0.0, -0.25, 1.1], [0.05, 0.27, 0.85],
        [0.05, -0.27, 0.85], [0.0, 0.1, 0.9], [0.0, -0.1, 0.9], [0.0, 0.1, 0.5], [0.0, -0.1, 0.5], [0.0, 0.1, 0.1],
        [0.0, -0.1, 0.1], [0.0, 0.0, 1.4], [0.0, 0.0, 0.9], [0.1, 0.28, 0.65], [0.1, -0.28, 0.65], [0.0, 0.0, 1.75],
        [0.17, 0.1, 0.03], [0.17, -0.1, 0.03],
    ]
)  # fmt: skip
_UPPER_ARM_M, _FOREARM_M, _FINGERS_M = 0.31, 0.26, 0.2
HandPath = Callable[[float], Array]


def sine(speed_mps: float, period_s: float = 4.0, centre: Array | None = None) -> HandPath:
    """A hand that goes to and fro in all three directions; its largest speed along x is `speed_mps`."""
    middle = np.array([0.35, -0.25, 1.1]) if centre is None else centre
    reach = speed_mps * period_s / (2 * np.pi)

    def at(t_s: float) -> Array:
        phase = 2 * np.pi * t_s / period_s
        way = np.array([np.sin(phase), 0.4 * np.sin(2 * phase / 3), 0.4 * np.sin(phase / 2)])
        # it begins at rest
        return middle + reach * min(1.0, t_s) ** 2 * way

    return at


@dataclass(frozen=True, kw_only=True)
class Build:
    """Another person: size of the body, and where it stands against the first, m."""

    size: float = 1.0
    away_m: tuple[float, float, float] = (0.0, 0.0, 0.0)


def within_reach(hand: Array, side: str) -> Array:
    """The wrist (3,) of a person who has not walked, drawn to the shoulder where the arm is too short."""
    shoulder = _STANDING[BODY.index(f"{side}_shoulder")]
    far = float(np.linalg.norm(hand - shoulder))
    return shoulder + (hand - shoulder) * min(1.0, 0.98 * (_UPPER_ARM_M + _FOREARM_M) / max(far, 1e-9))


def body_xyz(hands: dict[str, Array], shift_m: Array | float = 0.0, build: Build | None = None) -> Array:
    """(K, 3) keypoints of `hands.BODY`; hands: where the wrists of the moving arms are, of a person who has not walked.

    A hand out of reach has a forearm of the right length all the same.
    """
    body = _STANDING.copy()
    for side, hand in hands.items():
        elbow = _elbow(body[BODY.index(f"{side}_shoulder")], hand)
        body[BODY.index(f"{side}_elbow")], body[BODY.index(f"{side}_wrist")] = elbow, hand
        body[BODY.index(f"{side}_fingertips")] = hand + _FINGERS_M / _FOREARM_M * (hand - elbow)
    build = build or Build()
    return body * build.size + build.away_m + shift_m


def _elbow(shoulder: Array, hand: Array) -> Array:
    """(3,) below the line from shoulder to hand."""
    way = hand - shoulder
    far = max(float(np.linalg.norm(way)), 1e-6)
    along = way / far
    down = np.array([0.0, 0.0, -1.0]) - along * -along[2]
    down = down / max(float(np.linalg.norm(down)), 1e-6)
    # of the right-angled triangles from the elbow to the line; on the line where the hand is out of reach or too near
    back = min(max((far**2 + _FOREARM_M**2 - _UPPER_ARM_M**2) / (2 * far), -_FOREARM_M), _FOREARM_M)
    return hand - back * along + np.sqrt(_FOREARM_M**2 - back**2) * down


def view_of(
    body: Array,
    t_ns: int,
    *,
    measured_ns: int | None = None,
    hands: Sequence[str] = ("right",),
    person_id: int = 1,
    sigma_m: float = 0.01,
) -> OperatorView:
    """A body (K, 3) seen well by four cameras. sigma_m: stated standard deviation of the hands."""
    n = len(hands)
    wrists = [BODY.index(f"{side}_wrist") for side in hands]
    others = [BODY.index(f"{'left' if side == 'right' else 'right'}_wrist") for side in hands]
    elbows = [BODY.index(f"{side}_elbow") for side in hands]
    return OperatorView(
        t_ns=t_ns,
        measured_ns=t_ns if measured_ns is None else measured_ns,
        person_id=person_id,
        xyz_world=body[wrists],
        sigma_m=np.full(n, sigma_m),
        views=np.full(n, 4),
        measured=np.ones(n, np.bool_),
        other_xyz_world=body[others],
        forearm_m=np.linalg.norm(body[wrists] - body[elbows], axis=1),
        body_xyz_world=body,
        body_sigma_m=np.full(len(BODY), 0.01),
        body_measured=np.ones(len(BODY), np.bool_),
    )


def person_view(
    hand_xyz: Array,
    t_ns: int,
    *,
    measured_ns: int | None = None,
    shift_m: Array | float = 0.0,
    person_id: int = 1,
    sigma_m: float = 0.01,
) -> OperatorView:
    """The operator with the right hand at (3,) and the forearm along x; `shift_m` moves all of the person."""
    body = body_xyz({"right": hand_xyz}, shift_m)
    for name, ahead_m in (("right_elbow", -_FOREARM_M), ("right_fingertips", _FINGERS_M)):
        body[BODY.index(name)] = body[BODY.index("right_wrist")] + [ahead_m, 0.0, 0.0]
    return view_of(body, t_ns, measured_ns=measured_ns, person_id=person_id, sigma_m=sigma_m)


def hidden(view: OperatorView, keypoints: Sequence[int], hands: Sequence[str] = ("right",)) -> OperatorView:
    """The view without some keypoints: neither measured nor predicted."""
    gone = np.isin(np.arange(len(BODY)), keypoints)
    hand = np.array([gone[BODY.index(f"{side}_wrist")] or gone[BODY.index(f"{side}_elbow")] for side in hands])
    return replace(
        view,
        body_xyz_world=np.where(gone[:, None], np.nan, view.body_xyz_world),
        body_measured=view.body_measured & ~gone,
        xyz_world=np.where(hand[:, None], np.nan, view.xyz_world),
        measured=view.measured & ~hand,
        forearm_m=np.where(hand, np.nan, view.forearm_m),
    )
