"""Motions of one hand of a standing person: reaching for points, and following a path."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from posefuse.core import ConfigError
from posefuse.core.arrays import Array
from posefuse.core.skeleton import ANATOMICAL23
from posefuse.simulation.body import SimulatedBody

from .limbs import bend_arm, forearm_and_hand, lengths_m, unit_vectors
from .posture import BodyPosture, bones_of
from .settings import HandPathSettings, ReachSettings
from .standing import EASY_PRONATION_RAD, SIDES, Ease, Footing, easy_arm, leaned, minimum_jerk

# the shoulder girdle follows the arm, and the arm the girdle: each round leaves about a fifth of the error
_GIRDLE_ROUNDS = 8
_OFF_PATH_M = 0.002
_HAND_PRONATION_RAD = np.deg2rad(110.0)


def reach(body: SimulatedBody, settings: ReachSettings, seed: int) -> Callable[[Array], BodyPosture]:
    """From the side of the thigh to a point, a short stop, and back; straight in space with one smooth push of speed."""
    footing = Footing(body, np.deg2rad(settings.heading_deg), np.array(settings.position_m))
    sway = Ease(np.random.default_rng(seed), 1.0)
    side = settings.side

    def posture(t_s: Array) -> BodyPosture:
        centre, axes = sway.applied(footing, t_s)
        cycle = np.floor(t_s / settings.period_s)
        out = _there_and_back(t_s / settings.period_s - cycle)
        targets = {c: _target(seed, int(c), side) for c in np.unique(cycle)}
        target = np.stack([targets[c] for c in cycle])
        thorax = leaned(axes["thorax"], 0.12 * out, 0.0, (0.18 if side == "right" else -0.18) * out)
        axes = axes | {"thorax": thorax}
        for s in SIDES:
            axes |= easy_arm(body, s, thorax)
        axes |= _reaching_arm(body, axes, side, out, target)
        return BodyPosture(centre, axes, np.zeros((len(t_s), 2)))

    return posture


def hand_path(body: SimulatedBody, settings: HandPathSettings, seed: int) -> Callable[[Array], BodyPosture]:
    """The wrist at the points of a path at their times, by minimum-jerk moves between them; all the rest of the body at ease.

    Raises:
        ConfigError: times that do not increase, or a point out of the arm's reach.
    """
    footing = Footing(body, np.deg2rad(settings.heading_deg), np.array(settings.position_m))
    sway = Ease(np.random.default_rng(seed), settings.sway)
    rows = np.array(settings.path, np.float64)
    if (np.diff(rows[:, 0]) <= 0).any():
        raise ConfigError("motion: hand_path: path: expected times that increase from row to row")
    # X ahead, Y up, Z right -> ahead, left, up
    base = footing.base()
    places = np.array([*footing.place, 0.0]) + rows[:, 1:] @ np.stack([base[:, 0], -base[:, 2], base[:, 1]])
    side = settings.side

    def posture(t_s: Array) -> BodyPosture:
        centre, axes = sway.applied(footing, t_s)
        wanted = waypoint_path(rows[:, 0], places, t_s)
        return _with_wrist_at(body, BodyPosture(centre, axes, np.zeros((len(t_s), 2))), side, wanted)

    _check_reach(body, posture, rows, places, side)
    return posture


def waypoint_path(t_s: Array, places: Array, at_s: Array) -> Array:
    """(T, 3) at times (T,) between places (N, 3) at times (N,): minimum-jerk moves, at rest before and after them."""
    i = np.clip(np.searchsorted(t_s, at_s, side="right") - 1, 0, len(t_s) - 1)
    after = np.minimum(i + 1, len(t_s) - 1)
    lasts = np.where(after > i, t_s[after] - t_s[i], 1.0)
    share = minimum_jerk((at_s - t_s[i]) / lasts) * (after > i)
    return np.asarray(places[i] + share[:, None] * (places[after] - places[i]))


def _with_wrist_at(body: SimulatedBody, easy: BodyPosture, side: str, wanted: Array) -> BodyPosture:
    axes = dict(easy.axes_world)
    lengths = lengths_m(body, side, "arm")
    thorax = axes["thorax"]
    outward = thorax[..., 2] * (1.0 if side == "right" else -1.0)
    elbow_side = unit_vectors(-thorax[..., 1] * 0.9 + outward * 0.45 - thorax[..., 0] * 0.3)
    pronation = np.full(len(wanted), _HAND_PRONATION_RAD)
    posture = easy
    for _ in range(_GIRDLE_ROUNDS):
        shoulder = _keypoint(body, posture, f"{side}_shoulder")
        upper, lower = bend_arm(shoulder, wanted, elbow_side, lengths)
        bend = np.arccos(np.clip(np.sum(upper[..., 1] * lower[..., 1], axis=-1), -1, 1))
        forearm, hand = forearm_and_hand(body, side, upper, bend, pronation)
        axes |= {f"{side}_upper_arm": upper, f"{side}_forearm": forearm, f"{side}_hand": hand}
        posture = BodyPosture(easy.centre_world, dict(axes), easy.toes_up_rad)
    return posture


def _keypoint(body: SimulatedBody, posture: BodyPosture, name: str) -> Array:
    return np.asarray(body.keypoints(bones_of(body, posture))[:, ANATOMICAL23.index(name)])


def _check_reach(body: SimulatedBody, posture: Callable[[Array], BodyPosture], rows: Array, places: Array, side: str) -> None:
    """Moves are straight: between two points within reach the wrist stays within reach of the front of the body."""
    off = np.linalg.norm(_keypoint(body, posture(rows[:, 0]), f"{side}_wrist") - places, axis=-1)
    worst = int(np.argmax(off))
    if off[worst] > _OFF_PATH_M:
        raise ConfigError(
            f"motion: hand_path: path: the {side} wrist does not reach {rows[worst, 1:].tolist()} (ahead, left, up, m); "
            f"it stays {100 * off[worst]:.0f} cm away"
        )


def _reaching_arm(body: SimulatedBody, axes: dict[str, Array], side: str, out: Array, target: Array) -> dict[str, Array]:
    """The arm between hanging (out 0) and the wrist at `target` (T, 3), in arm lengths from the shoulder in thorax axes."""
    thorax, upper, lower = axes["thorax"], axes[f"{side}_upper_arm"], axes[f"{side}_forearm"]
    lengths = lengths_m(body, side, "arm")
    hanging = -lengths[0] * upper[..., 1] - lengths[1] * lower[..., 1]
    there = (thorax @ target[..., None])[..., 0] * sum(lengths)
    ahead = thorax[..., 0] * (0.35 * sum(lengths) * np.sin(np.pi * out) ** 2)[:, None]
    wrist = hanging + out[:, None] * (there - hanging) + ahead * 0.5
    start = np.zeros_like(wrist)
    outward = thorax[..., 2] * (1.0 if side == "right" else -1.0)
    elbow_side = unit_vectors(-thorax[..., 1] * 0.9 + outward * 0.45 - thorax[..., 0] * (1.2 - out)[:, None])
    upper, _ = bend_arm(start, wrist, elbow_side, lengths)
    middle = -lengths[0] * upper[..., 1]
    bend = np.arccos(np.clip(np.sum(unit_vectors(wrist - middle) * unit_vectors(middle), axis=-1), -1, 1))
    pronation = EASY_PRONATION_RAD + (np.deg2rad(110) - EASY_PRONATION_RAD) * out
    forearm, hand = forearm_and_hand(body, side, upper, bend, pronation)
    return {f"{side}_upper_arm": upper, f"{side}_forearm": forearm, f"{side}_hand": hand}


def _target(seed: int, cycle: int, side: str) -> Array:
    """(3,) of one reach, in arm lengths from the shoulder in thorax axes: ahead, between waist and eyes."""
    rng = np.random.default_rng([seed, cycle & 0xFFFFFFFF])
    across = rng.uniform(-0.35, 0.4) * (1.0 if side == "right" else -1.0)
    direction = unit_vectors(np.array([1.0, rng.uniform(-0.45, 0.35), across]))
    return direction * rng.uniform(0.78, 0.93)


def _there_and_back(part: Array) -> Array:
    """0 -> 1 -> 0 over one period by two minimum-jerk moves (Flash & Hogan 1985) with a stop between and after."""
    go, stay, back = 0.35, 0.5, 0.85
    return minimum_jerk(part / go) - minimum_jerk((part - stay) / (back - stay))
