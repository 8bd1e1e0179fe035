"""Observations of cameras that have no common time steps: those of a live session, and bringing them to time steps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from .arrays import Array
from .depth import joined_depth
from .errors import ShapeError, choices
from .observations import LIVE_STEP, NOT_KEPT, LookKind, Observations
from .skeleton import Skeleton
from .values import DETECTION_ARRAYS, Detections2D


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
