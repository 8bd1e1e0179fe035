"""The last step of a solve: one skeleton of constant segment lengths per person, fitted to what all views saw."""

from __future__ import annotations

from dataclasses import replace

from posefuse.core import InputError, Recording, ViewSequence
from posefuse.kinematics.body import BodySettings, fit_views
from posefuse.tracking import JointCentres, views_at_joint_centres


def with_bodies(recording: Recording, views: ViewSequence, settings: BodySettings, centres: JointCentres | None) -> Recording:
    """The recording with the poses of fitted skeletons.

    Lengths and the start come from the recording's poses, the rest from `views`, so that a joint in one view alone still
    counts. People who were not seen well enough to have a skeleton keep their poses.
    """
    rays = views_at_joint_centres(recording.poses, recording.rig, views, centres)
    try:
        fit = fit_views(recording.poses, recording.rig, rays, settings)
    except InputError:  # no person has a skeleton
        return recording
    return replace(recording, poses=fit.poses)
