"""Second pass: every time step fused again from all views, gaps and noise treated over time."""

from __future__ import annotations

from dataclasses import replace

from posefuse.core import InputError, JointCentres, Observations, Pose3D, PoseSequence, Rig, ViewSequence
from posefuse.core.views_over_time import people_in
from posefuse.fusion import FuseSettings, fuse
from posefuse.kinematics import facing_votes
from posefuse.tracking import SmoothSettings, sides_like, smooth, steady_sides, to_joint_centres

# a person followed in fewer time steps than this is not one
_LEAST_STEPS = 5


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
    fused = _fused(views, rig, fusing)
    if fusing.weights == "robust" and fusing.swap_correction:
        named = replace(fusing, swap_correction=False)
        reference = smooth(steady_sides(fused, facing_votes(fused)), smoothing or SmoothSettings())
        fused = _fused(sides_like(reference, rig, views), rig, named)
    fused = to_joint_centres(fused, centres) if centres else fused
    return smooth(fused, smoothing) if smoothing else fused


def _fused(views: ViewSequence, rig: Rig, fusing: FuseSettings) -> PoseSequence:
    poses: list[Pose3D] = []
    for i in range(len(views.t_ns)):
        poses.append(fuse(views.at(i), rig, fusing, poses[-1] if poses else None))
    return PoseSequence.from_poses(poses)
