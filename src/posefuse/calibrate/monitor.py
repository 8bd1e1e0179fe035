"""Watch a rig while it is used: a bumped camera, a swapped cable or a lost synchronisation shows in its residuals.

A pure function of an explicit state: `observe` takes what fusion has just used and returns the next state and what it
found. A 2D network errs by many px, but differently from keypoint to keypoint, so single residuals tell little. What all
keypoints of a camera share over some seconds tells: a shift is a camera that looks elsewhere, a lag behind the motion is
its clock.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from posefuse.core import Rig
from posefuse.core.arrays import Array

from .world import meeting_points, triangulate

_MEMORY_S = 2.0
_SURE_AFTER_S = 1.5
_WARM_UP_S = 5.0
_LEAST_POINTS = 60
# rendered people and the default network stay well below this with nothing wrong
_SHIFTED_PX_PER_1000, _LATE_S, _WILD_SHARE = 5.0, 0.03, 0.5
# one wild keypoint must not speak for the camera; a fast one may for its clock
_MOST_PX_PER_1000, _MOST_LATE_PX_PER_1000 = 15.0, 60.0
_LEAST_SPEED_PX_S = 40.0
_SWAP_GAIN, _SUSPECT_SHARE = 0.5, 0.5
# faster than any image is crossed
_FASTEST_PX_S = 1e4


@dataclass(frozen=True, eq=False)
class MonitorState:
    """What is remembered: sums that decay, per camera.

    Attributes:
        t_ns: of the newest observation; None before the first. started_ns: of the first.
        points: (C,) count of residuals. shift: (C, 2) their sum, px, long ones cut short. wild: (C,) how many were.
        late, speed: (C,) sums of residual against velocity, and of squared velocity.
        rest: (C,) mean of how well the others agree without this camera, px; NaN where that cannot be known.
        wrong_since_ns: when residuals began to be too large; None while they are not.
        told: a finding was reported and still goes on.
    """

    t_ns: int | None
    started_ns: int | None
    points: Array
    shift: Array
    wild: Array
    late: Array
    speed: Array
    rest: Array
    last_xy: Array | None = None
    last_t_ns: int = 0
    wrong_since_ns: int | None = None
    told: bool = False


@dataclass(frozen=True)
class Finding:
    """Something is wrong with a camera.

    Attributes:
        kind: ``bumped``, ``out of step`` or ``swapped``. cameras: which. t_ns: when it was noticed.
        detail: one line with numbers.
    """

    kind: str
    cameras: tuple[str, ...]
    t_ns: int
    detail: str


def start(rig: Rig) -> MonitorState:
    """Nothing seen yet."""
    zero = np.zeros(len(rig))
    return MonitorState(None, None, zero, np.zeros((len(rig), 2)), zero, zero, zero, np.full(len(rig), np.nan))


def observe(state: MonitorState, rig: Rig, t_ns: int, xy_img: Array) -> tuple[MonitorState, list[Finding]]:
    """Take in matched points (C, P, 2) raw px of one instant (NaN where unseen); P stays the same from call to call."""
    passed_s = 0.0 if state.t_ns is None else max((t_ns - state.t_ns) / 1e9, 0.0)
    keep = float(np.exp(-passed_s / _MEMORY_S))
    residual, rest_px = leave_one_out(rig, xy_img)
    size = _sizes_px(rig)[:, None] / 1000
    short, longer = (_no_longer_than(residual, most * size) for most in (_MOST_PX_PER_1000, _MOST_LATE_PX_PER_1000))
    velocity = _no_longer_than(_velocity(state, t_ns, xy_img), np.array(_FASTEST_PX_S))
    good = np.isfinite(short).all(axis=-1)
    wild = good & (np.hypot(short[..., 0], short[..., 1]) > 0.99 * _MOST_PX_PER_1000 * size)
    moving = good & np.isfinite(velocity).all(axis=-1)
    late = np.where(moving, (longer * velocity).sum(axis=-1), 0.0)
    speed = np.where(moving, (velocity**2).sum(axis=-1), 0.0)
    new = replace(
        state,
        t_ns=t_ns,
        started_ns=t_ns if state.started_ns is None else state.started_ns,
        points=keep * state.points + good.sum(axis=1),
        shift=keep * state.shift + np.where(good[..., None], short, 0.0).sum(axis=1),
        wild=keep * state.wild + wild.sum(axis=1),
        late=keep * state.late + late.sum(axis=1),
        speed=keep * state.speed + speed.sum(axis=1),
        rest=_decayed(state.rest, rest_px, keep),
        last_xy=np.array(xy_img, np.float64),
        last_t_ns=t_ns,
    )
    return _judge(new, rig, xy_img)


def leave_one_out(rig: Rig, xy_img: Array) -> tuple[Array, Array]:
    """What the other cameras say, camera by camera.

    Returns:
        (C, P, 2) reprojection of the points of all others, minus what the camera saw; NaN with fewer than 2 others.
        (C,) median px to which the others agree among themselves when this camera is left out; NaN with fewer than 3 of them.
    """
    out, rest_px = np.full(xy_img.shape, np.nan), np.full(len(rig), np.nan)
    norm = np.stack([camera.norm_from_px(xy) for camera, xy in zip(rig, xy_img, strict=True)])
    for c in range(len(rig)):
        mine = np.arange(len(rig)) == c
        points = meeting_points(rig, np.where(mine[:, None, None], np.nan, norm))
        apart = rig.project(points) - xy_img
        out[c] = apart[c]
        off = np.hypot(*np.moveaxis(apart[~mine], -1, 0))
        if np.isfinite(off).sum() > 2 * np.isfinite(points[:, 0]).sum():
            rest_px[c] = np.nanmedian(off)
    return out, rest_px


def _no_longer_than(xy: Array, most_px: Array) -> Array:
    """Vectors (..., 2) cut to a length (...): points on the horizon project to numbers too large to square."""
    length = np.hypot(xy[..., 0], xy[..., 1])
    return np.asarray(xy * np.minimum(1.0, most_px / np.maximum(length, 1e-9))[..., None])


def _decayed(old: Array, new: Array, keep: float) -> Array:
    """Running mean that starts with the first value known and stays where there is no new one."""
    mixed = keep * old + (1 - keep) * new
    return np.asarray(np.where(np.isnan(old), new, np.where(np.isnan(new), old, mixed)))


def _velocity(state: MonitorState, t_ns: int, xy_img: Array) -> Array:
    if state.last_xy is None or state.last_xy.shape != xy_img.shape or t_ns <= state.last_t_ns:
        return np.full(xy_img.shape, np.nan)
    return np.asarray((xy_img - state.last_xy) / ((t_ns - state.last_t_ns) / 1e9))


def _sizes_px(rig: Rig) -> Array:
    """(C,) longer side of every image."""
    return np.array([max(camera.size_wh) for camera in rig], np.float64)


def _judge(state: MonitorState, rig: Rig, xy_img: Array) -> tuple[MonitorState, list[Finding]]:
    assert state.t_ns is not None and state.started_ns is not None
    many, moving = state.points >= _LEAST_POINTS, state.speed > _LEAST_POINTS * _LEAST_SPEED_PX_S**2
    shift_px = np.linalg.norm(state.shift, axis=1) / np.maximum(state.points, 1) * many
    late_s = np.where(moving, state.late / np.where(moving, state.speed, 1.0), 0.0)
    wild = state.wild / np.maximum(state.points, 1) * many
    shifted = shift_px / (_SHIFTED_PX_PER_1000 * _sizes_px(rig) / 1000)
    over = np.max([shifted, np.abs(late_s) / _LATE_S, wild / _WILD_SHARE], axis=0)
    if (state.t_ns - state.started_ns) / 1e9 < _WARM_UP_S or over.max(initial=0.0) <= 1:
        return replace(state, told=False, wrong_since_ns=None), []
    if state.wrong_since_ns is None:
        return replace(state, wrong_since_ns=state.t_ns), []
    # the memory must be filled by what is wrong before the kind of it can be told
    if state.told or (state.t_ns - state.wrong_since_ns) / 1e9 < _SURE_AFTER_S:
        return state, []
    return replace(state, told=True), [_finding(state, rig, xy_img, shift_px, late_s, over)]


def _finding(state: MonitorState, rig: Rig, xy_img: Array, shift_px: Array, late_s: Array, over: Array) -> Finding:
    """The one cause that explains most.

    A bad camera also spoils the residuals of the others; it is the one without which the others agree best.
    """
    t_ns = state.t_ns or 0
    swapped = _swap(rig, xy_img)
    if swapped is not None:
        a, b = (rig.names[i] for i in swapped)
        return Finding("swapped", (a, b), t_ns, f"the images of {a} and {b} fit when they are exchanged: a swapped cable")
    rest = np.where(over > _SUSPECT_SHARE * over.max(), state.rest, np.nan)
    worst = int(np.nanargmin(rest)) if np.isfinite(rest).any() else int(np.argmax(over))
    name = rig.names[worst]
    # what follows the motion is a clock, what stays is a pose: whichever takes more out of the squares
    if late_s[worst] ** 2 * state.speed[worst] > shift_px[worst] ** 2 * state.points[worst]:
        return Finding(
            "out of step", (name,), t_ns, f"{name} is out of step: its images lag by about {late_s[worst] * 1e3:+.0f} ms"
        )
    beside = f"{name} sees everything {shift_px[worst]:.0f} px or more beside where the others do"
    return Finding("bumped", (name,), t_ns, f"{beside}: it was moved since it was calibrated")


def _swap(rig: Rig, xy_img: Array) -> tuple[int, int] | None:
    """The two cameras whose exchange brings the points together, if any does."""
    if len(rig) < 3:
        return None
    now = _misfit(rig, xy_img)
    best: tuple[float, tuple[int, int]] | None = None
    for a in range(len(rig)):
        for b in range(a + 1, len(rig)):
            if rig.cameras[a].size_wh != rig.cameras[b].size_wh:
                continue
            order = np.arange(len(rig))
            order[[a, b]] = b, a
            other = _misfit(rig, xy_img[order])
            if np.isfinite(other) and (best is None or other < best[0]):
                best = (other, (a, b))
    return best[1] if best is not None and best[0] < _SWAP_GAIN * now else None


def _misfit(rig: Rig, xy_img: Array) -> float:
    """Median distance in px of seen points to the reprojection of all."""
    off = np.linalg.norm(rig.project(triangulate(rig, xy_img)) - xy_img, axis=-1)
    return float(np.nanmedian(off)) if np.isfinite(off).any() else float("nan")
