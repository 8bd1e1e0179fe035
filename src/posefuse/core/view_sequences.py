"""The people of a recording in every camera at the common time steps: input of fusion and of drawings."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from .arrays import Array, FrozenArrays, give_away, taken
from .observations import LIVE_STEP, NOT_KEPT, Observations
from .skeleton import Skeleton, swap_sides
from .values import VIEW_ARRAYS, Views, check_views, unseen_planes

# a frame this close to its time step counts as taken at it
_SAME_TIME_NS = 200_000
# two frames further apart than this many periods are not interpolated between
_REACH_PERIODS = 1.6
# nor, of a camera slower than the time steps, frames further apart than those of 15 Hz: simulated walks are as good with such
# views as without, and with those of 10 Hz a tenth worse
_SLOW_REACH_NS = 80_000_000
# the arrays with an axis T in front
_PLANES = ("xy_img", "score", "sigma_px", "depth_m")


@dataclass(frozen=True, eq=False, kw_only=True)
class ViewSequence(FrozenArrays):
    """The same people in every camera, over time: `Views` with an axis T in front, person_id excepted.

    Attributes:
        t_ns: (T,). camera_names: axis C. person_id: (N,).
        xy_img: (T, N, C, K, 2) raw distorted px; NaN where unseen. score, sigma_px: (T, N, C, K); 0 and NaN where unseen.
        depth_m: (T, N, C, K, 2) as in `Detections2D`; None where no camera has depth.
    """

    t_ns: Array
    skeleton: Skeleton
    camera_names: tuple[str, ...]
    person_id: Array
    xy_img: Array
    score: Array
    sigma_px: Array
    depth_m: Array | None = None

    def __post_init__(self) -> None:
        check_views(self, {"t_ns": "T"} | {name: text if text == "N" else f"T {text}" for name, text in VIEW_ARRAYS.items()})

    def at(self, i: int) -> Views:
        """The time step at place i of axis T."""
        return Views(
            t_ns=int(self.t_ns[i]),
            skeleton=self.skeleton,
            camera_names=self.camera_names,
            person_id=self.person_id,
            **taken(self, _PLANES, i),
        )

    def part(self, steps: slice | Array) -> ViewSequence:
        """These time steps only."""
        return replace(self, **taken(self, ("t_ns", *_PLANES), steps))

    def people(self, which: Array | slice) -> ViewSequence:
        """These people only: `which` is (N,) bool, or their places on axis N in the order wanted."""
        return replace(self, person_id=self.person_id[which], **taken(self, _PLANES, (slice(None), which)))


def views_over_time(observations: Observations, person_id: Iterable[int]) -> ViewSequence:
    """Every camera's keypoints of these people (N,) at the observations' own time steps, see `ViewsInParts`."""
    return ViewsInParts(observations, person_id).part(slice(None))


class PartsOfViews(Protocol):
    """Views whose time steps can be had in parts: a `ViewSequence`, or what makes each part when it is asked for."""

    @property
    def t_ns(self) -> Array:
        """(T,) session clock."""
        ...

    def part(self, steps: slice) -> ViewSequence:
        """These time steps only."""
        ...


class ViewsInParts:
    """Every camera's keypoints of people, brought to common times a part at a time: all of an hour takes much memory.

    A camera whose frames lie between these times gets keypoints interpolated linearly between its two frames around
    each, so that cameras without hardware synchronisation agree on moving people. Where the detector confused left and right
    of a limb in one of the two, the limb keeps the sides that the nearer frame gives it.

    Args:
        observations: of a recording, or of a live session. person_id: (N,) in this order.
        t_ns: (T,) times, for a live session, of which not every frame was used; None: the observations' own time steps.
        gap_ns: with `t_ns`: a camera's frames this far apart are interpolated between, even if frames are missing there.
    """

    def __init__(self, observations: Observations, person_id: Iterable[int], t_ns: Array | None = None, gap_ns: int = 0) -> None:
        self._times = t_ns, gap_ns
        self._seen, self._ids = observations, np.array(list(person_id), np.int64)
        self.t_ns = observations.step_t_ns if t_ns is None else np.asarray(t_ns, np.int64)
        rows, count = _rows_of_people(observations, self._ids, steps_only=t_ns is None), len(observations.camera_names)
        self._tracks = [_track_of(observations, rows, c, None if t_ns is None else self.t_ns, gap_ns) for c in range(count)]

    def people(self, which: Array | slice) -> ViewsInParts:
        """These people only: `which` is (N,) bool, or their places on axis N in the order wanted."""
        if np.array_equal(self._ids[which], self._ids):
            return self
        return ViewsInParts(self._seen, self._ids[which], *self._times)

    def part(self, steps: slice) -> ViewSequence:
        """The views of these time steps, to the last bit as they are in the whole."""
        seen, t_ns = self._seen, self.t_ns[steps]
        shape = (len(t_ns), len(self._ids), len(seen.camera_names), len(seen.skeleton))
        planes = unseen_planes(shape, seen.depth_m is not None)
        for c, track in enumerate(self._tracks):
            if len(track.t_ns) and len(t_ns):
                found = _at_times(t_ns, *track.around(steps, seen, self._ids), track.reach_ns, seen.skeleton)
                for name, plane in planes.items():
                    plane[:, :, c] = found.planes[name]
        give_away(*planes.values())
        return ViewSequence(t_ns=t_ns, skeleton=seen.skeleton, camera_names=seen.camera_names, person_id=self._ids, **planes)


def people_in(observations: Observations) -> tuple[Array, Array]:
    """(N,) ids of all people in the observations, and (N,) in how many time steps each was seen by any camera."""
    kept = observations.person_id != NOT_KEPT
    frame = observations.detection_frame[kept]
    seen = np.unique(np.stack([observations.person_id[kept], observations.frame_step[frame]]), axis=1)
    ids, counts = np.unique(seen[0], return_counts=True)
    return ids, counts


@dataclass(frozen=True, eq=False)
class _CameraFrames:
    """One camera's frames in the order of their times (F,), with the planes (F, N, K, ...) of `unseen_planes`."""

    t_ns: Array
    planes: Mapping[str, Array]

    def at(self, places: Array) -> _CameraFrames:
        """A copy of the frames at these places."""
        return _CameraFrames(self.t_ns[places], {name: plane[places] for name, plane in self.planes.items()})


