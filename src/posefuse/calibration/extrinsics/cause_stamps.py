"""Explanations in the time stamps of one camera: single frames that are stamped late.

The path of the target is taken from the other cameras. Each frame of the camera in question then has a time of its own, at
which the path, projected into this camera, comes nearest to the corners in the frame.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from posefuse.calibration.solving.projection import Lenses
from posefuse.calibration.solving.rotations import Poses
from posefuse.calibration.targets.corners import CornerObservations
from posefuse.core.arrays import Array

from .bootstrap import PropShape, prop_track, prop_views
from .causes import CauseTrial, Trouble, solve_from_scratch, trial
from .pipeline import Solved
from .planar import planar_views
from .snapshots import middle_ns, snapshots

_CANDIDATES, _LEAST_FRAMES, _MOST_FRAMES = 2, 24, 600
# the time of a frame is looked for within so many periods of its stamp, in so many steps of each
_MOST_PERIODS, _STEPS = 2.0, 10
# a corner off by more counts no more; over the times looked at, the target has to move a corner by this to show the time
_MOST_OFF_PX, _MOVING_PX = 30.0, 4.0
# a stamp is wrong that is off by this share of a period; that many frames make a hypothesis, the others being right
_WRONG_PERIODS, _LEAST_WRONG, _MOST_WRONG = 0.25, 0.05, 0.6
# a pattern repeats after so many frames at most, holds for this share of them, and hardly any frame between is wrong
_LONGEST_PATTERN, _PATTERN_HOLDS, _BETWEEN = 8, 0.75, 0.35
_ORDINALS = ("second", "third", "fourth", "fifth", "sixth", "seventh", "eighth")
_REMEDY = "read the true time of each frame from the camera, or fix its exposure so that it keeps its frame rate"


@dataclass(frozen=True, eq=False)
class FrameTimes:
    """When the frames of one camera were taken.

    Attributes:
        t_ns: (F,) their stamps. late_s: (F,) how much later they are stamped than most of them; NaN where the target rests.
        usual_s: how late those are against the other cameras. period_s: usual time between frames.
    """

    t_ns: Array
    late_s: Array
    usual_s: float
    period_s: float

    @property
    def wrong(self) -> Array:
        """(F,) whether a stamp is wrong."""
        return np.asarray(np.abs(np.nan_to_num(self.late_s)) > _WRONG_PERIODS * self.period_s)

    @property
    def words(self) -> str:
        """What is wrong with the stamps."""
        late_ms = float(np.median(self.late_s[self.wrong])) * 1e3
        off = f"{abs(late_ms):.0f} ms {'late' if late_ms > 0 else 'early'}"
        length = self._pattern()
        if length:
            return f"every {_ORDINALS[length - 2]} frame is stamped {off}"
        return f"{self.wrong.sum()} of {np.isfinite(self.late_s).sum()} frames are stamped wrongly, usually {off}"

    def _pattern(self) -> int:
        """Every n-th frame is wrong and those between are right: n; 0 without such a pattern."""
        true_s = (self.t_ns - self.t_ns[0]) / 1e9 - np.nan_to_num(self.late_s)
        number = np.cumsum(np.round(np.diff(true_s, prepend=true_s[0]) / self.period_s)).astype(np.int64)
        wrong = number[self.wrong]
        known = number[np.isfinite(self.late_s)]
        for length in range(1, _LONGEST_PATTERN + 1):
            after = np.isin(wrong + length, wrong)[np.isin(wrong + length, known)]
            if len(after) and after.mean() > _BETWEEN:
                return length if length > 1 and after.mean() >= _PATTERN_HOLDS else 0
        return 0


def irregular_stamps(trouble: Trouble) -> Iterator[CauseTrial]:
    """Some frames of one camera are stamped late or early: they get the time at which they fit."""
    solved = trouble.solved
    if solved is None:
        return
    for c in _worst_cameras(trouble, solved):
        part = _middle_part(trouble.observations, c)
        times = frame_times(part, middle_ns(trouble.observations), trouble, solved, c)
        if times is None or not _LEAST_WRONG < times.wrong.mean() < _MOST_WRONG:
            continue
        frame = np.minimum(np.searchsorted(times.t_ns, part.t_ns), len(times.t_ns) - 1)
        late_s = np.where((part.camera == c) & times.wrong[frame], times.late_s[frame], 0.0)
        restamped = replace(part, t_ns=part.t_ns - np.round(late_s * 1e9).astype(np.int64))
        delay_s = solved.solution.state.delay_s
        # against the others, the usual frame may be late too, by more than the step of the search
        shifted = abs(times.usual_s) > 1.5 * times.period_s / _STEPS
        clocks = "offset" if shifted or delay_s.any() else "together"
        again, lost = solve_from_scratch(trouble, restamped, trouble.cameras, trouble.target, clocks, delay_s)
        words = f"the time stamps of {trouble.cameras[c].name} are irregular: {times.words}"
        if again is not None:
            yield trial(words, _REMEDY, again, again.solution, 2 if shifted else 1, kind="record", lost=lost)


def _worst_cameras(trouble: Trouble, solved: Solved) -> list[int]:
    """Cameras of which the fewest views agree."""
    camera = solved.seen.camera[solved.seen.group_starts()]
    count = np.bincount(camera, minlength=len(trouble.cameras))
    share = np.bincount(camera, solved.inlier, len(trouble.cameras)) / np.maximum(count, 1)
    return [int(c) for c in np.argsort(share)[:_CANDIDATES]]


def _middle_part(observations: CornerObservations, c: int) -> CornerObservations:
    """The middle of a long recording, by the frames of one camera."""
    t_ns = np.unique(observations.t_ns[observations.camera == c])
    begin = max(len(t_ns) - _MOST_FRAMES, 0) // 2
    kept = t_ns[begin : begin + _MOST_FRAMES]
    return observations.rows((observations.t_ns >= kept[0]) & (observations.t_ns <= kept[-1])) if len(kept) else observations


def frame_times(observations: CornerObservations, zero_ns: int, trouble: Trouble, solved: Solved, c: int) -> FrameTimes | None:
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
    path_s, path = _path_by_others(observations, zero_ns, trouble, solved, c, period_s)
    patch, camera = np.searchsorted(solved.seen.patches, seen.patch), np.full(len(seen), c)
    xyz_prop = solved.solution.state.prop_from_patch[patch].move(solved.corners[patch, seen.corner])
    xy_norm = Lenses(trouble.cameras).norm_from_px(camera, seen.xy_img)
    cam_from_world, focal_px = solved.solution.state.cam_from_world[camera], trouble.cameras[c].K[0, 0]
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
    return FrameTimes(t_ns, late_s - usual_s, usual_s, period_s)


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
    observations: CornerObservations, zero_ns: int, trouble: Trouble, solved: Solved, c: int, period_s: float
) -> tuple[Array, Poses]:
    """Times (T,) s and world_from_prop (T,) as the other cameras see the prop; NaN where they do not."""
    others = observations.rows(observations.camera != c)
    steps_ns = np.arange(int(others.t_ns.min()), int(others.t_ns.max()), max(round(period_s * 1e9), 1))
    seen = snapshots(others, steps_ns, solved.solution.state.delay_s)
    known = solved.seen.patches
    seen = replace(seen, patch=np.searchsorted(known, seen.patches[seen.patch]), patches=known)
    lenses, shape = Lenses(trouble.cameras), _prop(solved)
    views = prop_views(seen, planar_views(seen, solved.corners, lenses), shape, solved.corners, lenses)
    path = prop_track(seen, views, shape, solved.corners, lenses, solved.solution.state.cam_from_world)
    return (steps_ns - zero_ns) / 1e9, path


def _moved(path_s: Array, path: Poses, t_s: Array, xyz_prop: Array) -> Array:
    """(N, 3) points of the prop in the world at times (N,) s, between two poses of its path; NaN outside of it."""
    after = np.clip(np.searchsorted(path_s, t_s), 1, max(len(path_s) - 1, 1))
    share = ((t_s - path_s[after - 1]) / (path_s[after] - path_s[after - 1]))[:, None]
    inside = ((share >= 0) & (share <= 1)).ravel()
    xyz = (1 - share) * path[after - 1].move(xyz_prop) + share * path[after].move(xyz_prop)
    return np.where(inside[:, None], xyz, np.nan)
