"""The log of a recording: every detection of every camera, raw, at its own exposure time."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import DTypeLike

from .arrays import Array, FrozenArrays, frozen, frozen_fields, give_away, taken
from .depth import joined_depth
from .errors import ShapeError, choices
from .skeleton import Skeleton
from .values import DETECTION_ARRAYS, DETECTION_DTYPES, Detections2D, check_keypoints, freeze_depth

LIVE_STEP = -1
NOT_KEPT = -1


class LookKind(IntEnum):
    """Why the detector looked at the frames of a time step; in this order, where there are several looks."""

    EXPECTED = 0  # at the regions in which the people of earlier time steps are expected
    SEARCH = 1  # at whole images
    SECOND = 2  # at the regions of the people that the search found in other views
    STATED = 3  # it did not: another tool has detected them, and this is the answer to every look


@dataclass(frozen=True, eq=False, kw_only=True)
class DetectionBatch:
    """The detector's answer to one look at the frames of one time step.

    Attributes:
        step: time step of the recording, counted from 0. t_ns: its time, session clock.
        kind: why the detector looked.
        detections: one entry per camera that has a frame, in the order of the rig, each at its own exposure time.
    """

    step: int
    t_ns: int
    kind: LookKind
    detections: tuple[Detections2D, ...]


_DTYPES: dict[str, DTypeLike] = {
    "frame_camera": np.int16,
    "frame_step": np.int32,
    "frame_look": np.uint8,
    "n_detections": np.int32,
} | DETECTION_DTYPES
_AXES = {
    "step_t_ns": "T",
    "frame_camera": "F",
    "frame_t_ns": "F",
    "frame_step": "F",
    "frame_look": "F",
    "n_detections": "F",
    "person_id": "R",
} | {name: axes.replace("P", "R") for name, axes in DETECTION_ARRAYS.items()}
OBSERVATION_ARRAYS = tuple(_AXES)


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Observations(FrozenArrays):
    """Every detection of every camera at its own exposure time; nothing is resampled and nothing is thrown away.

    Two tables, F frames and R detections; the detections of one frame follow each other. A frame that the detector looked
    at several times has several rows.

    Attributes:
        skeleton: names axis K.
        camera_names: axis C, as in the rig.
        step_t_ns: (T,) time steps common to all cameras, session clock; empty for a live session.
        frame_camera: (F,) index in camera_names. Frames are in the order in which the detector answered.
        frame_t_ns: (F,) mid-exposure, session clock.
        frame_step: (F,) the time step that the frame belongs to; -1 live.
        frame_look: (F,) uint8 of `LookKind`.
        n_detections: (F,) detections in the frame.
        person_id: (R,) -1: belongs to no person of the result.
        xy_img: (R, K, 2) float32 raw distorted px; NaN where a keypoint is missing.
        score: (R, K) float32; 0 where missing.
        sigma_px: (R, K) float32; NaN where missing.
        box_img: (R, 4) float32 left, top, right, bottom.
        clothing_lab: (R, 3, 3) float32, track_id: (R,) as in `Detections2D`.
        depth_m: (R, K, 2) float32 as in `Detections2D`; None where no camera has depth.

    Raises:
        ShapeError: arrays that do not fit together, or a person who is twice in one camera at one time step.
    """

    skeleton: Skeleton
    camera_names: tuple[str, ...]
    step_t_ns: Array
    frame_camera: Array
    frame_t_ns: Array
    frame_step: Array
    frame_look: Array
    n_detections: Array
    person_id: Array
    xy_img: Array
    score: Array
    sigma_px: Array
    box_img: Array
    clothing_lab: Array
    track_id: Array
    depth_m: Array | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "camera_names", tuple(self.camera_names))
        sizes = frozen_fields(self, _AXES, _DTYPES)
        check_keypoints(self, sizes)
        freeze_depth(self, np.float32)
        _check_range("frame_camera", self.frame_camera, 0, len(self.camera_names))
        _check_range("frame_step", self.frame_step, LIVE_STEP, sizes["T"])
        if (np.diff(self.step_t_ns) <= 0).any():
            raise ShapeError("Observations.step_t_ns: expected strictly increasing times")
        if (self.n_detections < 0).any() or self.n_detections.sum() != sizes["R"]:
            raise ShapeError(
                f"Observations.n_detections: expected counts that add up to the {sizes['R']} detections, "
                f"got {int(self.n_detections.sum())}"
            )
        self._check_people()

    def _check_people(self) -> None:
        frame = self.detection_frame
        kept = (self.person_id != NOT_KEPT) & (self.frame_step[frame] != LIVE_STEP)
        who = np.stack([self.person_id[kept], self.frame_step[frame[kept]], self.frame_camera[frame[kept]]])
        if np.unique(who, axis=1).shape[1] != who.shape[1]:
            raise ShapeError("Observations.person_id: expected a person at most once in one camera at one time step")

    def __len__(self) -> int:
        """How many detections."""
        return len(self.person_id)

    def __repr__(self) -> str:
        return (
            f"Observations({len(self)} detections in {self.image_count} images of {len(self.camera_names)} cameras, "
            f"{self.skeleton.name}, {len(self.step_t_ns)} time steps)"
        )

    @cached_property
    def image_count(self) -> int:
        """How many images were looked at, each once."""
        return sum(map(len, camera_times(self).values()))

    @cached_property
    def frame_begin(self) -> Array:
        """(F + 1,) the first detection of each frame, and the number of all."""
        return frozen(np.concatenate([[0], np.cumsum(self.n_detections, dtype=np.int64)]), np.int64, "frame_begin")

    @cached_property
    def detection_frame(self) -> Array:
        """(R,) the frame of each detection."""
        frame = np.repeat(np.arange(len(self.n_detections)), self.n_detections)
        give_away(frame)
        return frame

    def detections(self, i: int, rows: Array | None = None) -> Detections2D:
        """Row i of the frame table: all that one look found in one frame, or these rows of the detection table instead."""
        return Detections2D(
            camera=self.camera_names[self.frame_camera[i]],
            t_ns=int(self.frame_t_ns[i]),
            skeleton=self.skeleton,
            **self.rows(slice(self.frame_begin[i], self.frame_begin[i + 1]) if rows is None else rows),
        )

    def rows(self, rows: Array | slice) -> dict[str, Any]:
        """These rows of the detection table, by the names of `Detections2D`."""
        return taken(self, (*DETECTION_ARRAYS, "depth_m"), rows)

    def of(self, camera: str) -> Observations:
        """What one camera observed; raises ShapeError for a name that is not there."""
        if camera not in self.camera_names:
            raise ShapeError(f"Observations: no camera {camera!r}; there are: {choices(self.camera_names)}")
        mine = self.only(self.frame_camera == self.camera_names.index(camera))
        return replace(mine, camera_names=(camera,), frame_camera=np.zeros(len(mine.frame_t_ns)))

    def only(self, frames: Array) -> Observations:
        """The log of these frames (F,) bool alone; the time steps stay."""
        rows = frames[self.detection_frame]
        of_frames = taken(self, [name for name, axes in _AXES.items() if axes == "F"], frames)
        return replace(self, person_id=self.person_id[rows], **of_frames, **self.rows(rows))

    def part(self, steps: slice) -> Observations:
        """The log of these time steps alone, counted from 0 again; frames that belong to none are left out."""
        t_ns = self.step_t_ns[steps]
        # the last one is that of frames without a time step
        number = np.full(len(self.step_t_ns) + 1, LIVE_STEP)
        number[:-1][steps] = np.arange(len(t_ns))
        step = number[self.frame_step]
        kept = step != LIVE_STEP
        return replace(self.only(kept), step_t_ns=t_ns, frame_step=step[kept])

    def with_person_ids(self, person_id: Array) -> Observations:
        """The same detections with other people (R,)."""
        return replace(self, person_id=person_id)

    def keeping(self, people: Iterable[int]) -> Observations:
        """The same detections; those of other people belong to no person any more."""
        return self.with_person_ids(np.where(np.isin(self.person_id, list(people)), self.person_id, NOT_KEPT))

    @staticmethod
    def concatenate(parts: Sequence[Observations]) -> Observations:
        """One log after the other; the time steps of each follow those of the one before.

        Raises:
            ShapeError: no part, another skeleton or other cameras.
        """
        if not parts:
            raise ShapeError("Observations.concatenate: expected at least 1 part, got 0")
        first = parts[0]
        if any(part.skeleton != first.skeleton or part.camera_names != first.camera_names for part in parts):
            raise ShapeError("Observations.concatenate: expected the same skeleton and cameras in every part")
        shifts = np.cumsum([0, *(len(part.step_t_ns) for part in parts)])
        joined = {name: np.concatenate([getattr(part, name) for part in parts]) for name in _AXES}
        steps = [
            np.where(p.frame_step == LIVE_STEP, LIVE_STEP, p.frame_step + s) for p, s in zip(parts, shifts[:-1], strict=True)
        ]
        joined["frame_step"] = np.concatenate(steps)
        return Observations(skeleton=first.skeleton, camera_names=first.camera_names, depth_m=joined_depth(parts), **joined)

    @staticmethod
    def from_batches(skeleton: Skeleton, camera_names: Sequence[str], batches: Sequence[DetectionBatch]) -> Observations:
        """The log of a recording; no people yet.

        Args:
            skeleton: of all detections.
            camera_names: axis C.
            batches: in the order in which they were made; every time step from 0 on has at least one.

        Raises:
            ShapeError: a time step without a batch, a camera that is not among `camera_names`.
        """
        frames = [one for batch in batches for one in batch.detections]
        times = {batch.step: batch.t_ns for batch in batches}
        if sorted(times) != list(range(len(times))):
            raise ShapeError("Observations: expected a batch for every time step from 0 on")
        log = observations_from_frames(skeleton, camera_names, frames)
        return replace(
            log,
            step_t_ns=np.array([times[step] for step in range(len(times))], np.int64),
            frame_step=np.array([batch.step for batch in batches for _ in batch.detections], np.int32),
            frame_look=np.array([batch.kind for batch in batches for _ in batch.detections], np.uint8),
        )


def _check_range(name: str, values: Array, least: int, end: int) -> None:
    if len(values) and (values.min() < least or values.max() >= end):
        raise ShapeError(
            f"Observations.{name}: expected values from {least} to {end - 1}, got {int(values.min())} to {int(values.max())}"
        )


# Observations of cameras that have no common time steps: those of a live session, and bringing them to time steps.


def observations_from_frames(skeleton: Skeleton, camera_names: Sequence[str], frames: Sequence[Detections2D]) -> Observations:
    """The log of a live session: frames in the order in which the detector answered, no time steps, no people yet.

    Args:
        skeleton: of all detections. camera_names: axis C.

    Raises:
        ShapeError: a camera that is not among `camera_names`, or another skeleton.
    """
    place = {name: c for c, name in enumerate(camera_names)}
    unknown = sorted({one.camera for one in frames} - set(place))
    if unknown:
        raise ShapeError(f"Observations: no camera {choices(unknown)}; there are: {choices(camera_names)}")
    other = sorted({one.skeleton.name for one in frames if one.skeleton != skeleton})
    if other:
        raise ShapeError(f"Observations: expected detections of skeleton {skeleton.name}, got {choices(other)}")
    found = [Detections2D.empty("", 0, skeleton), *frames]
    joined = {name: np.concatenate([getattr(one, name) for one in found]) for name in DETECTION_ARRAYS}
    return Observations(
        skeleton=skeleton,
        camera_names=tuple(camera_names),
        step_t_ns=np.zeros(0, np.int64),
        frame_camera=np.array([place[one.camera] for one in frames], np.int16),
        frame_t_ns=np.array([one.t_ns for one in frames], np.int64),
        frame_step=np.full(len(frames), LIVE_STEP),
        frame_look=np.full(len(frames), LookKind.EXPECTED),
        n_detections=np.array([len(one) for one in frames], np.int32),
        person_id=np.full(len(joined["score"]), NOT_KEPT),
        depth_m=joined_depth(found),
        **joined,
    )


def camera_times(observations: Observations) -> Mapping[str, Array]:
    """(F,) increasing times of each camera's frames, by name; only cameras that have any."""
    times = {
        name: np.unique(observations.frame_t_ns[observations.frame_camera == c])
        for c, name in enumerate(observations.camera_names)
    }
    return {name: t_ns for name, t_ns in times.items() if len(t_ns)}


def on_time_steps(observations: Observations, step_t_ns: Array) -> Observations:
    """The same log with other time steps (T,), evenly spaced; person ids are removed.

    Each camera gives to a time step the frame nearest to it within half a period, and no frame to two. Frames that are
    nearest to no time step stay in the log and belong to none.
    """
    t_ns = np.asarray(step_t_ns, np.int64)
    reach_ns = int(np.median(np.diff(t_ns))) // 2 if len(t_ns) > 1 else np.iinfo(np.int32).max
    step = np.searchsorted(t_ns + reach_ns, observations.frame_t_ns)
    late_ns = np.abs(observations.frame_t_ns - t_ns[step.clip(max=len(t_ns) - 1)])
    step = np.where((step < len(t_ns)) & (late_ns <= reach_ns), step, LIVE_STEP)
    order = np.lexsort((late_ns, observations.frame_camera, step))
    same = (np.diff(step[order]) == 0) & (np.diff(observations.frame_camera[order]) == 0)
    step[order[1:][same]] = LIVE_STEP
    return replace(observations, step_t_ns=t_ns, frame_step=step, person_id=np.full(len(observations), NOT_KEPT))
