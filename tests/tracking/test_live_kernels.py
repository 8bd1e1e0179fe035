"""Kernels of the live tracker, one at a time."""

import numpy as np
import pytest

from posefuse.core import Skeleton
from posefuse.core.skeleton import ANATOMICAL23
from posefuse.tracking.matrix_kernels import inverse3
from posefuse.tracking.online import LiveMotion, LiveSettings, MotionModel
from posefuse.tracking.online.kernels.body import start_missing
from posefuse.tracking.online.kernels.rays import exchange_person
from posefuse.tracking.online.kernels.state import NEVER, KeypointRays, parts, state_size
from posefuse.tracking.online.kernels.updates import doubt
from posefuse.tracking.online.person import Model, Person, View


def test_doubt_adds_uncertainty_of_position_and_velocity_only() -> None:
    cov = np.zeros((2, 9, 9))
    doubt(cov)
    added = cov[0].diagonal()
    assert np.array_equal(cov, np.broadcast_to(np.diag(added), cov.shape)), "no correlation is added"
    assert added[0] > 0 and added[3] > 0
    assert np.array_equal(added, np.repeat([added[0], added[3], 0.0], 3)), "all axes alike, the acceleration untouched"


def test_a_missing_keypoint_starts_at_the_mean_of_its_neighbours_and_moves_with_them(ring_rig) -> None:
    """The last of three keypoints is tied to both others."""
    skeleton = Skeleton("chain", ("one", "two", "middle"), bones=(("one", "middle"), ("two", "middle")))
    motion = LiveMotion(keypoints=(MotionModel(3.0, 0.1),), body=(MotionModel(1.0, 0.1),))
    session = Model(ring_rig(2), skeleton, LiveSettings(), motion).arrays
    person = parts(np.zeros(state_size(session)), session)
    person.x[:], person.cov[:] = np.nan, np.nan
    person.x[0, 0], person.x[1, 0] = np.arange(9.0), np.arange(9.0) + [2, 4, 6, 1, 1, 1, 0, 0, 0]
    person.seen[:2], person.seen[2] = 1.0, NEVER
    start_missing(person, np.zeros((3, 2)), 1.0, session)
    np.testing.assert_allclose(person.x[2, 0], [1, 3, 5, 3.5, 4.5, 5.5, 0, 0, 0])
    sigma = np.sqrt(person.cov[2, 0].diagonal())
    assert (sigma[:6] > 0).all()
    np.testing.assert_allclose(sigma[6:], 3.0)


def test_exchanged_twice_a_person_is_as_before_and_once_every_part_is_on_the_other_side(ring_rig) -> None:
    session = Model(ring_rig(2), ANATOMICAL23, LiveSettings()).arrays
    state = np.random.default_rng(1).normal(size=state_size(session))
    person, before = parts(state, session), parts(state.copy(), session)
    arms = np.flatnonzero(session.group == 0)
    exchange_person(person, session, 0)
    for name in ("x", "cov", "share", "lively", "seen", "square", "precision", "deepness", "refused"):
        here, was = getattr(person, name), getattr(before, name)
        np.testing.assert_array_equal(here[arms], was[session.mirror[arms]], err_msg=name)
        others = np.setdiff1d(np.arange(len(here)), arms)
        np.testing.assert_array_equal(here[others], was[others], err_msg=name)
    exchange_person(person, session, 0)
    for here, was in zip(person, before, strict=True):
        np.testing.assert_array_equal(here, was)


def test_a_view_that_exchanges_a_limb_is_put_in_order(ring_rig) -> None:
    """Arms are exchanged by the view, legs are not; one keypoint is missing; rows make no difference to a person at rest."""
    model, rng = Model(ring_rig(2), ANATOMICAL23, LiveSettings()), np.random.default_rng(0)
    k, camera = len(ANATOMICAL23), model.rig.cameras[1].cam_from_world
    xyz = rng.normal(0, 0.5, (k, 3)) + [0.0, 0.0, 1.0]
    person = Person(model, 1, 0, xyz, np.broadcast_to(np.eye(3) * 1e-4, (k, 3, 3)))
    there = xyz @ camera.matrix().T + camera.xyz
    ideal = there[:, :2] / there[:, 2:]
    order = np.where(model.group == 0, model.skeleton.mirror, np.arange(k))
    seen, hidden = ideal[order], int(np.flatnonzero(model.group == 1)[0])
    seen[hidden] = np.nan
    sigma = rng.uniform(0.001, 0.003, k)
    white = np.eye(2) / sigma[order, None, None]
    rays = KeypointRays(camera=1, z=seen, white=white, late_s=rng.uniform(0, 0.01, k), sigma_px=np.ones(k))
    view = View(t_ns=0, rays=rays)
    z, inverse_var, then = np.empty((k, 2)), np.empty(k), np.empty((k, 3))
    person.rays_into(view, z, inverse_var, then)
    known = np.arange(k) != hidden
    np.testing.assert_allclose(z[known], ideal[known])
    np.testing.assert_allclose(inverse_var[known], sigma[known] ** -2.0)
    np.testing.assert_allclose(then, xyz, atol=1e-12)
    assert np.isnan(z[hidden]).all() and inverse_var[hidden] == 0


# --- small compiled matrices


@pytest.mark.parametrize("seed", range(5))
def test_the_inverse_is_numpys_and_of_a_symmetric_matrix_symmetric(seed: int) -> None:
    any_matrix = np.random.default_rng(seed).normal(size=(3, 3))
    for matrix in (any_matrix, any_matrix @ any_matrix.T):
        out = np.empty((3, 3))
        assert inverse3(matrix, out) == pytest.approx(np.linalg.det(matrix))
        np.testing.assert_allclose(out @ matrix, np.eye(3), atol=1e-9)
    np.testing.assert_array_equal(out, out.T)
