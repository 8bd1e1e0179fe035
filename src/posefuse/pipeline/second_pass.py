"""Second pass: every time step fused again from all views, gaps and noise treated over time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from posefuse.core import InputError, JointCentres, Observations, Pose3D, PoseSequence, Rig, ViewSequence
from posefuse.core.arrays import Array
from posefuse.core.views_over_time import people_in
from posefuse.fusion import FuseSettings, fuse
from posefuse.kinematics import facing_votes
from posefuse.tracking import SmoothSettings, sides_like, smooth, steady_sides, to_joint_centres

# a person followed in fewer time steps than this is not one
_LEAST_STEPS = 5
# rounds of naming sides at most: most recordings settle after two or three, and one that alternates must come to an end
_NAMING_ROUNDS = 10


def long_enough(observations: Observations) -> list[int]:
    """The people who were followed long enough to be in the result.

    Raises:
        InputError: no person was followed in at least a few time steps.
    """
    ids, counts = people_in(observations)
    kept = ids[counts >= min(_LEAST_STEPS, len(observations.step_t_ns))]
    if len(kept) == 0:
        raise InputError("no person could be followed in at least two cameras at once")
    people: list[int] = kept.tolist()
    return people


def poses_over_time(
    views: ViewSequence,
    rig: Rig,
    fusing: FuseSettings,
    smoothing: SmoothSettings | None,
    centres: JointCentres | None = None,
) -> PoseSequence:
    """Fuse every time step, move keypoints to joint centres (with `centres`), then (with `smoothing`) treat gaps and noise over
    the whole recording.

    Where left/right swaps may be corrected, the recording is first steadied over time and then every view's limbs are named
    left and right as the steadied recording has them: when legs pass each other, several views confuse them at once and no
    single time step can show it.
    """
    fused = _fused_over_time(views, rig, fusing, smoothing)
    fused = to_joint_centres(fused, centres) if centres else fused
    return smooth(fused, smoothing) if smoothing else fused


def _fused_over_time(views: ViewSequence, rig: Rig, fusing: FuseSettings, smoothing: SmoothSettings | None) -> PoseSequence:
    poses: list[Pose3D] = []
    for i in range(len(views.t_ns)):
        poses.append(fuse(views.at(i), rig, fusing, poses[-1] if poses else None))
    if fusing.weights == "robust" and fusing.swap_correction:
        _correct_sides(poses, views, rig, replace(fusing, swap_correction=False), smoothing or SmoothSettings())
    return PoseSequence.from_poses(poses)


def _correct_sides(poses: list[Pose3D], views: ViewSequence, rig: Rig, fusing: FuseSettings, smoothing: SmoothSettings) -> None:
    """Fuse time steps again, in place, from views whose limbs are named left and right as the recording steadied over time has
    them.

    Where the first reference was still wrong, a better one names more views right: repeated until no view changes.
    """
    named = None
    for _ in range(_NAMING_ROUNDS):
        before, named = named, sides_like(_steadied(poses, smoothing), rig, views)
        changed = _steps_that_differ(before, named)
        if not len(changed):
            break
        for i in changed.tolist():
            poses[i] = fuse(named.at(i), rig, fusing)


def _steadied(poses: list[Pose3D], smoothing: SmoothSettings) -> PoseSequence:
    fused = PoseSequence.from_poses(poses)
    return smooth(steady_sides(fused, facing_votes(fused)), smoothing)


def _steps_that_differ(before: ViewSequence | None, after: ViewSequence) -> Array:
    """Time steps in which some keypoint of a view is another one than before; all where there was none before."""
    steps = len(after.t_ns)
    if before is None:
        return np.arange(steps)
    same = (before.xy_img == after.xy_img) | (np.isnan(before.xy_img) & np.isnan(after.xy_img))
    return np.flatnonzero(~same.reshape(steps, -1).all(axis=1))
