"""What a tracker knows of a person besides the pose: the newest rays of each camera, and what robust fusion found."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posefuse.core.arrays import Array

from .person import Model, Person

# older views show where the person was
_NEWEST_NS = 150_000_000


@dataclass(frozen=True, eq=False, kw_only=True)
class Evidence:
    """Rays of one person, of the newest view of each camera (V), and the newest cross-check.

    Attributes:
        camera: (V,) places in the rig, ascending.
        z: (V, K, 2) ideal image points, left and right as in the person; NaN where there is none or the cross-check found
            the camera wrong.
        inverse_var: (V, K) 1 / variance of these, 0 where there is none.
        then_world: (V, K, 3) where the tracker has the keypoints at the times of these rays; NaN where it does not.
        checked_ns: time of the newest cross-check that came to a result; 0: none yet.
        away_world: (K, 3) from the tracked to the robustly fused keypoints at that time; NaN where unknown.
    """

    camera: Array
    z: Array
    inverse_var: Array
    then_world: Array
    checked_ns: int
    away_world: Array


def evidence_of(person: Person, model: Model, checked_ns: int, away_world: Array, t_ns: int) -> Evidence:
    """Of views not older than 150 ms at `t_ns`, which the order of arrival does not change."""
    views = sorted(person.newest(t_ns - _NEWEST_NS, t_ns), key=lambda view: view.camera)
    k = len(model.skeleton)
    z, inverse_var, then = np.empty((len(views), k, 2)), np.empty((len(views), k)), np.empty((len(views), k, 3))
    for v, view in enumerate(views):
        person.rays_into(view, z[v], inverse_var[v], then[v])
    return Evidence(
        camera=np.array([view.camera for view in views], np.intp),
        z=z,
        inverse_var=inverse_var,
        then_world=then,
        checked_ns=checked_ns,
        away_world=away_world,
    )
