"""The last step of a solve: one skeleton of constant segment lengths per person, fitted to what all views saw."""

from __future__ import annotations

from dataclasses import replace

from posefuse.core import InputError, JointCentres, Recording, ViewSequence
from posefuse.core.joint_centres import SEGMENT_ENDS
from posefuse.kinematics.body import BodySettings, LengthPrior, fit_views
from posefuse.tracking import usual_lengths, views_at_joint_centres


def usual_length_prior() -> LengthPrior:
    """Segment lengths of people in general."""
    mean, cov = usual_lengths()
    return LengthPrior(names=tuple(SEGMENT_ENDS), mean_m=mean, cov_m2=cov)


def with_bodies(recording: Recording, views: ViewSequence, settings: BodySettings, centres: JointCentres | None) -> Recording:
    """The recording with the poses of fitted skeletons.

    Segment lengths and poses are solved from `views`, so that a joint in one view alone still counts; the recording's poses are
    where that starts. People who were not seen well enough to have a skeleton keep their poses; the provenance names the others
    (``fitted_people``).
    """
    rays = views_at_joint_centres(recording.poses, recording.rig, views, centres)
    try:
        fit = fit_views(recording.poses, recording.rig, rays, settings, lengths=usual_length_prior())
    except InputError:  # no person has a skeleton
        return recording
    people = sorted(person for person in recording.poses.person_id.tolist() if person in fit.bodies)
    return replace(recording, poses=fit.poses, provenance={**recording.provenance, "fitted_people": people})
