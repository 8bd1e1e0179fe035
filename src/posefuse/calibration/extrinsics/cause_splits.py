"""Explanations in time: a camera that was moved, a clock that jumped."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from posefuse.calibration.report import CheckKind
from posefuse.calibration.solving.projection import Lenses
from posefuse.calibration.solving.rotations import Poses, angle_between
from posefuse.core.arrays import Array

from .causes import CauseTrial, Trouble, near_solve
from .clocks import rough_offsets
from .pipeline import Solved
from .prop_solve import Freedom, PropSolution
from .snapshots import Snapshots, middle_ns, snapshots

_CANDIDATES, _STILL_LARGER = 2, 1.5
_LEAST_STEPS = 6
_LEAST_JUMP_S, _SIGMA = 0.005, 5.0


def moved_or_jumped(trouble: Trouble) -> Iterator[CauseTrial]:
    """One camera has another pose and clock from some time step on."""
    solved = trouble.solved
    if solved is None:
        return
    changes = [(_change_step(solved, c)[0], c) for c in range(len(trouble.cameras))]
    for _, c in sorted(changes, reverse=True)[:_CANDIDATES]:
        # the refused solution lies between before and after, and so do its residuals: they do not show the time
        others = _solved_by_others(trouble, solved, c)
        step = _change_step(others, c)[1]
        if step >= 0:
            yield from _split(trouble, others, c, step)


def _solved_by_others(trouble: Trouble, solved: Solved, c: int) -> Solved:
    """The solution of the other cameras; with the residuals of camera `c` there, whose pose and clock stay as they were."""
    seen, rows = solved.seen, solved.seen.camera == c
    reference = solved.links.reference if solved.links.reference != c else int(c == 0)
    moving = tuple(i for i in range(len(trouble.cameras)) if i not in (c, reference))
    freedom = Freedom(reference=reference, held_patches=solved.links.shape.held, moving=moving)
    found = near_solve(replace(solved, seen=seen.rows(~rows)), trouble.cameras, solved.solution.state, freedom)
    state, camera, patch = found.state, seen.camera[rows], seen.patch[rows]
    xyz_prop = state.prop_from_patch[patch].move(solved.corners[patch, seen.corner[rows]])
    xyz_cam = state.cam_from_world[camera].move(state.world_from_prop[seen.time_step[rows]].move(xyz_prop))
    residual_px = np.empty_like(solved.solution.residual_px)
    residual_px[~rows] = found.residual_px
    residual_px[rows] = Lenses(trouble.cameras, state.lens_delta).px(camera, xyz_cam) - seen.xy_img[rows]
    return replace(solved, solution=replace(found, residual_px=residual_px))


def _change_step(solved: Solved, c: int) -> tuple[float, int]:
    """How much better two stretches of one camera's residuals are explained apart, and the time step where they part."""
    steps, x, y, v, weight = _camera_means(solved, c)
    if len(steps) < 2 * _LEAST_STEPS:
        return 0.0, -1

    def cumulated(values: Array) -> Array:
        return np.cumsum(weight * values)

    # residual = a + b * velocity, before and after: squares from running sums
    sums = {name: cumulated(value) for name, value in {
        "n": np.ones(len(steps)), "x": x, "y": y, "xx": x**2 + y**2, "vx": v[:, 0], "vy": v[:, 1], "vv": (v**2).sum(axis=1),
        "xv": x * v[:, 0] + y * v[:, 1]}.items()}  # fmt: skip

    def left(one: dict[str, Array]) -> Array:
        n = np.maximum(one["n"], 1e-9)
        vv = one["vv"] - (one["vx"] ** 2 + one["vy"] ** 2) / n
        xv = one["xv"] - (one["x"] * one["vx"] + one["y"] * one["vy"]) / n
        xx = one["xx"] - (one["x"] ** 2 + one["y"] ** 2) / n
        return np.asarray(xx - xv**2 / np.maximum(vv, 1e-9))

    last = {name: value[-1] - value for name, value in sums.items()}
    both = left(sums) + left(last)
    inner = slice(_LEAST_STEPS - 1, len(steps) - _LEAST_STEPS)
    best = int(np.argmin(both[inner])) + _LEAST_STEPS - 1
    whole = float(left({name: value[-1:] for name, value in sums.items()})[0])
    return whole - float(both[best]), int(steps[best + 1])


