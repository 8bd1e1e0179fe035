"""The two halves of a recording, solved separately and compared with each other and with the whole."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from posefuse.calibration.report import Check
from posefuse.calibration.targets.corners import CornerObservations
from posefuse.calibration.targets.kinds import Target
from posefuse.core import Camera
from posefuse.core.arrays import Array

from .limits import Limits
from .pipeline import TIME_STEPS, Options, Solved, key_snapshots, link, solve_linked
from .self_checks import camera_differences, check_halves, position_sigma_m
from .snapshots import middle_ns

_HALVES = 2


@dataclass(frozen=True, eq=False)
class Halves:
    """Two solves that share no data.

    Attributes:
        solved: of each half; empty where the data are not enough. story: why.
        together, apart: (2, C) px usual size of each half's residuals in the common solve, and in the half's own.
    """

    solved: tuple[Solved, ...]
    story: str
    together: Array
    apart: Array


def solve_halves(
    observations: CornerObservations, cameras: tuple[Camera, ...], target: Target, options: Options, solved: Solved
) -> Halves:
    """The first and the second half from scratch; where a camera lacks one, every other fifth of them."""
    story = ""
    for stretches in (_HALVES, 5 * _HALVES):
        found: list[Solved] = []
        for half in range(_HALVES):
            part = observations.rows(_half_of(observations.t_ns, observations, stretches) == half)
            one, story = _solve_half(part, cameras, target, options, solved)
            if one is None:
                break
            found.append(one)
        if len(found) == _HALVES:
            steps_ns = np.round(solved.seen.t_s * 1e9).astype(np.int64) + middle_ns(observations)
            half_of = _half_of(steps_ns, observations, stretches)
            together = np.stack([spread_px(solved, half_of == half, len(cameras)) for half in range(_HALVES)])
            apart = np.stack([spread_px(one, np.ones(len(one.seen.t_s), bool), len(cameras)) for one in found])
            return Halves(tuple(found), "", together, apart)
    nothing = np.full((_HALVES, len(cameras)), np.nan)
    return Halves((), story, nothing, nothing)


def half_checks(cameras: Sequence[Camera], solved: Solved, halves: Halves, distance_m: float, limits: Limits) -> list[Check]:
    """The halves put the cameras at the same places, and one rig fits both."""
    if not halves.solved:
        return [
            Check("halves agree", False, f"half of the data is not enough to solve: {halves.story}",
                  "wave the target longer, so that every camera sees it in both halves")
        ]  # fmt: skip
    first, second = (one.solution.state.cam_from_world for one in halves.solved)
    return [
        check_halves(cameras, (first, second), position_sigma_m(solved), distance_m, limits),
        check_one_place(cameras, halves, distance_m, limits),
    ]


def check_one_place(cameras: Sequence[Camera], halves: Halves, distance_m: float, limits: Limits) -> Check:
    """One rig fits both halves as well as each fits its own, or the difference is none of the poses.

    Larger residuals alone refuse nothing: uneven time stamps, or a lens model that fits one region better, also cause them.
    A camera that was moved has poses that differ by more than their standard errors.
    """
    ratio = np.nan_to_num(halves.together / np.maximum(halves.apart, 1e-6), nan=1.0).max(axis=0)
    first, second = (one.solution for one in halves.solved)
    apart_m, turned_rad = camera_differences(first.state.cam_from_world, second.state.cam_from_world)
    sigma_m = np.hypot(*(position_sigma_m(one) for one in halves.solved))
    sigma_rad = np.sqrt(sum(np.trace(one.camera_covariance[:, :3, :3], axis1=1, axis2=2) for one in (first, second)))
    sigma_m, sigma_rad = _shared(sigma_m), _shared(sigma_rad)

    def moved(sigma: float, share: float, angle_rad: float) -> Array:
        shifted = apart_m > np.maximum(share * distance_m, sigma * sigma_m)
        return np.asarray(shifted | (turned_rad > np.maximum(angle_rad, sigma * sigma_rad)))

    wrong = (ratio > limits.spread_ratio) & moved(limits.moved_sigma, limits.moved_share, limits.moved_rad)
    wrong |= (ratio > limits.strong_ratio) & moved(limits.strong_sigma, limits.moved_share, limits.moved_rad)
    wrong |= (ratio > limits.certain_ratio) & moved(limits.certain_sigma, limits.certain_share, limits.certain_rad)
    # a camera that turns all the time makes stretches scatter, and standard errors large with them
    wrong |= (ratio > limits.spread_ratio) & moved(0.0, limits.effect_share, limits.effect_share)
    c = int(np.argmax(np.where(wrong, 1e3, 1.0) * ratio))
    return Check(
        "one place per camera", not wrong.any(),
        f"{cameras[c].name}'s corners spread {ratio[c]:.2f} times as far in one rig for the whole recording as in one for each"
        f" half (limit {limits.spread_ratio:.2f} where poses differ too, {limits.certain_ratio:.2f} where they clearly do), and"
        f" its pose differs between the halves by {apart_m[c] * 1e3:.1f} ± {sigma_m[c] * 1e3:.1f} mm and"
        f" {np.rad2deg(turned_rad[c]):.2f} ± {np.rad2deg(sigma_rad[c]):.2f} deg",
        "it was moved or refocused during the recording: calibrate again, or use the part before or after",
    )  # fmt: skip


def _shared(sigma: Array) -> Array:
    """Standard errors (C,) with the reference camera's, which is held at 0, as that of a usual camera."""
    return np.maximum(sigma, float(np.median(sigma[sigma > 0])) if (sigma > 0).any() else 0.0)


def spread_px(solved: Solved, steps: Array, cameras: int) -> Array:
    """(C,) median size of a corner's residual at some of the time steps; NaN where there are none."""
    size = np.linalg.norm(solved.solution.residual_px, axis=1)
    rows = steps[solved.seen.time_step] & np.isfinite(size)
    mine = [rows & (solved.seen.camera == c) for c in range(cameras)]
    return np.array([np.median(size[m]) if m.any() else np.nan for m in mine])


def _half_of(t_ns: Array, observations: CornerObservations, count: int) -> Array:
    """0 or 1 by turns along `count` stretches of the recording."""
    first, last = int(observations.t_ns.min()), int(observations.t_ns.max()) + 1
    return np.asarray((t_ns - first) * count // (last - first) % _HALVES)


def _solve_half(
    part: CornerObservations, cameras: tuple[Camera, ...], target: Target, options: Options, solved: Solved
) -> tuple[Solved | None, str]:
    delay_s = solved.solution.state.delay_s
    together = replace(options, clocks="together", time_steps=max(options.time_steps // 2, min(options.time_steps, TIME_STEPS)))
    if set(np.unique(part.camera)) != set(range(len(cameras))):
        return None, "a camera sees nothing in it"
    seen = key_snapshots(part, together, delay_s)
    if len(seen.camera) == 0:
        return None, "no shared views"
    links = link(cameras, target, seen)
    if len(links.placed) < len(cameras):
        lost = [camera.name for i, camera in enumerate(cameras) if i not in links.placed]
        return None, f"{', '.join(lost)} not linked"
    return solve_linked(part, cameras, target, together, links, delay_s), ""
