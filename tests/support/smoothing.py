"""Measured sequences for the tests of the smoother, and the motion that is exactly its model."""

import numpy as np

from posefuse.core import SKELETONS, Kind, PoseSequence

COCO = SKELETONS["coco17"]


def measured(t_ns: np.ndarray, xyz: np.ndarray, cov: np.ndarray) -> PoseSequence:
    """(T, N, 17, 3) as measured with covariance `cov` (..., 3, 3): NaN is missing."""
    shape = xyz.shape[:-1]
    there = np.isfinite(xyz[..., 0])
    return PoseSequence(
        t_ns=t_ns,
        skeleton=COCO,
        person_id=np.arange(shape[1]),
        xyz_world=xyz,
        cov_world=np.where(there[..., None, None], np.broadcast_to(cov, (*shape, 3, 3)), np.nan),
        reproj_px=np.where(there, 1.0, np.nan),
        n_views=np.where(there, 4, 0),
        kind=np.where(there, Kind.FUSED, Kind.MISSING),
    )


def white_jerk(dt: float, density: float) -> tuple[np.ndarray, np.ndarray]:
    """Transition (3, 3) of position, speed and acceleration over `dt`, and the Cholesky factor (3, 3) of what jerk adds."""
    step = np.array([[1, dt, dt * dt / 2], [0, 1, dt], [0, 0, 1]])
    process = density * np.array(
        [[dt**5 / 20, dt**4 / 8, dt**3 / 6], [dt**4 / 8, dt**3 / 3, dt**2 / 2], [dt**3 / 6, dt**2 / 2, dt]]
    )
    return step, np.linalg.cholesky(process)
