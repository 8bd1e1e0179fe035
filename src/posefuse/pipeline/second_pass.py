"""Second pass: every time step fused again from all views, gaps and noise treated over time."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from posefuse.core import InputError, JointCentres, Observations, PoseSequence, Rig, ViewSequence
from posefuse.core.arrays import Array, give_away
from posefuse.core.view_sequences import ViewsInParts, people_in
from posefuse.fusion import FuseSettings, fuse
from posefuse.kinematics import facing_votes
from posefuse.tracking import SmoothSettings, smooth, smooth_in_place, steady_sides, to_joint_centres
from posefuse.tracking.sides import parts_of_steps, sides_that_differ, with_sides_exchanged

# a person followed in fewer time steps than this is not one
_LEAST_STEPS = 5
# rounds of naming sides at most: most recordings settle after two or three, and one that alternates must come to an end
_NAMING_ROUNDS = 10
_PLANES = ("xyz_world", "cov_world", "reproj_px", "n_views", "kind")


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
    views: ViewSequence | ViewsInParts,
    rig: Rig,
    fusing: FuseSettings,
    smoothing: SmoothSettings | None,
    centres: JointCentres | None = None,
) -> PoseSequence:
    """Fuse every time step, move keypoints to joint centres (with `centres`), then (with `smoothing`) treat gaps and noise over
    the whole recording.

    With ``robust`` weights the recording is first steadied over time and then every view's limbs are named left and right as
    the steadied recording has them: when legs pass each other, several views confuse them at once and no single time step can
    show it.
    """
    if fusing.weights == "robust":
        fused = _fused_with_sides_corrected(views, rig, fusing, smoothing or SmoothSettings())
    else:
        fused = _fused_over_time(views, rig, fusing)
    fused = to_joint_centres(fused, centres) if centres else fused
    return smooth(fused, smoothing) if smoothing else fused


def _fused_over_time(views: ViewSequence | ViewsInParts, rig: Rig, fusing: FuseSettings) -> PoseSequence:
    planes: dict[str, Array] = {}
    last = None
    for part in parts_of_steps(len(views.t_ns)):
        seen = views.part(part)
        for i in range(len(seen.t_ns)):
            last = fuse(seen.at(i), rig, fusing, last)
            for name in _PLANES:
                value = getattr(last, name)
                planes.setdefault(name, np.empty((len(views.t_ns), *value.shape), value.dtype))[part.start + i] = value
    assert last is not None  # `long_enough` has found people
    give_away(*planes.values())
    return PoseSequence(t_ns=views.t_ns, skeleton=last.skeleton, person_id=last.person_id, **planes)


def _fused_with_sides_corrected(
    views: ViewSequence | ViewsInParts, rig: Rig, fusing: FuseSettings, smoothing: SmoothSettings
) -> PoseSequence:
    """Time steps fused, then again from views whose limbs are named left and right as the recording steadied over time has them.

    Where the first reference was still wrong, a better one names more views right: repeated until no view changes.
    """
    fused = _fused_over_time(views, rig, fusing)
    exchanged = [np.zeros(1, bool)] * len(parts_of_steps(len(fused)))
    for _ in range(_NAMING_ROUNDS):
        planes = _fused_again(fused, _steadied_points(fused, smoothing), exchanged, views, rig, fusing)
        if not planes:
            break
        fused = replace(fused, **planes)
    return fused


def _fused_again(
    fused: PoseSequence,
    reference: Array,
    exchanged: list[Array],
    views: ViewSequence | ViewsInParts,
    rig: Rig,
    fusing: FuseSettings,
) -> dict[str, Any]:
    """The planes with those time steps fused again whose views have other limbs `exchanged` than before; empty where none has."""
    planes: dict[str, Any] = {}
    for place, part in enumerate(parts_of_steps(len(fused))):
        seen = views.part(part)
        wrong = sides_that_differ(reference[part], rig, seen)
        differing = np.flatnonzero((wrong != exchanged[place]).any(axis=(1, 2, 3)))
        exchanged[place] = wrong
        if not len(differing):
            continue
        planes = planes or {name: np.array(getattr(fused, name)) for name in _PLANES}
        named = with_sides_exchanged(seen, wrong)
        for i in differing.tolist():
            pose = fuse(named.at(i), rig, fusing)
            for name, plane in planes.items():
                plane[part.start + i] = getattr(pose, name)
    give_away(*planes.values())
    return planes


def _steadied_points(fused: PoseSequence, smoothing: SmoothSettings) -> Array:
    xyz, cov = steady_sides(fused, facing_votes(fused))
    smooth_in_place(fused.t_ns, fused.skeleton, xyz, cov, smoothing)
    return xyz
