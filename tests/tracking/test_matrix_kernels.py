"""Small compiled matrices."""

import numpy as np
import pytest

from posefuse.tracking.matrix_kernels import inverse3


@pytest.mark.parametrize("seed", range(5))
def test_the_inverse_is_numpys_and_of_a_symmetric_matrix_symmetric(seed: int) -> None:
    any_matrix = np.random.default_rng(seed).normal(size=(3, 3))
    for matrix in (any_matrix, any_matrix @ any_matrix.T):
        out = np.empty((3, 3))
        assert inverse3(matrix, out) == pytest.approx(np.linalg.det(matrix))
        np.testing.assert_allclose(out @ matrix, np.eye(3), atol=1e-9)
    np.testing.assert_array_equal(out, out.T)
