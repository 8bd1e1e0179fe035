"""Second pass: every time step fused again from all views, gaps and noise treated over time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from posefuse.core import InputError, JointCentres, Kind, Observations, PoseSequence, Recording, Rig, ViewSequence
from posefuse.core.arrays import Array, give_away, take_back
from posefuse.core.poses import WrittenPoses, point_sigma_m
from posefuse.core.view_sequences import PartsOfViews, ViewsInParts, people_in
from posefuse.fusion import FuseSettings, fuse, fuse_over_time
from posefuse.kinematics import facing_votes
from posefuse.kinematics.body import BodySettings, fit_views
from posefuse.tracking import (
    SmoothSettings,
    ViewsAtJointCentres,
    smooth,
    smooth_in_place,
    steady_sides,
    to_joint_centres,
    usual_lengths,
)
from posefuse.tracking.sides import parts_of_steps, sides_that_differ, with_sides_swapped

# a person followed in fewer time steps than this is not one
_LEAST_STEPS = 5
# rounds of naming sides at most: most recordings settle after two or three, and one that alternates must come to an end
_NAMING_ROUNDS = 10
# a longer recording is solved in blocks of so many time steps (11 min at 30 Hz), with so many more before and after each: what
# is neither observation nor result does not grow with the length
_BLOCK_STEPS, _OVERLAP_STEPS = 20_000, 300
# time steps whose views are fused together: lenses are removed from all of them in hardly more time than from one
_FUSED_STEPS = 100


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
    views: PartsOfViews,
    rig: Rig,
    fusing: FuseSettings,
    smoothing: SmoothSettings | None,
    centres: JointCentres | None = None,
) -> PoseSequence:
    """Fuse every time step, move keypoints to joint centres (with `centres`), then (with `smoothing`) treat gaps and noise over
    the whole recording.

    With ``robust`` weights the recording is first steadied over time and then every view's limbs are named left and right as
    the steadied recording has them: when legs pass each other, several views confuse them at once and no single time step can
    show it. A long recording is solved in blocks that overlap: equal to the whole within 0.1 mm.
    """
    count = len(views.t_ns)
    if count <= _BLOCK_STEPS:
        return _block_over_time(views, rig, fusing, smoothing, centres)
    written = None
    for begin in range(0, count, _BLOCK_STEPS):
        first, end = max(begin - _OVERLAP_STEPS, 0), min(begin + _BLOCK_STEPS, count)
        around = _Section(views, slice(first, min(end + _OVERLAP_STEPS, count)))
        poses = _block_over_time(around, rig, fusing, smoothing, centres)
        written = written or WrittenPoses(views.t_ns, poses.skeleton, poses.person_id)
        written.write(slice(begin, end), poses.part(slice(begin - first, end - first)))
    assert written is not None
    return written.sequence()


class _Section:
    """The views of some of the time steps, made when a part of them is asked for."""

    def __init__(self, views: PartsOfViews, steps: slice) -> None:
        self._views, self._first, self.t_ns = views, steps.start, views.t_ns[steps]

    def part(self, steps: slice) -> ViewSequence:
        """These time steps, counted from the first of the section."""
        return self._views.part(slice(self._first + steps.start, self._first + min(steps.stop, len(self.t_ns))))


def _block_over_time(
    views: PartsOfViews, rig: Rig, fusing: FuseSettings, smoothing: SmoothSettings | None, centres: JointCentres | None
) -> PoseSequence:
    if fusing.weights == "robust":
        fused = _fused_with_sides_corrected(views, rig, fusing, smoothing or SmoothSettings())
    else:
        fused = _fused_over_time(views, rig, fusing)
    fused = to_joint_centres(fused, centres) if centres else fused
    return smooth(fused, smoothing) if smoothing else fused


def _fused_over_time(views: PartsOfViews, rig: Rig, fusing: FuseSettings) -> PoseSequence:
    written, last = None, None
    for part in parts_of_steps(len(views.t_ns)):
        seen = views.part(part)
        written = written or WrittenPoses(views.t_ns, seen.skeleton, seen.person_id)
        if fusing.weights != "all":
            for steps in _fused_at_once(np.arange(len(seen.t_ns))):
                written.write(part.start + steps, fuse_over_time(seen.part(steps), rig, fusing))
            continue
        for i in range(len(seen.t_ns)):
            last = fuse(seen.at(i), rig, fusing, last)
            written.write(part.start + i, last)
    assert written is not None
    return written.sequence()


def _fused_at_once(steps: Array) -> Iterator[Array]:
    return (steps[first : first + _FUSED_STEPS] for first in range(0, len(steps), _FUSED_STEPS))


def _fused_with_sides_corrected(views: PartsOfViews, rig: Rig, fusing: FuseSettings, smoothing: SmoothSettings) -> PoseSequence:
    """Time steps fused, then again from views whose limbs are named left and right as the recording steadied over time has them.

    Where the first reference was still wrong, a better one names more views right: repeated until no view changes.
    """
    fused = _fused_over_time(views, rig, fusing)
    swapped = [np.zeros(1, bool)] * len(parts_of_steps(len(fused)))
    for _ in range(_NAMING_ROUNDS):
        again = _fused_again(fused, *_steadied_points(fused, smoothing), swapped, views, rig, fusing)
        if again is None:
            break
        fused = again
    return fused


def _fused_again(
    fused: PoseSequence,
    reference: Array,
    sigma_m: Array,
    swapped: list[Array],
    views: PartsOfViews,
    rig: Rig,
    fusing: FuseSettings,
) -> PoseSequence | None:
    """The poses with those time steps fused again whose views have other limbs `swapped` than before; None where none has."""
    written = None
    for place, part in enumerate(parts_of_steps(len(fused))):
        seen = views.part(part)
        wrong = sides_that_differ(reference[part], rig, seen, sigma_m[part])
        differing = np.flatnonzero((wrong != swapped[place]).any(axis=(1, 2, 3)))
        swapped[place] = wrong
        if not len(differing):
            continue
        if written is None:
            written = WrittenPoses(fused.t_ns, fused.skeleton, fused.person_id)
            written.write(slice(None), fused)
        named = with_sides_swapped(seen, wrong)
        for steps in _fused_at_once(differing):
            written.write(part.start + steps, fuse_over_time(named.part(steps), rig, fusing))
    return written.sequence() if written else None


def _steadied_points(fused: PoseSequence, smoothing: SmoothSettings) -> tuple[Array, Array]:
    """Points (T, N, K, 3), and (T, N, K) how well they are known: in a gap of a fast arm they may be far off."""
    xyz, cov = steady_sides(fused, facing_votes(fused))
    smooth_in_place(fused.t_ns, fused.skeleton, xyz, cov, smoothing)
    return xyz, point_sigma_m(cov)


# The last step of a solve: one skeleton of constant segment lengths per person, fitted to what all views saw.

_LIMB_JOINTS = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
# a limb counts as hidden where one of its joints was not measured in more than this share of the time steps; on people in full
# view all were below 0.01, but for one who turned on the spot (0.05)
_HIDDEN_SHARE = 0.05


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


def fit_bodies_in_place(
    recording: Recording,
    views: ViewSequence | ViewsInParts,
    settings: BodySettings,
    centres: JointCentres | None,
    *,
    only_hidden: bool = False,
) -> Recording:
    """The recording with the poses of fitted skeletons; with `only_hidden` of those people whose limbs were hidden.

    Segment lengths and poses are solved from `views`, so that a joint in one view alone still counts; the recording's poses are
    where that starts, and where the fitted ones are written: of an hour, both take much memory. People who were not seen well
    enough to have a skeleton keep their poses; the provenance names the others (``fitted_people``).
    """
    poses, rig = recording.poses, recording.rig
    chosen = hidden_people(poses) if only_hidden else set(poses.person_id.tolist())
    if not chosen:
        return recording
    fitted: list[int] = []
    for n, person in enumerate(poses.person_id.tolist()):
        if person not in chosen:
            continue
        alone = slice(n, n + 1)
        start = poses.people(alone)
        rays = ViewsAtJointCentres(start, rig, views.people(alone), centres)
        try:
            fit = fit_views(start, rig, rays, settings, usual_lengths())
        except InputError:  # this person has no skeleton, or left and right are swapped
            continue
        fitted += sorted(fit.bodies)
        if len(poses.person_id) > 1:
            for name in ("xyz_world", "cov_world", "kind"):
                plane = getattr(poses, name)
                take_back(plane)
                plane[:, n] = getattr(fit.poses, name)[:, 0]
                give_away(plane)
    if not fitted:
        return recording
    return replace(recording, provenance={**recording.provenance, "fitted_people": fitted})
