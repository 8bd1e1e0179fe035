"""The normal equations of a time step, against the same equations written out with dense matrices."""

from collections.abc import Callable

import numpy as np
import pytest

from posefuse.calibration.geometry import hat
from posefuse.core import Rig
from posefuse.health.misalignment import UNKNOWNS, instant_of, sums_of


@pytest.mark.parametrize("cameras", [3, 5])
def test_sparse_equations_are_the_dense_ones(ring_rig: Callable[..., Rig], cameras: int) -> None:
    rig, rng, count = ring_rig(cameras), np.random.default_rng(cameras), 11
    xyz = rng.normal(0, 0.5, (count, 3)) + [0, 0, 1]
    velocity = rng.normal(0, 1, (count, 3))
    xy = np.stack([camera.project(xyz) for camera in rig]) + rng.normal(0, 3, (cameras, count, 2))
    xy[0, 2:5], xy[1, 7], xy[2, 5:9], velocity[3] = np.nan, np.nan, np.nan, np.nan
    now = instant_of(rig, 0, xy)
    found = sums_of(rig, now, velocity)
    good = np.flatnonzero(np.isfinite(now.misfit_m) & np.isfinite(velocity).all(axis=1))
    weight = np.minimum(1.0, 2.0 * np.median(now.misfit_m[good]) / now.misfit_m[good])
    information, pull = np.zeros((count, *(UNKNOWNS * cameras,) * 2)), np.zeros((count, UNKNOWNS * cameras))
    for p, w in zip(good, weight, strict=True):
        design = np.zeros((2 * cameras, UNKNOWNS * cameras))
        for c, camera in enumerate(rig):
            if now.seen[p, c]:
                at = now.xyz_cam[p, c]
                moved = np.column_stack([-hat(at[None])[0], -camera.cam_from_world.matrix() @ velocity[p]])
                design[2 * c : 2 * c + 2, UNKNOWNS * c : UNKNOWNS * (c + 1)] = moved[:2] - (at[:2] / at[2])[:, None] * moved[2]
        rows = now.rows[p].reshape(-1, 3)
        left = design - rows @ np.linalg.solve(rows.T @ rows + 1e-9 * np.eye(3), rows.T @ design)
        information[p] = w * left.T @ left
        pull[p] = w * left.T @ now.off_m[p].ravel()
    np.testing.assert_allclose(found.information, information, atol=1e-9 * np.abs(information).max())
    np.testing.assert_allclose(found.pull, pull, atol=1e-9 * np.abs(pull).max())
