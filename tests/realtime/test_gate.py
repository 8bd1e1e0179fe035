"""Only what is known well enough, and was measured lately, goes out; what is withheld is counted."""

import built
import numpy as np
import pytest

from posefuse.core import SKELETONS, Kind, Pose3D
from posefuse.realtime.config import KeypointGateSettings
from posefuse.realtime.estimator import KeypointGate, _known_to, worst_sigma_m

S = 1_000_000_000
COCO = SKELETONS["coco17"]


def pose(t_s: float, sigma_m: float = 0.02, kind: Kind = Kind.FUSED, people: tuple[int, ...] = (3, 8)) -> Pose3D:
    shape = (len(people), len(COCO))
    cov = np.eye(3) * sigma_m**2
    return built.pose(np.ones((*shape, 3)), people, round(t_s * S), cov=cov, kind=np.full(shape, kind))


def test_the_axis_known_worst_decides_whichever_way_it_points() -> None:
    rng = np.random.default_rng(0)
    turn = np.linalg.qr(rng.normal(size=(5, 3, 3)))[0]
    cov = turn @ np.diag([0.01, 0.02, 0.3]) ** 2 @ np.swapaxes(turn, -1, -2)
    np.testing.assert_allclose(worst_sigma_m(cov), 0.3)
    assert worst_sigma_m(np.full((3, 3), np.nan)) == np.inf


def test_a_keypoint_too_unsure_is_missing_in_every_field() -> None:
    given = pose(1.0)
    cov = given.cov_world.copy()
    cov[0, 4, 2, 2] = 0.16**2
    cov[0, 5, 2, 2] = 0.14**2
    gate = KeypointGate(KeypointGateSettings())
    got = gate.passed(Pose3D(**{**vars(given), "cov_world": cov}))
    assert got.kind[0, 4] == Kind.MISSING and got.n_views[0, 4] == 0
    assert np.isnan(got.xyz_world[0, 4]).all() and np.isnan(got.cov_world[0, 4]).all() and np.isnan(got.reproj_px[0, 4])
    assert np.isfinite(got.xyz_world[0, 5]).all()
    assert gate.figures() == {"keypoints": pytest.approx(1 / 34), "people": 0.0}


def test_a_person_of_whom_nothing_is_left_is_not_there() -> None:
    given = pose(1.0)
    cov = given.cov_world.copy()
    cov[0] *= 100
    gate = KeypointGate(KeypointGateSettings(sigma_m=0.1))
    assert gate.passed(Pose3D(**{**vars(given), "cov_world": cov})).person_id.tolist() == [8]
    assert gate.people == (2, 1)
    assert gate.passed(pose(1.01)).person_id.tolist() == [3, 8]


def test_what_was_not_measured_for_long_is_withheld_however_sure() -> None:
    gate = KeypointGate(KeypointGateSettings(unmeasured_s=0.4))
    gate.passed(pose(1.0))
    for t_s, there in ((1.1, 2), (1.39, 2), (1.41, 0), (1.9, 0)):
        assert len(gate.passed(pose(t_s, kind=Kind.PREDICTED)).person_id) == there
    assert len(gate.passed(pose(2.0)).person_id) == 2
    # a new person is not judged by a person who left
    assert len(gate.passed(pose(2.5, kind=Kind.PREDICTED, people=(9,))).person_id) == 1


def test_what_is_good_is_not_touched() -> None:
    given = pose(1.0)
    assert KeypointGate(KeypointGateSettings()).passed(given) is given
    no_person = pose(1.0, people=())
    assert len(KeypointGate(KeypointGateSettings()).passed(no_person).person_id) == 0


def test_keypoints_are_judged_as_by_their_worst_axis() -> None:
    rng = np.random.default_rng(0)
    turns = np.linalg.qr(rng.normal(size=(200, 3, 3)))[0]
    sigmas = rng.uniform(0.05, 0.2, (200, 3))
    # right at the limit, and what is not known
    sigmas[:20, 0], sigmas[20:25], sigmas[25:30, 1] = 0.15, np.nan, np.inf
    cov = turns @ (sigmas[:, :, None] ** 2 * np.swapaxes(turns, 1, 2))
    found = _known_to(cov.reshape(10, 20, 3, 3), 0.15)
    np.testing.assert_array_equal(found, (worst_sigma_m(cov) <= 0.15).reshape(10, 20))
    assert found.any() and not found.all()
