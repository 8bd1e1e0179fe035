"""Kernels of the live tracker, one at a time."""

import numpy as np

from posefuse.core import Skeleton
from posefuse.tracking.online import LiveSettings
from posefuse.tracking.online.kernels.body import start_missing
from posefuse.tracking.online.kernels.state import NEVER, parts, state_size
from posefuse.tracking.online.kernels.updates import doubt
from posefuse.tracking.online.person import Model
from posefuse.tracking.online.settings import MotionModelSettings


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
    settings = LiveSettings(
        motion_models=(MotionModelSettings(acceleration_m_s2=3.0, persistence_s=0.1),),
        body_models=(MotionModelSettings(acceleration_m_s2=1.0, persistence_s=0.1),),
    )
    session = Model(ring_rig(2), skeleton, settings).arrays
    person = parts(np.zeros(state_size(session)), session)
    person.x[:], person.cov[:] = np.nan, np.nan
    person.x[0, 0], person.x[1, 0] = np.arange(9.0), np.arange(9.0) + [2, 4, 6, 1, 1, 1, 0, 0, 0]
    person.seen[:2], person.seen[2] = 1.0, NEVER
    start_missing(person, np.zeros((3, 2)), 1.0, session)
    np.testing.assert_allclose(person.x[2, 0], [1, 3, 5, 3.5, 4.5, 5.5, 0, 0, 0])
    sigma = np.sqrt(person.cov[2, 0].diagonal())
    assert (sigma[:6] > 0).all()
    np.testing.assert_allclose(sigma[6:], 3.0)