@dataclass(frozen=True, eq=False, kw_only=True)
class _CameraTrack:
    """Where one camera's frames and the detections in them are.

    Attributes:
        t_ns: (F,) times of its frames. own: (T,) the frame of each time.
        alone: (T,) whether that frame counts where it is not interpolated.
        rows, places: (R,) rows of the detection table, and the frame of each.
        reach_ns: frames farther apart than this are not interpolated between.
    """

    t_ns: Array
    own: Array
    alone: Array
    rows: Array
    places: Array
    reach_ns: float

    def around(self, steps: slice, seen: Observations, ids: Array) -> tuple[_CameraFrames, Array, Array]:
        """The frames of these times with one more at both ends, (T,) the one of each time, and `alone`."""
        own = self.own[steps]
        begin, end = max(int(own.min()) - 1, 0), int(own.max()) + 2
        here = (self.places >= begin) & (self.places < end)
        frames = _filled(seen, self.t_ns[begin:end], self.rows[here], self.places[here] - begin, ids)
        return frames, own - begin, self.alone[steps]


def _rows_of_people(observations: Observations, ids: Array, steps_only: bool) -> Array:
    """The detections of these people; `steps_only`: those in frames that belong to a time step."""
    wanted = np.isin(observations.person_id, ids)
    if steps_only:
        wanted &= observations.frame_step[observations.detection_frame] != LIVE_STEP
    return np.flatnonzero(wanted)


def _track_of(observations: Observations, rows: Array, c: int, t_ns: Array | None, gap_ns: int) -> _CameraTrack:
    """One camera's frames at times (T,), or at the log's time steps (None): then those frames alone that belong to one."""
    mine = observations.frame_camera == c
    if t_ns is None:
        mine &= observations.frame_step != LIVE_STEP
    frames_ns, place = np.unique(observations.frame_t_ns[mine], return_inverse=True)
    place_of = np.full(len(mine), -1)
    place_of[mine] = place
    at = place_of[observations.detection_frame[rows]]
    wanted_ns, period_ns = observations.step_t_ns if t_ns is None else t_ns, _period_ns(frames_ns)
    own = nearest_frames(frames_ns, wanted_ns) if len(frames_ns) else np.zeros(len(wanted_ns), np.int64)
    if t_ns is None:
        step, alone = observations.frame_step[mine], np.zeros(len(wanted_ns), np.bool_)
        own[step], alone[step] = place, True
        reach_ns = max(_REACH_PERIODS * _period_ns(wanted_ns), min(_REACH_PERIODS * period_ns, _SLOW_REACH_NS))
    else:
        alone = np.abs(frames_ns[own] - wanted_ns) <= max(period_ns / 2, _SAME_TIME_NS) if len(frames_ns) else own > 0
        reach_ns = max(_REACH_PERIODS * period_ns, gap_ns)
    return _CameraTrack(t_ns=frames_ns, own=own, alone=alone, rows=rows[at >= 0], places=at[at >= 0], reach_ns=reach_ns)


