"""Errors against truth: known offsets come out, people are paired, gaps do not count as zero."""

import numpy as np
import pytest
from built import poses

from posefuse.core import CameraTruth, InputError, PoseSequence, Truth
from posefuse.core.skeleton import ANATOMICAL23, BLAZEPOSE33, PAPER14
from posefuse.evaluation.metrics import joint_errors, summary, typical_nees

T, N = 7, 2
K = len(ANATOMICAL23)


def truth_of(rig, xyz: np.ndarray, period_ns: int = 10) -> Truth:
    t_ns, seen = np.arange(len(xyz)) * period_ns, np.ones(xyz.shape[:-1], bool)
    views = tuple(CameraTruth(camera=n, t_ns=t_ns, xy_img=np.zeros((*seen.shape, 2)), visible=seen) for n in rig.names)
    return Truth(rig=rig, t_ns=t_ns, skeleton=ANATOMICAL23, person_id=range(xyz.shape[1]), xyz_world=xyz, views=views)


def sequence(t_ns: np.ndarray, xyz: np.ndarray, skeleton=ANATOMICAL23) -> PoseSequence:
    return poses(xyz, 0.0, t_ns=t_ns, skeleton=skeleton)


@pytest.fixture
def moving() -> np.ndarray:
    rng = np.random.default_rng(0)
    start, velocity = rng.normal(size=(N, K, 3)), rng.normal(size=(N, K, 3))
    return start + np.array([[[10.0, 0, 0]], [[0, 0, 0]]]) + np.arange(T)[:, None, None, None] * velocity


def test_a_known_offset_is_found_in_every_joint_with_people_swapped(ring_rig, moving: np.ndarray) -> None:
    offset = np.array([0.003, -0.004, 0.012])
    errors = joint_errors(sequence(np.arange(T) * 10, moving[:, ::-1] + offset), truth_of(ring_rig(3), moving))
    assert errors.joints == PAPER14.keypoints
    assert np.allclose(errors.mean_mm, 13.0)
    assert np.allclose(errors.sd_mm, 0, atol=1e-9)
    assert errors.mpjpe_mm == pytest.approx(13.0)
    assert (errors.found == 1).all()


def test_truth_is_interpolated_to_the_estimates_times(ring_rig, moving: np.ndarray) -> None:
    between = (moving[1:] + moving[:-1]) / 2
    errors = joint_errors(sequence(np.arange(T - 1) * 10 + 5, between), truth_of(ring_rig(3), moving))
    assert np.allclose(errors.mean_mm, 0, atol=1e-9)


def test_missing_estimates_count_as_missing_not_as_zero(ring_rig, moving: np.ndarray) -> None:
    holed = moving + 0.01
    holed[:4, :, ANATOMICAL23.index("left_knee")] = np.nan
    holed[:, :, ANATOMICAL23.index("right_knee")] = np.nan
    errors = joint_errors(sequence(np.arange(T) * 10, holed), truth_of(ring_rig(3), moving))
    left, right = PAPER14.index("left_knee"), PAPER14.index("right_knee")
    assert errors.found[left] == pytest.approx(3 / 7)
    assert errors.mean_mm[left] == pytest.approx(10 * np.sqrt(3))
    assert errors.found[right] == 0
    assert np.isnan(errors.mean_mm[right])
    assert errors.mpjpe_mm == pytest.approx(10 * np.sqrt(3))


def test_one_person_found_of_two_is_paired_with_the_right_one(ring_rig, moving: np.ndarray) -> None:
    errors = joint_errors(sequence(np.arange(T) * 10, moving[:, 1:] + [0, 0, 0.02]), truth_of(ring_rig(3), moving))
    assert np.allclose(errors.mean_mm, 20)
    assert np.allclose(errors.found, 0.5)


def test_another_skeleton_is_compared_by_names(ring_rig, moving: np.ndarray) -> None:
    other = np.full((T, N, len(BLAZEPOSE33), 3), np.nan)
    for i, name in enumerate(BLAZEPOSE33.keypoints):
        if name in ANATOMICAL23.keypoints:
            other[:, :, i] = moving[:, :, ANATOMICAL23.index(name)]
    errors = joint_errors(sequence(np.arange(T) * 10, other, BLAZEPOSE33), truth_of(ring_rig(3), moving))
    assert np.allclose(errors.mean_mm, 0, atol=1e-9)


def test_no_common_time_is_an_error_not_a_zero(ring_rig, moving: np.ndarray) -> None:
    with pytest.raises(InputError, match="no time step in common"):
        joint_errors(sequence(np.arange(T) + 1000, moving), truth_of(ring_rig(3), moving))


def test_statistics() -> None:
    errors = summary(["a", "b"], np.array([[1.0, 4.0], [3.0, np.nan]]))
    assert errors.mean_mm.tolist() == [2.0, 4.0]
    assert errors.sd_mm.tolist() == [1.0, 0.0]
    assert errors.p95_mm[0] == pytest.approx(2.9)
    assert errors.found.tolist() == [1.0, 0.5]


def test_typical_nees_is_3_when_covariances_say_how_wrong_points_are(ring_rig) -> None:
    rng = np.random.default_rng(7)
    shape = (400, 1, K)
    exact = rng.normal(size=shape + (3,))
    root = rng.normal(size=shape + (3, 3)) * 0.01
    cov = root @ np.swapaxes(root, -1, -2) + np.eye(3) * 1e-5
    error = (np.linalg.cholesky(cov) @ rng.normal(size=shape + (3, 1)))[..., 0]
    truth = truth_of(ring_rig(3), exact, 10**7)

    def stated(factor: float) -> float:
        found = poses(exact + error, cov=cov * factor, t_ns=truth.t_ns, skeleton=ANATOMICAL23)
        return typical_nees(found, truth, ("left_hip", "right_wrist", "nose"))

    assert stated(1.0) == pytest.approx(3, rel=0.1)
    assert stated(0.25) == pytest.approx(12, rel=0.1)
