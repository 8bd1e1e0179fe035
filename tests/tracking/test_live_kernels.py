"""Kernels of the live tracker, one at a time."""

import numpy as np

from posefuse.tracking.online.kernels.body import start_missing
from posefuse.tracking.online.kernels.state import NEVER
from posefuse.tracking.online.kernels.updates import doubt


def test_doubt_adds_uncertainty_of_position_and_velocity_only() -> None:
    cov = np.zeros((2, 9, 9))
    doubt(cov)
    added = cov[0].diagonal()
    assert np.array_equal(cov, np.broadcast_to(np.diag(added), cov.shape)), "no correlation is added"
    assert added[0] > 0 and added[3] > 0
    assert np.array_equal(added, np.repeat([added[0], added[3], 0.0], 3)), "all axes alike, the acceleration untouched"


def test_a_missing_keypoint_starts_at_the_mean_of_its_neighbours_and_moves_with_them() -> None:
    x, cov = np.full((4, 1, 9), np.nan), np.full((4, 1, 9, 9), np.nan)
    x[0, 0], x[1, 0] = np.arange(9.0), np.arange(9.0) + [2, 4, 6, 1, 1, 1, 0, 0, 0]
    seen = np.full((3, 2), NEVER)
    seen[:2] = 1.0
    neighbours = np.array([[-1, -1], [-1, -1], [0, 1]])
    start_missing(x, cov, seen, np.zeros((3, 2)), 1.0, 0.5, neighbours, np.array([3.0]))
    np.testing.assert_allclose(x[2, 0], [1, 3, 5, 3.5, 4.5, 5.5, 0, 0, 0])
    sigma = np.sqrt(cov[2, 0].diagonal())
    assert (sigma[:6] > 0).all()
    np.testing.assert_allclose(sigma[6:], 3.0)
