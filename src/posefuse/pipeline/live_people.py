"""Which person of a live session's poses a detection shows: messages of detections do not have it."""

from __future__ import annotations

import numpy as np

from posefuse.core import Camera, Observations, PoseSequence, Rig
from posefuse.core.arrays import Array
from posefuse.core.observations import NOT_KEPT

# a detection farther from a person's projection than this share of the projection's extent shows another person
_MOST_OFF_SHARE = 0.25
# the pose nearest in time counts for a frame if it is this close
_NEAR_NS = 100_000_000


def people_of_detections(observations: Observations, rig: Rig, poses: PoseSequence) -> Array:
    """(R,) the person whose pose, seen by the camera at the frame's time, is nearest to each detection; -1: no person.

    In one frame a person has the nearest detection only.
    """
    frame = observations.detection_frame
    people = np.full(len(observations), NOT_KEPT, np.int64)
    if not len(poses.person_id):
        return people
    for c, camera in enumerate(rig):
        rows = np.flatnonzero(observations.frame_camera[frame] == c)
        if not len(rows):
            continue
        off = _off_share(camera, observations.xy_img[rows], observations.frame_t_ns[frame[rows]], poses)
        nearest = off.argmin(axis=1)
        share = off[np.arange(len(rows)), nearest]
        order = np.lexsort((share, nearest, frame[rows]))
        first = np.ones(len(rows), np.bool_)
        first[1:] = (np.diff(frame[rows][order]) != 0) | (np.diff(nearest[order]) != 0)
        chosen = order[first & (share[order] < _MOST_OFF_SHARE)]
        people[rows[chosen]] = poses.person_id[nearest[chosen]]
    return people


def _off_share(camera: Camera, xy_img: Array, t_ns: Array, poses: PoseSequence) -> Array:
    """(R, N) median distance of a detection's keypoints from each person's projection, per extent of the latter; else inf."""
    after = np.searchsorted(poses.t_ns, t_ns).clip(1, max(len(poses) - 1, 1))
    before, after = after - 1, after.clip(max=len(poses) - 1)
    tick = np.where(t_ns - poses.t_ns[before] <= poses.t_ns[after] - t_ns, before, after)
    shown = camera.project(poses.xyz_world[tick])
    shown[np.abs(poses.t_ns[tick] - t_ns) > _NEAR_NS] = np.nan
    apart = np.linalg.norm(xy_img[:, None] - shown, axis=-1)
    there = np.isfinite(apart).any(axis=-1)
    off = np.full(there.shape, np.inf)
    seen = shown[there]
    extent = (np.nanmax(seen, axis=1) - np.nanmin(seen, axis=1)).max(axis=-1)
    off[there] = np.nanmedian(apart[there], axis=-1) / np.maximum(extent, 1.0)
    return off