def _camera_means(solved: Solved, c: int) -> tuple[Array, Array, Array, Array, Array]:
    """Per time step of a camera: number, mean residual x and y, mean velocity (n, 2), and a robust weight."""
    seen, residual = solved.seen, solved.solution.residual_px
    rows = (seen.camera == c) & np.isfinite(residual).all(axis=1)
    steps, place, count = np.unique(seen.time_step[rows], return_inverse=True, return_counts=True)
    mean = np.stack([np.bincount(place, residual[rows, k], len(steps)) / count for k in (0, 1)], axis=1)
    velocity = np.stack([np.bincount(place, seen.velocity_px_s[rows, k], len(steps)) / count for k in (0, 1)], axis=1)
    size = np.linalg.norm(mean, axis=1)
    cut = max(3 * float(np.median(size)), 1.0) if len(size) else 1.0
    clipped = mean * np.minimum(1.0, 4 * cut / np.maximum(size, 1e-9))[:, None]
    return steps, clipped[:, 0], clipped[:, 1], velocity / 100.0, np.ones(len(steps))


def _split(trouble: Trouble, solved: Solved, c: int, step: int) -> Iterator[CauseTrial]:
    """Solve with the camera taken as two, before and after the step."""
    t_s = float(solved.seen.t_s[step])
    start_s = middle_ns(trouble.observations) / 1e9 - trouble.observations.t_ns.min() / 1e9
    apart, solution = _solve_split(trouble, solved, c, t_s)
    mine = np.isin(apart.seen.camera, (c, len(trouble.cameras)))
    if _size(solution, mine) > _STILL_LARGER * _size(solution, ~mine):
        # a jump of the clock beyond what the motion of the corners extrapolates to
        clocks_s = _rough_clocks_s(trouble, solved, c, t_s)
        if clocks_s is not None:
            again = _solve_split(trouble, solved, c, t_s, clocks_s)
            apart, solution = min(((apart, solution), again), key=lambda one: _size(one[1]))
    words, remedy, frees, kind = _split_story(trouble, solution, c, t_s + start_s, apart)
    camera = np.where(apart.seen.camera == len(trouble.cameras), c, apart.seen.camera)
    lost = max(len(solved.seen.camera) - len(camera), 0)
    yield CauseTrial(words, remedy, camera, solution.residual_px, lost, frees, kind=kind)


def _size(solution: PropSolution, rows: Array | slice = slice(None)) -> float:
    """Usual residual, large ones counting little."""
    return float(np.nanmean(np.log1p((solution.residual_px[rows] ** 2).sum(axis=1))))


def _rough_clocks_s(trouble: Trouble, solved: Solved, c: int, t_s: float) -> tuple[float, float] | None:
    """The camera's clock before and after a time, from the paths of the target; None where they do not determine it."""
    seen = trouble.observations
    late = seen.t_ns - middle_ns(seen) >= t_s * 1e9
    views = np.bincount(seen.camera, minlength=len(trouble.cameras))
    other = int(np.argmax(np.where(np.arange(len(trouble.cameras)) == c, -1, views)))
    clocks_s = []
    for part in (~late, late):
        pair = seen.rows(part & np.isin(seen.camera, (c, other)))
        if len(pair) == 0:
            return None
        found = rough_offsets(pair, trouble.cameras, trouble.target)
        clocks_s.append(float(solved.solution.state.delay_s[other, 0] + found[c] - found[other]))
    return (clocks_s[0], clocks_s[1]) if np.isfinite(clocks_s).all() else None


