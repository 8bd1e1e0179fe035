"""The covariance of a bundle adjustment is the inverse of its normal equations, in whatever units its unknowns are."""

import numpy as np
import pytest

from posefuse.calibration.bundle import Linearised, Problem, ResidualBlock, solve_bundle
from posefuse.core.arrays import Array

COUNT, LOCALS = 60, 5


class LinearProblem(Problem[Array]):
    """Residuals that are linear in two global unknowns, in these units, and in one of each local kind."""

    free, local_count, group, group_count, cauchy = (np.ones((1, 2), bool),), LOCALS, np.arange(COUNT), COUNT, np.inf

    def __init__(self, unit: Array, prior: Array) -> None:
        rng = np.random.default_rng(3)
        self.jacobian, self.local_jacobian = rng.normal(size=(COUNT, 2, 2)) * unit, rng.normal(size=(COUNT, 2, 1))
        # the second unknown is seen a hundredth as well as the first
        self.jacobian[..., 1] *= 0.01
        self.local, self.prior = np.arange(COUNT) % LOCALS, prior
        self.observed = rng.normal(size=(COUNT, 2))

    def residual(self, state: Array) -> Array:
        of_local = (self.local_jacobian @ state[2 + self.local][:, None, None])[..., 0]
        return np.asarray(self.jacobian @ state[:2] + of_local - self.observed)

    def linearise(self, state: Array) -> Linearised:
        zero = np.zeros(COUNT, np.int64)
        block = ResidualBlock(
            jacobian=self.jacobian, index=zero, count=1, prior=np.diag(self.prior)[None], offset=state[None, :2]
        )
        return Linearised(blocks=(block,), local_jacobian=self.local_jacobian, local_index=self.local)

    def step(self, state: Array, blocks: list[Array], local: Array) -> Array:
        return state + np.concatenate([blocks[0][0], local[:, 0]])

    def prior_cost(self, state: Array) -> float:
        return float(0.5 * (self.prior * state[:2] ** 2).sum())


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
    problem = LinearProblem(np.array(unit), prior)
    found = solve_bundle(problem, np.zeros(2 + LOCALS)).covariance
    np.testing.assert_allclose(found, expected(problem, prior), rtol=1e-6, atol=1e-9 * np.abs(found).max())


def test_an_unknown_that_nothing_observes_is_unknown() -> None:
    problem = LinearProblem(np.array([1.0, 0.0]), np.zeros(2))
    assert solve_bundle(problem, np.zeros(2 + LOCALS)).covariance[1, 1] > 1e6
