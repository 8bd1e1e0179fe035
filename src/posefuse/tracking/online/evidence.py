"""What a tracker knows of a person besides the pose: the newest rays of each camera, and what robust fusion found."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posefuse.core.arrays import Array

from .person import Model, Person, View

# older views show where the person was
_NEWEST_NS = 150_000_000
# a limb of a view is exchanged where that brings it so much closer
_CLEARLY = 0.5
_STEP_NS = 5_000_000


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
    z, inverse_var = np.empty((len(views), k, 2)), np.empty((len(views), k))
    then = np.empty((len(views), k, 3))
    for v, view in enumerate(views):
        then[v] = _at_rows(person, view)
        order = _order(view, then[v], model)
        z[v] = view.z[order]
        inverse_var[v] = 0.5 * np.square(view.white[order]).sum(axis=(1, 2))
    return Evidence(
        camera=np.array([view.camera for view in views], np.intp),
        z=z,
        inverse_var=np.where(np.isfinite(z[..., 0]), inverse_var, 0.0),
        then_world=then,
        checked_ns=checked_ns,
        away_world=away_world,
    )


def _at_rows(person: Person, view: View) -> Array:
    """(K, 3) keypoints when the row of each was exposed."""
    then = person.expected(view.t_ns)[0]
    if view.late_s.any():
        later = person.expected(view.t_ns + _STEP_NS)[0]
        then = then + (later - then) * (view.late_s / (_STEP_NS * 1e-9))[:, None]
    return then


def _order(view: View, then_world: Array, model: Model) -> Array:
    """(K,) which keypoint of the view is which of the person: limbs whose sides the view exchanges are exchanged back."""
    camera = model.cameras[view.camera]
    there = then_world @ camera[:9].reshape(3, 3).T + camera[9:12]
    expected = there[:, :2] / there[:, 2:]
    same = np.linalg.norm(view.z - expected, axis=-1)
    other = np.linalg.norm(view.z[model.mirror] - expected, axis=-1)
    order = np.arange(len(same))
    for group in range(model.groups):
        limb = (model.group == group) & np.isfinite(same) & np.isfinite(other)
        if other[limb].sum() < _CLEARLY * same[limb].sum():
            order[model.group == group] = model.mirror[model.group == group]
    return order