def nearest_frames(frame_t_ns: Array, t_ns: Array) -> Array:
    """Place of the frame (F,) that is nearest to each time (...), the earlier one of two."""
    after = np.searchsorted(frame_t_ns, t_ns).clip(max=len(frame_t_ns) - 1)
    before = (after - 1).clip(min=0)
    return np.where(t_ns - frame_t_ns[before] <= frame_t_ns[after] - t_ns, before, after)


def _period_ns(t_ns: Array) -> float:
    return float(np.median(np.diff(t_ns))) if len(t_ns) > 1 else 0.0


def _filled(observations: Observations, t_ns: Array, rows: Array, places: Array, ids: Array) -> _CameraFrames:
    """Detections `rows` of people `ids`, each in the frame at its place."""
    by_id = np.argsort(ids)
    planes = unseen_planes((len(t_ns), len(ids), len(observations.skeleton)), observations.depth_m is not None)
    at = (places, by_id[np.searchsorted(ids[by_id], observations.person_id[rows])]) if len(ids) else (places, places)
    for name, plane in planes.items():
        plane[at] = getattr(observations, name)[rows]
    return _CameraFrames(t_ns, planes)


def _at_times(t_ns: Array, frames: _CameraFrames, own: Array, alone: Array, reach_ns: float, skeleton: Skeleton) -> _CameraFrames:
    """Keypoints at times (T,), each from its own frame and the one on its other side.

    Depths, where there are any, are unknown as soon as one of the two frames does not know it.

    Args:
        own, alone, reach_ns: as in `_CameraTrack`.
    """
    found = frames.at(own)
    late_ns = found.t_ns - t_ns
    other = own + np.where(late_ns > 0, -1, 1)
    i = np.flatnonzero((np.abs(late_ns) > _SAME_TIME_NS) & (other >= 0) & (other < len(frames.t_ns)))
    span_ns = frames.t_ns[other[i]] - found.t_ns[i]
    near = (span_ns != 0) & (np.abs(span_ns) <= reach_ns)
    i, span_ns = i[near], span_ns[near]
    before, after = found.at(i), frames.at(other[i])
    _name_sides_like(before, after, skeleton)
    share = np.clip(-late_ns[i] / span_ns, 0, 1)[:, None, None]
    blended = (before.planes["score"] > 0) & (after.planes["score"] > 0)
    both = np.zeros(found.planes["score"].shape, np.bool_)
    both[i] = blended
    unseen = ~both & ~alone[:, None, None]
    for name, plane in found.planes.items():
        one, two, wide = before.planes[name], after.planes[name], (..., *[None] * (plane.ndim - 3))
        # a detector errs alike in neighbouring frames, so blending two does not make it surer
        between = np.minimum(one, two) if name == "score" else one * (1 - share[wide]) + two * share[wide]
        plane[i] = np.where(blended[wide], between, one)
        plane[unseen] = 0.0 if name == "score" else np.nan
    return found


def _name_sides_like(own: _CameraFrames, other: _CameraFrames, skeleton: Skeleton) -> None:
    """Swap left and right of a limb in `other`, in place, wherever that takes it nearer to `own`.

    Halfway between a leg and the other leg there is none: such a keypoint is wrong whichever frame was right, and no later
    correction of sides can mend it. Without this, rendered walks in views of 15 Hz are 0.1 to 1.5 mm farther off.
    """
    for left, right in skeleton.limbs:
        seen = np.all([one.planes["score"][..., limb] > 0 for one in (own, other) for limb in (left, right)], axis=0)
        as_named = _away_px(own, other, left, left) + _away_px(own, other, right, right)
        swapped = _away_px(own, other, left, right) + _away_px(own, other, right, left)
        wrong = np.where(seen, as_named - swapped, 0.0).sum(axis=-1) > 0
        for plane in other.planes.values():
            swap_sides(plane, wrong, left, right)


def _away_px(own: _CameraFrames, other: _CameraFrames, limb: Array, other_limb: Array) -> Array:
    """(F, N, k) from keypoints `limb` of one frame to keypoints `other_limb` of the other frame."""
    return np.asarray(np.linalg.norm(other.planes["xy_img"][..., other_limb, :] - own.planes["xy_img"][..., limb, :], axis=-1))