def _solve_split(
    trouble: Trouble,
    solved: Solved,
    c: int,
    t_s: float,
    clocks_s: tuple[float, float] | None = None,
) -> tuple[Solved, PropSolution]:
    """With the camera taken as two, before and after `t_s`, and their clocks; None starts from the clock that it has."""
    cameras = (*trouble.cameras, replace(trouble.cameras[c], name=f"{trouble.cameras[c].name} later"))
    seen, state, count = solved.seen, solved.solution.state, len(trouble.cameras)
    delay = np.concatenate([state.delay_s, state.delay_s[c : c + 1]])
    if clocks_s is not None:
        delay[[c, count], 0] = clocks_s
        seen = _read_again(trouble, solved, delay, c, t_s)
    else:
        seen = replace(seen, camera=np.where((seen.camera == c) & (seen.t_s[seen.time_step] >= t_s), count, seen.camera))
    seen = seen.rows(np.arange(len(seen.camera)) >= 0)
    pose = state.cam_from_world
    start = replace(
        state, cam_from_world=Poses(np.concatenate([pose.R, pose.R[c : c + 1]]), np.concatenate([pose.t, pose.t[c : c + 1]])),
        delay_s=delay, lens_delta=np.concatenate([state.lens_delta, state.lens_delta[c : c + 1]]),
    )  # fmt: skip
    apart = replace(solved, seen=seen)
    freedom = Freedom(reference=solved.links.reference, held_patches=solved.links.shape.held, offset=True)
    return apart, near_solve(apart, cameras, start, freedom)


def _read_again(trouble: Trouble, solved: Solved, delay: Array, c: int, t_s: float) -> Snapshots:
    """The corners at the same time steps, with the camera taken as two whose clocks differ."""
    seen, count = trouble.observations, len(trouble.cameras)
    late = (seen.camera == c) & (seen.t_ns - middle_ns(seen) >= t_s * 1e9)
    two = replace(
        seen, cameras=(*seen.cameras, f"{seen.cameras[c]} later"), sizes_wh=(*seen.sizes_wh, seen.sizes_wh[c]),
        frame_count=(*seen.frame_count, seen.frame_count[c]), camera=np.where(late, count, seen.camera),
    )  # fmt: skip
    steps_ns = np.round(solved.seen.t_s * 1e9).astype(np.int64) + middle_ns(seen)
    again = snapshots(two, steps_ns, delay)
    return again.rows(
        np.isin(again.time_step, np.unique(solved.seen.time_step)) & np.isin(again.patch, np.unique(solved.seen.patch))
    )


def _split_story(trouble: Trouble, solution: PropSolution, c: int, at_s: float, apart: Solved) -> tuple[str, str, int, CheckKind]:
    """What differs between the camera before and after: its pose or its clock, whichever moves more pixels."""
    name, count = trouble.cameras[c].name, len(trouble.cameras)
    pose = solution.state.cam_from_world
    centre = pose.inverse().t
    shift_m = float(np.linalg.norm(centre[count] - centre[c]))
    turn_rad = float(angle_between(pose.R[count][None], pose.R[c][None])[0])
    jump_s = float(solution.state.delay_s[count, 0] - solution.state.delay_s[c, 0])
    sigma_s = float(np.hypot(solution.delay_sigma_s[count, 0], solution.delay_sigma_s[c, 0]))
    focal = trouble.cameras[c].K[0, 0]
    depth = np.abs(pose[apart.seen.camera].move(solution.state.world_from_prop.t[apart.seen.time_step])[:, 2])
    moved_px = focal * (turn_rad + shift_m / max(float(np.median(depth)), 0.1))
    speed = np.linalg.norm(apart.seen.velocity_px_s[np.isin(apart.seen.camera, (c, count))], axis=1)
    px_per_s = float(np.median(speed)) if len(speed) else 0.0
    jumped_px = abs(jump_s) * px_per_s
    others_s = np.delete(solution.state.delay_s[:, 0], [c, count])
    late_s = float(solution.state.delay_s[[c, count], 0].mean() - np.median(others_s)) if len(others_s) else 0.0
    if abs(late_s) > max(_LEAST_JUMP_S, _SIGMA * sigma_s) and abs(late_s) * px_per_s > 2 * max(moved_px, jumped_px):
        return (f"the clock of {name} is off by {late_s * 1e3:+.0f} ms",
                "the cameras are not synchronised: calibrate with `clocks=offset`", 1, "clocks")  # fmt: skip
    if abs(jump_s) > max(_LEAST_JUMP_S, _SIGMA * sigma_s) and jumped_px > moved_px:
        return (f"the clock of {name} jumps by {jump_s * 1e3:+.0f} ms at {at_s:.0f} s",
                "frames were lost: give each frame its true time, or use the part before or after", 2, "record")  # fmt: skip
    return (f"{name} was moved at {at_s:.0f} s by {shift_m * 1e3:.0f} mm and {np.rad2deg(turn_rad):.2f} deg",
            "calibrate again, or use the part before or after", 7, "record")  # fmt: skip
