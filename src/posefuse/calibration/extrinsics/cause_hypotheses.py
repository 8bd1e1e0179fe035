"""The explanations that are tried when a calibration is refused."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from posefuse.calibration.report import CheckKind
from posefuse.calibration.targets.corners import CornerObservations
from posefuse.calibration.targets.coverage import linked_groups
from posefuse.calibration.targets.kinds import Charuco
from posefuse.core import Camera
from posefuse.core.arrays import Array

from .cause_splits import moved_or_jumped
from .cause_stamps import irregular_stamps
from .causes import CauseTrial, Hypothesis, Trouble, near_solve, solve_from_scratch, trial
from .clocks import rough_offsets
from .lens_check import STRETCHED_REMEDY, best_stretch, lens_change, lens_words
from .pipeline import Solved
from .prop_solve import Freedom, PropSolution
from .solution_checks import let_lenses_free, usual_distance_m

_LEAST_DRIFT = 1e-4
_LEAST_STRETCH = 0.002
_SHARED_TIME, _AT_ONCE_S = 0.25, 0.05
_FOCUS = "focus or zoom has changed since they were calibrated, or they are of another camera: calibrate them again"


def intrinsics_wrong(trouble: Trouble) -> Iterator[CauseTrial]:
    """The intrinsics of one camera, two, or all are free; or the given ones belong to other cameras."""
    solved = trouble.solved
    if solved is None:
        return
    cameras, limits = trouble.cameras, trouble.options.limits
    free = let_lenses_free(cameras, solved, False)
    excess = (
        lens_change(cameras, solved.solution, free, solved.seen, usual_distance_m(solved)).excess(cameras, limits).max(axis=1)
    )
    yield from _permuted(trouble, solved, free)
    worst = np.argsort(-excess)
    for some in {(int(worst[0]),), tuple(sorted(int(i) for i in worst[:2]))} if len(cameras) > 2 else set():
        one = let_lenses_free(cameras, solved, False, some)
        yield trial(_lens_story(trouble, solved, one, some), _FOCUS, solved, one, 6 * len(some), kind="lenses")
    yield trial(_lens_story(trouble, solved, free, None), _FOCUS, solved, free, 6 * len(cameras), kind="lenses")


def _lens_story(trouble: Trouble, solved: Solved, free: PropSolution, some: tuple[int, ...] | None) -> str:
    cameras, limits = trouble.cameras, trouble.options.limits
    change = lens_change(cameras, solved.solution, free, solved.seen, usual_distance_m(solved))
    excess = change.excess(cameras, limits)
    of = range(len(cameras)) if some is None else some
    wrong = [i for i in of if excess[i].max() > 1] or list(of)
    whose = "all cameras" if len(wrong) == len(cameras) else " and ".join(cameras[i].name for i in wrong)
    words = [lens_words(cameras, change, limits, i, int(np.argmax(excess[i]))) for i in wrong[:3]]
    return f"the intrinsics of {whose} are wrong: {', '.join(words)}"


def _permuted(trouble: Trouble, solved: Solved, free: PropSolution) -> Iterator[CauseTrial]:
    """The given intrinsics are right, but not in this order."""
    cameras, delta, covariance = trouble.cameras, free.state.lens_delta, free.lens_covariance
    given = np.array([[c.K[0, 0], c.K[1, 1], c.K[0, 2], c.K[1, 2], *_bend(c)] for c in cameras])
    sigma = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)) + 1e-3 * np.array([1, 1, 1, 1, 1e-2, 1e-2]) * given[:, :1]
    away = (((given + delta)[:, None] - given[None]) / sigma[:, None]) ** 2
    order = linear_sum_assignment(np.minimum(away, 1e4).sum(axis=-1))[1]
    other = np.flatnonzero(order != np.arange(len(cameras)))
    if len(other) == 0:
        return
    swapped = tuple(replace(c, K=cameras[j].K, distortion=cameras[j].distortion, model=cameras[j].model)
                    for c, j in zip(cameras, order, strict=True))  # fmt: skip
    again = near_solve(solved, swapped, solved.solution.state)
    names = [cameras[i].name for i in other]
    yield trial(
        f"the names of {', '.join(names[:-1])} and {names[-1]} are swapped: each other's intrinsics fit",
        "name the videos, or the intrinsics, the other way round", solved, again, 0, kind="input",
    )  # fmt: skip


def _bend(camera: Camera) -> Array:
    return np.concatenate([camera.distortion, np.zeros(2)])[:2]


def clocks_near(trouble: Trouble) -> Iterator[CauseTrial]:
    """Each camera has a clock of its own, within what the motion of the corners extrapolates to."""
    solved = trouble.solved
    if solved is None:
        return
    freedom = Freedom(reference=solved.links.reference, held_patches=solved.links.shape.held, offset=True)
    free = near_solve(solved, trouble.cameras, solved.solution.state, freedom)
    words = _clock_story(trouble.cameras, replace(solved, solution=free))
    if words:
        remedy = "the cameras are not synchronised: calibrate with `clocks=offset`"
        yield trial(words, remedy, solved, free, len(trouble.cameras) - 1, kind="clocks")


def clocks_off(trouble: Trouble) -> Iterator[CauseTrial]:
    """Each camera has a clock of its own, seconds apart; or running at its own rate."""
    cameras = trouble.cameras
    late = rough_offsets(trouble.observations, cameras, trouble.target)
    if not np.isfinite(late).any():
        return
    late = np.nan_to_num(late - np.nanmedian(late))
    start = np.stack([late, np.zeros(len(cameras))], axis=1)
    for clocks, frees in (("offset", 1), ("drift", 2)):
        solved, lost = solve_from_scratch(trouble, trouble.observations, cameras, trouble.target, clocks, start)
        if solved is None or not _see_together(trouble.observations, solved.solution.state.delay_s[:, 0]):
            continue
        words = _clock_story(cameras, solved)
        if words:
            remedy = f"the cameras are not synchronised: calibrate with `clocks={clocks}`"
            kind: CheckKind = "drift" if clocks == "drift" else "clocks"
            yield trial(words, remedy, solved, solved.solution, frees * (len(cameras) - 1), kind=kind, lost=lost)


def _see_together(observations: CornerObservations, delay_s: Array) -> bool:
    """Whether all cameras hang together through pairs that see the target at once for a good part of their frames.

    With offsets that are wide enough, a little of any two recordings overlaps.
    """
    seen = [np.unique(observations.t_ns[observations.camera == c]) / 1e9 - late for c, late in enumerate(delay_s)]
    linked = np.eye(len(seen), dtype=bool)
    for a, first in enumerate(seen):
        for b, second in enumerate(seen):
            if a != b and len(first) and len(second):
                after = np.searchsorted(second, first).clip(1, max(len(second) - 1, 1))
                apart = np.minimum(np.abs(first - second[after - 1]), np.abs(first - second[after % len(second)]))
                linked[a, b] = (apart < _AT_ONCE_S).sum() >= _SHARED_TIME * min(len(first), len(second))
    return len(linked_groups(linked | linked.T)) == 1


def _clock_story(cameras: tuple[Camera, ...], solved: Solved) -> str:
    value, sigma = solved.solution.state.delay_s, solved.solution.delay_sigma_s
    value = value - np.median(value, axis=0)
    parts = []
    for c, camera in enumerate(cameras):
        if abs(value[c, 1]) > max(_LEAST_DRIFT, 5 * sigma[c, 1]):
            parts.append(f"the clock of {camera.name} runs {value[c, 1] * 1e6:+.0f} ppm fast (drift)")
        elif abs(value[c, 0]) > max(0.004, 5 * sigma[c, 0]):
            parts.append(f"the clock of {camera.name} is off by {value[c, 0] * 1e3:+.0f} ms")
    return ", ".join(parts)


def board_stretched(trouble: Trouble) -> Iterator[CauseTrial]:
    """The board stretched in print, as far as fits best."""
    solved = trouble.solved
    if solved is None or not isinstance(trouble.target, Charuco):
        return
    found = best_stretch(solved, trouble.cameras)
    if found is not None and abs(found.share) > _LEAST_STRETCH:
        words = f"the board is longer in one direction than described: printed stretched by {found.share:+.1%}"
        yield trial(words, STRETCHED_REMEDY, solved, found.solution, 1, kind="input")


HYPOTHESES = (
    Hypothesis("intrinsics", "intrinsics of one, two or all cameras; or their order", intrinsics_wrong, near=True),
    Hypothesis("moved or jumped", "one camera from a time step on", moved_or_jumped, near=True),
    Hypothesis("time stamps", "the time of each frame of one camera", irregular_stamps, near=True),
    Hypothesis("board stretched", "one length of the board", board_stretched, near=True),
    Hypothesis("clocks, near", "offset of each clock", clocks_near, near=True),
    Hypothesis("clocks", "offset, or offset and drift, of each clock", clocks_off, near=False),
)
