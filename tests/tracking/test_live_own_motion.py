"""What predictions of a person's motion miss is learnt from that motion; of another person nothing is known."""

import numpy as np
import pytest

from posefuse.core import Skeleton
from posefuse.core.skeleton import COCO17
from posefuse.tracking.online import LiveSettings
from posefuse.tracking.online.kernels.own_motion import CorrectionLimits, Prediction, Regression, correct
from posefuse.tracking.online.kernels.state import state_size
from posefuse.tracking.online.own_motion import HORIZON_S, OwnMotion
from posefuse.tracking.online.person import Model

HANDS = Skeleton("hands", ("left_wrist", "right_wrist"))
LATE_NS = 100_000_000
SECONDS = 6.0
ARMS = [COCO17.index(f"{side}_{joint}") for side in ("left", "right") for joint in ("elbow", "wrist")]


def swinging(standing):
    """The arms of a standing person swing forward and backward, as a pendulum does."""

    def at(t_s):
        xyz = standing.copy()
        xyz[ARMS] += np.array([0.25, 0.1, 0.05]) * np.sin(2 * np.pi * 1.1 * t_s)
        return xyz

    return at


@pytest.fixture
def standing(world):
    return world(motion="stand").place(0.0)


def errors_of(w, seed=0):
    """(T,) times in s and (T, K) errors in m of poses that come out when their views are `LATE_NS` old."""
    tracker, times, errors = w.tracker(), [], []
    for view in w.views(SECONDS, seed=seed):
        tracker.add(view)
        pose = tracker.at(view.t_ns + LATE_NS)
        if len(pose.person_id):
            times.append(pose.t_ns * 1e-9)
            errors.append(w.error_m(pose))
    return np.array(times), np.array(errors)


def test_a_movement_that_is_repeated_is_predicted_better_and_better(world, standing):
    t_s, error = errors_of(world(motion=swinging(standing)))
    arms = error[:, ARMS].mean(axis=1)
    # a whole swing takes 0.9 s; the first corrections come 0.6 s after the person
    first, last = arms[t_s < 0.7].mean(), arms[t_s > SECONDS - 1.8].mean()
    assert last < 0.75 * first


def test_a_person_who_stands_is_not_moved(world):
    """Nothing can be learnt of noise: the error stays what it was before anything was learnt."""
    t_s, error = errors_of(world(motion="stand"))
    before, after = error[(t_s > 0.4) & (t_s < 0.8)].mean(), error[t_s > 2.0].mean()
    assert after < 1.1 * before


def test_a_movement_that_ends_is_soon_not_expected_any_more(world, standing):
    """The arms swing until 3 s and are still from then on: soon no worse than a person who never moved."""
    swing = swinging(standing)
    quiet_s = 3.0 + 1.5
    t_s, error = errors_of(world(motion=lambda t: swing(min(t, 3.0))))
    t_still, still = errors_of(world(motion=lambda t: swing(3.0)))
    assert error[t_s > quiet_s].mean() < 1.15 * still[t_still > quiet_s].mean()


def test_without_hips_nothing_is_corrected(world):
    session = Model(world().rig, HANDS, LiveSettings()).arrays
    own = OwnMotion(HANDS, session)
    state = np.zeros(state_size(session))
    own.settle(state, 0)
    assert own.waits_until_ns() is None
    xyz = np.ones((len(HANDS), 3))
    own.correct(state, HORIZON_S, xyz)
    assert (xyz == 1).all()


def test_a_correction_is_as_large_as_its_age_and_its_tests_allow():
    """Three keypoints: tested and right, tested and always wrong, and one whose correction is beyond all limits."""
    rng = np.random.default_rng(1)
    frame = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    features, weights = rng.normal(size=2), 0.1 * rng.normal(size=(2, 3, 3))
    weights[:, 2] *= 1e3
    made = Prediction(frame, features, np.zeros((3, 3)), np.array([0.02, 0.02, 0.5]))
    tested = np.array([[2.0, 3.0], [-1.0, 2.0], [9.0, 1.0]])
    regression = Regression(np.zeros((2, 2)), np.zeros((2, 3, 3)), weights, tested)
    limits = CorrectionLimits(tested=1.0, oldest_s=0.15, most_m=0.2)
    xyz = np.ones((3, 3))
    correct(made, regression, 0.05, limits, xyz)
    speed = np.einsum("d,dka->ka", features, weights) @ frame
    # half of what is expected counts for the first: it is tested as much as the limit says
    np.testing.assert_allclose(xyz[0], 1 + 0.07 * 0.5 * speed[0])
    assert (xyz[1] == 1).all()
    np.testing.assert_allclose(xyz[2], 1 + np.clip(0.15 * speed[2], -0.2, 0.2))
    assert np.abs(xyz[2] - 1).max() == pytest.approx(0.2)
