"""Why a calibration was refused: explanations tested against each other on the same corners.

A hypothesis undoes or frees one thing and solves again. All are judged by the share of the excess residual that they take
away; among those that take away about as much, the one that frees least is named. Two that cannot be separated are both named.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from posefuse.calibration.geometry import Lenses, Poses
from posefuse.calibration.report import Check
from posefuse.calibration.targets.corners import CornerObservations
from posefuse.calibration.targets.kinds import Charuco
from posefuse.core import CalibrationError, Camera
from posefuse.core.arrays import Array

from .bootstrap import PropShape, prop_path, rough_offsets
from .freedoms import (
    Freed,
    board_freed,
    camera_moves,
    check_clocks,
    clocks_freed,
    lens_change,
    lenses_freed,
)
from .pipeline import TIME_STEPS, RigTask, Solved, solve
from .prop_solve import SolvedRig
from .snapshots import middle_ns, snapshots

# residuals beyond so many standard deviations count ever less
_ROBUST = 3.0
# cost of a corner that the hypothesis does not explain, and of one with noise only (mean of log(1 + chi2 / 9))
_LOST, _NOISE = 3.0, 0.095
# what detection leaves of a corner: the yardstick that an explanation has to come near
_LEAST_SIGMA_PX, _MOST_SIGMA_PX = 0.1, 0.6
_LEAST_EXPLAINED, _ABOUT_AS_MUCH, _INSEPARABLE = 0.5, 0.1, 0.02
# with this share explained, no solve from the beginning is needed; an explanation that frees more is held against those
_ENOUGH, _FREES_LITTLE = 0.85, 1


@dataclass(frozen=True, eq=False)
class Cause:
    """An explanation with the share (0 to 1) of the excess residual that it removes."""

    freed: Freed
    explained: float


Hypothesis = Callable[[RigTask, Solved], Iterable[Freed]]


def likely_target_causes(task: RigTask, solved: Solved | None) -> tuple[Cause, ...]:
    """The best explanation, or the two best when they cannot be distinguished; none where nothing explains enough.

    `solved`: the solution that was refused; None where the cameras could not be linked.
    """
    trials: list[Freed] = []
    if solved is not None:
        trials = [trial for explain in _NEAR for trial in explain(task, solved)]
        found = best_causes(solved, trials)
        if found and found[0].explained >= _ENOUGH and found[0].freed.frees <= _FREES_LITTLE:
            return found
    return best_causes(solved, [*trials, *clocks_off(task)])


def best_causes(refused: SolvedRig | None, trials: Sequence[Freed]) -> tuple[Cause, ...]:
    """Of trials, as `likely_target_causes`."""
    if not trials:
        return ()
    sigma_px = float(np.clip(min(_spread_px(trial.solved) for trial in trials), _LEAST_SIGMA_PX, _MOST_SIGMA_PX))
    before = _LOST if refused is None else _cost(refused, 0, sigma_px)
    if before <= _NOISE:
        # there is no misfit to explain
        return ()
    causes = [Cause(trial, (before - _cost(trial.solved, trial.lost, sigma_px)) / (before - _NOISE)) for trial in trials]
    most = max(cause.explained for cause in causes)
    enough = max(_LEAST_EXPLAINED, most - _ABOUT_AS_MUCH)
    near = sorted((c for c in causes if c.explained >= enough), key=lambda c: (c.freed.frees, -c.explained))
    alike = [c for c in near[1:] if c.freed.frees == near[0].freed.frees and c.explained >= near[0].explained - _INSEPARABLE]
    return (*near[:1], *alike[:1])


def cause_check(causes: Sequence[Cause], refused: SolvedRig | None) -> Check:
    """The causes as a failed check, with the evidence."""
    first, checks = causes[0], [cause.freed.check for cause in causes]
    words = " or ".join(check.detail for check in checks)
    evidence = (
        f"it takes away {min(first.explained, 1.0):.0%} of the misfit" if len(causes) == 1 else "the images do not show which"
    )
    if refused is not None:
        evidence += f": corners spread {_spread_px(first.freed.solved):.2f} px instead of {_spread_px(refused):.2f} px"
    return Check("cause", False, f"{words} ({evidence})", " or ".join(dict.fromkeys(c.remedy for c in checks)), checks[0].kind)


def _spread_px(solved: SolvedRig) -> float:
    """Usual residual of a corner coordinate."""
    size = np.linalg.norm(solved.solution.residual_px, axis=1)
    size = size[np.isfinite(size)]
    return float(np.median(size) / 1.1774) if len(size) else np.inf


def _cost(solved: SolvedRig, lost: int, sigma_px: float) -> float:
    """Mean over the cameras of the robust cost of a corner."""
    square = np.nan_to_num((solved.solution.residual_px**2).sum(axis=1), nan=np.inf) / (2 * sigma_px**2)
    each, camera = np.minimum(np.log1p(square / _ROBUST**2), _LOST), solved.seen.camera
    mine = [each[camera == c] for c in np.unique(camera)]
    mean = float(np.mean([one.mean() for one in mine])) if mine else _LOST
    share = lost / max(lost + len(each), 1)
    return (1 - share) * mean + share * _LOST


def solve_from_scratch(task: RigTask, observations: CornerObservations, clocks: str, delay_s: Array) -> tuple[Solved, int]:
    """Everything from the beginning on fewer time steps: the solution, and how many corners it could not place.

    Raises:
        CalibrationError: a camera cannot be linked.
    """
    options = replace(task.options, time_steps=min(task.options.time_steps, TIME_STEPS), clocks=clocks)
    solved = solve(replace(task, observations=observations, options=options), delay_s)
    # what is not read again at the clocks found, since a neighbouring frame lacks it, is no evidence against them
    seen = solved.links.seen
    used = np.isin(seen.time_step, np.unique(solved.seen.time_step)) & np.isin(seen.patch, np.unique(solved.seen.patch))
    return solved, int((~used).sum())


_FOCUS = "focus or zoom has changed since they were calibrated, or they are of another camera: calibrate them again"


def intrinsics_wrong(task: RigTask, solved: Solved) -> Iterator[Freed]:
    """The intrinsics of one camera, two, or all are free; or the given ones belong to other cameras."""
    free = lenses_freed(solved, False)
    yield from _permuted(solved, free)
    count, worst = len(solved.cameras), np.argsort(-lens_change(solved, free).excess.max(axis=1))
    pairs = {(int(worst[0]),), tuple(sorted(int(i) for i in worst[:2]))} if count > 2 else set()
    for some in (*sorted(pairs), tuple(range(count))):
        one = free if len(some) == count else lenses_freed(solved, False, some)
        yield Freed(Check("cause", False, _lens_story(solved, one, some), _FOCUS, "lenses"), one, 6 * len(some))


def _lens_story(solved: Solved, free: Solved, some: tuple[int, ...]) -> str:
    change, cameras = lens_change(solved, free), solved.cameras
    wrong = [i for i in some if change.excess[i].max() > 1] or list(some)
    whose = "all cameras" if len(wrong) == len(cameras) else " and ".join(cameras[i].name for i in wrong)
    words = [change.words(i, int(np.argmax(change.excess[i]))) for i in wrong[:3]]
    return f"the intrinsics of {whose} are wrong: {', '.join(words)}"


def _permuted(solved: Solved, free: Solved) -> Iterator[Freed]:
    """The given intrinsics are right, but not in this order."""
    cameras, delta, covariance = solved.cameras, free.solution.state.lens_delta, free.solution.lens_covariance
    given = np.array([[c.K[0, 0], c.K[1, 1], c.K[0, 2], c.K[1, 2], *_bend(c)] for c in cameras])
    sigma = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)) + 1e-3 * np.array([1, 1, 1, 1, 1e-2, 1e-2]) * given[:, :1]
    away = (((given + delta)[:, None] - given[None]) / sigma[:, None]) ** 2
    order = linear_sum_assignment(np.minimum(away, 1e4).sum(axis=-1))[1]
    other = np.flatnonzero(order != np.arange(len(cameras)))
    if len(other) == 0:
        return
    swapped = tuple(replace(c, K=cameras[j].K, distortion=cameras[j].distortion, model=cameras[j].model)
                    for c, j in zip(cameras, order, strict=True))  # fmt: skip
    names = [cameras[i].name for i in other]
    words = f"the names of {', '.join(names[:-1])} and {names[-1]} are swapped: each other's intrinsics fit"
    remedy = "name the videos, or the intrinsics, the other way round"
    yield Freed(Check("cause", False, words, remedy), replace(solved, cameras=swapped).again(), 0)


def _bend(camera: Camera) -> Array:
    return np.concatenate([camera.distortion, np.zeros(2)])[:2]


def clocks_off(task: RigTask) -> Iterator[Freed]:
    """Each camera has a clock of its own, seconds apart; or running at its own rate."""
    count, late = len(task.cameras), rough_offsets(task.observations, task.cameras, task.target)
    if not np.isfinite(late).any():
        return
    late = np.nan_to_num(late - np.nanmedian(late))
    start = np.stack([late, np.zeros(count)], axis=1)
    for clocks, frees in (("offset", 1), ("drift", 2)):
        with suppress(CalibrationError):
            solved, lost = solve_from_scratch(task, task.observations, clocks, start)
            check = check_clocks(solved)
            if not check.passed:
                yield Freed(check, solved, frees * (count - 1), lost)


def unsteady(task: RigTask, solved: Solved) -> Iterator[Freed]:
    """What the checks of a solution let free, and what did not stay."""
    boards = [board_freed(solved)] if isinstance(task.target, Charuco) else []
    yield from (freed for freed in (*boards, clocks_freed(solved), camera_moves(solved)) if not freed.check.passed)


# cameras whose stamps are looked at
_CANDIDATES = 2
_LEAST_FRAMES, _MOST_FRAMES = 24, 600
# the time of a frame is looked for within so many periods of its stamp, in so many steps of each
_MOST_PERIODS, _STEPS = 4.0, 10
# a corner off by more counts no more; over the times looked at, the target has to move a corner by this to show the time
_MOST_OFF_PX, _MOVING_PX = 30.0, 4.0
# a stamp is wrong that is off by this share of a period; that many frames make a hypothesis, the others being right
_WRONG_PERIODS, _LEAST_WRONG, _MOST_WRONG = 0.25, 0.05, 0.6
# stamps are wrong from some frame on, or up to one, with as many exceptions as this share
_STRAYS = 0.1


@dataclass(frozen=True, eq=False)
class FrameTimes:
    """When the frames of one camera were taken.

    Attributes:
        camera: name. t_ns: (F,) stamps. late_s: (F,) how much later they are than most of them; NaN where the target rests.
        usual_s: how late those are against the other cameras. period_s: usual time between frames.
    """

    camera: str
    t_ns: Array
    late_s: Array
    usual_s: float
    period_s: float

    @property
    def wrong(self) -> Array:
        """(F,) whether a stamp is wrong."""
        return np.asarray(np.abs(np.nan_to_num(self.late_s)) > _WRONG_PERIODS * self.period_s)

    def story(self, begin_ns: int) -> tuple[str, str]:
        """What is wrong with the stamps, and what to do; `begin_ns`: when the recording begins."""
        late_ms = float(np.median(self.late_s[self.wrong])) * 1e3
        known = np.isfinite(self.late_s)
        wrong, t_ns = self.wrong[known], self.t_ns[known]
        # if all are wrong from each frame on and right before it: how many are not so
        strays = np.append(0, np.cumsum(wrong)) + np.append(np.cumsum(~wrong[::-1])[::-1], 0)
        after, before = int(np.argmin(strays)), int(np.argmax(strays))
        for cut, count, jump_ms in ((after, strays[after], late_ms), (before, len(wrong) - strays[before], -late_ms)):
            if 0 < cut < len(wrong) and count <= _STRAYS * len(wrong):
                at_s = (t_ns[cut] - begin_ns) / 1e9
                return (f"the clock of {self.camera} jumps by {jump_ms:+.0f} ms at {at_s:.0f} s",
                        "frames were lost: give each frame its true time, or use the part before or after")  # fmt: skip
        off = f"{abs(late_ms):.0f} ms {'late' if late_ms > 0 else 'early'}"
        words = f"the time stamps of {self.camera} are irregular: {wrong.sum()} of {len(wrong)} frames are off, usually {off}"
        return words, "read the true time of each frame from the camera, or fix its exposure so that it keeps its frame rate"


def wrong_stamps(task: RigTask, solved: Solved) -> Iterator[Freed]:
    """Frames of one camera are stamped late or early, some or all from a time on: they get the time at which they fit."""
    for c in (int(i) for i in np.argsort(solved.agreeing()[:, 0])[:_CANDIDATES]):
        part = _middle_part(task.observations, c)
        times = frame_times(part, middle_ns(task.observations), solved, c)
        if times is None or not _LEAST_WRONG < times.wrong.mean() < _MOST_WRONG:
            continue
        frame = np.minimum(np.searchsorted(times.t_ns, part.t_ns), len(times.t_ns) - 1)
        late_s = np.where((part.camera == c) & times.wrong[frame], times.late_s[frame], 0.0)
        restamped = replace(part, t_ns=part.t_ns - np.round(late_s * 1e9).astype(np.int64))
        # against the others, the usual frame may be late too, by more than the step of the search
        shifted = abs(times.usual_s) > 1.5 * times.period_s / _STEPS
        delay_s = solved.solution.state.delay_s + np.outer(np.arange(len(task.cameras)) == c, [times.usual_s * shifted, 0.0])
        with suppress(CalibrationError):
            again, lost = solve_from_scratch(task, restamped, "offset" if delay_s.any() else "together", delay_s)
            words, remedy = times.story(int(task.observations.t_ns.min()))
            yield Freed(Check("cause", False, words, remedy), again, 2 if shifted else 1, lost)


def _middle_part(observations: CornerObservations, c: int) -> CornerObservations:
    """The middle of a long recording, by the frames of one camera."""
    t_ns = np.unique(observations.t_ns[observations.camera == c])
    begin = max(len(t_ns) - _MOST_FRAMES, 0) // 2
    kept = t_ns[begin : begin + _MOST_FRAMES]
    return observations.rows((observations.t_ns >= kept[0]) & (observations.t_ns <= kept[-1])) if len(kept) else observations


def frame_times(observations: CornerObservations, zero_ns: int, solved: Solved, c: int) -> FrameTimes | None:
    """The time of each frame of camera `c` with corners in `observations`; None where they are few.

    `zero_ns`: zero of the session time of `solved`.
    """
    shape = _prop(solved)
    observations = observations.of_patches(solved.seen.patches[list(shape.prop_from_patch)])
    seen = observations.rows(observations.camera == c)
    t_ns, frame = np.unique(seen.t_ns, return_inverse=True)
    if len(t_ns) < _LEAST_FRAMES or len(t_ns) == len(observations):
        return None
    period_s = float(np.median(np.diff(t_ns))) / 1e9
    path_s, path = _path_by_others(observations, zero_ns, solved, c, period_s)
    patch, camera = np.searchsorted(solved.seen.patches, seen.patch), np.full(len(seen), c)
    xyz_prop = solved.solution.state.prop_from_patch[patch].move(solved.corners[patch, seen.corner])
    xy_norm = Lenses(solved.cameras).norm_from_px(camera, seen.xy_img)
    cam_from_world, focal_px = solved.solution.state.cam_from_world[camera], solved.cameras[c].K[0, 0]
    row_s = (seen.t_ns - zero_ns) / 1e9 - solved.solution.state.delay_s[c, 0]
    tried_s = np.arange(-_MOST_PERIODS, _MOST_PERIODS + 0.5 / _STEPS, 1 / _STEPS) * period_s
    off_px = np.empty((len(tried_s), len(t_ns)))
    for k, late_s in enumerate(tried_s):
        in_cam = cam_from_world.move(_moved(path_s, path, row_s - late_s, xyz_prop))
        with np.errstate(divide="ignore", invalid="ignore"):
            each = focal_px * np.linalg.norm(in_cam[:, :2] / in_cam[:, 2:] - xy_norm, axis=1)
        each = np.where(in_cam[:, 2] > 0, np.minimum(each, _MOST_OFF_PX), np.nan)
        off_px[k] = np.bincount(frame, each, len(t_ns)) / np.bincount(frame, minlength=len(t_ns))
    late_s = _late_s(off_px, tried_s)
    usual_s = _usual(late_s[np.isfinite(late_s)])
    return FrameTimes(solved.cameras[c].name, t_ns, late_s - usual_s, usual_s, period_s)


def _prop(solved: Solved) -> PropShape:
    """The patches that the solution kept, where it has them."""
    used = np.unique(solved.seen.patch)
    shape = solved.links.shape
    return PropShape({p: solved.solution.state.prop_from_patch[p] for p in shape.prop_from_patch if p in used}, shape.held)


def _late_s(off_px: Array, tried_s: Array) -> Array:
    """(F,) where the misfit (tried times, F) is least; NaN where the target rests or is unknown."""
    known = np.isfinite(off_px).all(axis=0)
    filled = np.where(known, off_px, 0.0)
    moving = known & (filled.max(axis=0) - filled.min(axis=0) > _MOVING_PX)
    return np.where(moving, tried_s[filled.argmin(axis=0)], np.nan)


def _usual(values: Array) -> float:
    """Middle of the shortest interval with the least share of right frames; a median can lie between two equal groups."""
    if len(values) == 0:
        return 0.0
    ranked = np.sort(values)
    count = max(int(np.ceil((1 - _MOST_WRONG) * len(ranked))), 1)
    first = int(np.argmin(ranked[count - 1 :] - ranked[: len(ranked) - count + 1]))
    return float(np.median(ranked[first : first + count]))


def _path_by_others(
    observations: CornerObservations, zero_ns: int, solved: Solved, c: int, period_s: float
) -> tuple[Array, Poses]:
    """Times (T,) s and world_from_prop (T,) as the other cameras see the prop; NaN where they do not."""
    others = observations.rows(observations.camera != c)
    steps_ns = np.arange(int(others.t_ns.min()), int(others.t_ns.max()), max(round(period_s * 1e9), 1))
    seen = snapshots(others, steps_ns, solved.solution.state.delay_s)
    known = solved.seen.patches
    seen = replace(seen, patch=np.searchsorted(known, seen.patches[seen.patch]), patches=known)
    path = prop_path(seen, _prop(solved), solved.corners, Lenses(solved.cameras), solved.solution.state.cam_from_world)
    return (steps_ns - zero_ns) / 1e9, path


def _moved(path_s: Array, path: Poses, t_s: Array, xyz_prop: Array) -> Array:
    """(N, 3) points of the prop in the world at times (N,) s, between two poses of its path; NaN outside of it."""
    after = np.clip(np.searchsorted(path_s, t_s), 1, max(len(path_s) - 1, 1))
    share = ((t_s - path_s[after - 1]) / (path_s[after] - path_s[after - 1]))[:, None]
    inside = ((share >= 0) & (share <= 1)).ravel()
    xyz = (1 - share) * path[after - 1].move(xyz_prop) + share * path[after].move(xyz_prop)
    return np.where(inside[:, None], xyz, np.nan)


# near ones start from the solution at hand, and so take little time
_NEAR: tuple[Hypothesis, ...] = (intrinsics_wrong, unsteady, wrong_stamps)
