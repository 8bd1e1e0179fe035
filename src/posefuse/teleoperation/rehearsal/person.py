"""A made-up operator who stands still but for the arm: exact poses at any time, without cameras."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from posefuse.core.arrays import Array
from posefuse.teleoperation.hands import BODY
from posefuse.teleoperation.values import OperatorView

# of `hands.BODY`, facing +x, both arms hanging; the hand of the moving arm is set by the path
_STANDING = np.array(
    [
        [0.1, 0.0, 1.6], [0.0, 0.2, 1.4], [0.0, -0.2, 1.4], [0.0, 0.25, 1.1], [0.0, -0.25, 1.1], [0.05, 0.27, 0.85],
        [0.05, -0.27, 0.85], [0.0, 0.1, 0.9], [0.0, -0.1, 0.9], [0.0, 0.1, 0.5], [0.0, -0.1, 0.5], [0.0, 0.1, 0.1],
        [0.0, -0.1, 0.1], [0.0, 0.0, 1.4], [0.0, 0.0, 0.9], [0.1, 0.28, 0.65], [0.1, -0.28, 0.65], [0.0, 0.0, 1.75],
        [0.17, 0.1, 0.03], [0.17, -0.1, 0.03],
    ]
)  # fmt: skip
_FOREARM_M = 0.26
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


def person_view(
    hand_xyz: Array,
    t_ns: int,
    *,
    measured_ns: int | None = None,
    shift_m: Array | float = 0.0,
    person_id: int = 1,
    sigma_m: float = 0.01,
) -> OperatorView:
    """The operator with the right hand at (3,), seen well by four cameras; `shift_m` moves all of the person.

    sigma_m: stated standard deviation of the hand.
    """
    body = _STANDING + shift_m
    hand = hand_xyz + shift_m
    body[BODY.index("right_wrist")] = hand
    body[BODY.index("right_fingertips")] = hand + [0.2, 0.0, 0.0]
    body[BODY.index("right_elbow")] = hand - [_FOREARM_M, 0.0, 0.0]
    return OperatorView(
        t_ns=t_ns,
        measured_ns=t_ns if measured_ns is None else measured_ns,
        person_id=person_id,
        xyz_world=hand[None],
        sigma_m=np.array([sigma_m]),
        views=np.array([4]),
        measured=np.array([True]),
        rotation_world=np.full((1, 3, 3), np.nan),
        other_xyz_world=body[[BODY.index("left_wrist")]],
        forearm_m=np.array([_FOREARM_M]),
        body_xyz_world=body,
        body_sigma_m=np.full(len(BODY), 0.01),
        body_measured=np.ones(len(BODY), np.bool_),
    )
