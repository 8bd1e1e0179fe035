"""The last step of a solve: one skeleton of constant segment lengths per person, fitted to what all views saw."""

from __future__ import annotations

from dataclasses import replace

from posefuse.core import InputError, JointCentres, Kind, PoseSequence, Recording, ViewSequence
from posefuse.core.arrays import Array, give_away
from posefuse.core.joint_centres import SEGMENT_ENDS
from posefuse.core.view_sequences import ViewsInParts
from posefuse.kinematics.body import BodySettings, LengthPrior, fit_views
from posefuse.tracking import ViewsAtJointCentres, usual_lengths

_LIMB_JOINTS = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
# a limb counts as hidden where one of its joints was not measured in more than this share of the time steps; on people in full
# view all were below 0.01, but for one who turned on the spot (0.05)
_HIDDEN_SHARE = 0.05


def usual_length_prior() -> LengthPrior:
    """Segment lengths of people in general."""
    mean, cov = usual_lengths()
    return LengthPrior(names=tuple(SEGMENT_ENDS), mean_m=mean, cov_m2=cov)


def hidden_people(poses: PoseSequence) -> set[int]:
    """The people of whom a limb was out of sight for a part of the time in which they were seen."""
    names = [name for joint in _LIMB_JOINTS for name in (f"left_{joint}", f"right_{joint}") if name in poses.skeleton.keypoints]
    seen = poses.kind != Kind.MISSING
    measured = seen & (poses.kind != Kind.INTERPOLATED)
    found = set()
    for n, person in enumerate(poses.person_id.tolist()):
        there = seen[:, n].any(axis=1)
        joints = measured[there, n][:, poses.skeleton.indices(names)]
        if (~joints).sum(axis=0).max(initial=0) > _HIDDEN_SHARE * len(joints):
            found.add(person)
    return found


def with_bodies(
    recording: Recording,
    views: ViewSequence | ViewsInParts,
    settings: BodySettings,
    centres: JointCentres | None,
    *,
    only_hidden: bool = False,
) -> Recording:
    """The recording with the poses of fitted skeletons; with `only_hidden` of those people whose limbs were hidden.

    Segment lengths and poses are solved from `views`, so that a joint in one view alone still counts; the recording's poses are
    where that starts. People who were not seen well enough to have a skeleton keep their poses; the provenance names the others
    (``fitted_people``).
    """
    poses, rig = recording.poses, recording.rig
    chosen = hidden_people(poses) if only_hidden else set(poses.person_id.tolist())
    if not chosen:
        return recording
    fitted: list[int] = []
    planes: dict[str, Array] = {}
    for n, person in enumerate(poses.person_id.tolist()):
        if person not in chosen:
            continue
        alone = slice(n, n + 1)
        start = poses.people(alone)
        rays = ViewsAtJointCentres(start, rig, views.people(alone), centres)
        try:
            fit = fit_views(start, rig, rays, settings, lengths=usual_length_prior())
        except InputError:  # this person has no skeleton, or left and right are swapped
            continue
        fitted += sorted(fit.bodies)
        # not before: in an hour, they take as much memory as what a fit works on
        planes = planes or {name: getattr(poses, name).copy() for name in ("xyz_world", "cov_world", "kind")}
        for name, plane in planes.items():
            plane[:, n] = getattr(fit.poses, name)[:, 0]
    if not fitted:
        return recording
    give_away(*planes.values())
    return replace(recording, poses=replace(poses, **planes), provenance={**recording.provenance, "fitted_people": fitted})
