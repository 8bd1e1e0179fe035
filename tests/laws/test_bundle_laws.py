"""The covariance of a bundle adjustment is the inverse of its normal equations, in whatever units its unknowns are."""

import numpy as np
import pytest

from posefuse.calibration.bundle import Linearised, Problem, ResidualBlock, solve_bundle
from posefuse.core.arrays import Array

COUNT, LOCALS = 60, 5


def linear_problem(unit: Array, prior: Array) -> Problem[Array]:
    """Residuals that are linear in two global unknowns, in these units, and in one of each local kind."""
    rng = np.random.default_rng(3)
    jacobian, local_jacobian = rng.normal(size=(COUNT, 2, 2)) * unit, rng.normal(size=(COUNT, 2, 1))
    # the second unknown is seen a hundredth as well as the first
    jacobian[..., 1] *= 0.01
    local, zero = np.arange(COUNT) % LOCALS, np.zeros(COUNT, np.int64)
    observed = rng.normal(size=(COUNT, 2))

    def residual(state: Array) -> Array:
        return jacobian @ state[:2] + (local_jacobian @ state[2 + local][:, None, None])[..., 0] - observed

    def linearise(state: Array) -> Linearised:
        block = ResidualBlock(jacobian=jacobian, index=zero, count=1, prior=prior[None], offset=state[None, :2])
        return Linearised(residual=residual(state), blocks=(block,), local_jacobian=local_jacobian, local_index=local)

    return Problem(
        residual=residual, linearise=linearise, free=(np.ones((1, 2), bool),), local_count=LOCALS, group=np.arange(COUNT),
        group_count=COUNT, cauchy=np.inf, step=lambda state, parts, own: state + np.concatenate([parts[0][0], own[:, 0]]),
        prior_cost=lambda state: float(0.5 * (prior * state[:2] ** 2).sum()),
    )  # fmt: skip


def expected(problem: Problem[Array], prior: Array) -> Array:
    """(2, 2) the same from the whole normal equations."""
    linear = problem.linearise(np.zeros(2 + LOCALS))
    columns = np.zeros((COUNT, 2, 2 + LOCALS))
    columns[..., :2] = linear.blocks[0].jacobian
    columns[np.arange(COUNT), :, 2 + linear.local_index] = linear.local_jacobian[..., 0]
    flat = columns.reshape(-1, 2 + LOCALS)
    scale = 1 / np.sqrt((flat**2).sum(axis=0) + np.pad(prior, (0, LOCALS)))
    normal = scale[:, None] * (flat.T @ flat + np.diag(np.pad(prior, (0, LOCALS)))) * scale
    return (scale[:, None] * np.linalg.inv(normal) * scale)[:2, :2]


@pytest.mark.parametrize("unit", [(1.0, 1.0), (1e6, 1.0), (1.0, 1e-5)])
@pytest.mark.parametrize("held", [0.0, 1e14])
def test_what_is_held_and_in_other_units_does_not_make_the_rest_look_certain(unit: tuple[float, float], held: float) -> None:
    prior = np.array([held, 0.0])
    problem = linear_problem(np.array(unit), prior)
    found = solve_bundle(problem, np.zeros(2 + LOCALS)).covariance
    np.testing.assert_allclose(found, expected(problem, prior), rtol=1e-6, atol=1e-9 * np.abs(found).max())


def test_an_unknown_that_nothing_observes_is_unknown() -> None:
    problem = linear_problem(np.array([1.0, 0.0]), np.zeros(2))
    assert solve_bundle(problem, np.zeros(2 + LOCALS)).covariance[1, 1] > 1e6
