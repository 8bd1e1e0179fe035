"""Errors against truth: known offsets come out, people are paired, gaps do not count as zero."""

import numpy as np
import pytest
from built import poses, truth
from checks import refusal

from bench.crowds import crowd_figures, frame_matches, person_distances, returned_right
from posefuse.core import InputError, PoseSequence, ShapeError, Truth
from posefuse.core.skeleton import ANATOMICAL23, BLAZEPOSE33, PAPER14
from posefuse.evaluation.metrics import joint_errors, summary, typical_nees

T, N = 7, 2
K = len(ANATOMICAL23)


def truth_of(rig, xyz: np.ndarray, period_ns: int = 10) -> Truth:
    return truth(rig, xyz, np.arange(len(xyz)) * period_ns, ANATOMICAL23)


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
    exactly = truth_of(ring_rig(3), exact, 10**7)

    def stated(factor: float) -> float:
        found = poses(exact + error, cov=cov * factor, t_ns=exactly.t_ns, skeleton=ANATOMICAL23)
        return typical_nees(found, exactly, ("left_hip", "right_wrist", "nose"))

    assert stated(1.0) == pytest.approx(3, rel=0.1)
    assert stated(0.25) == pytest.approx(12, rel=0.1)


# --- identity metrics against cases whose figures follow by hand


RATE_HZ = 30.0
FRAMES = 60


def lines(people: int, frames: int = FRAMES) -> np.ndarray:
    """(T, N, 4, 3) people two metres apart."""
    xyz = np.zeros((frames, people, 4, 3))
    xyz[..., 0] = 2.0 * np.arange(people)[:, None]
    xyz[..., 2] = np.linspace(0, 1.5, 4)
    return xyz


def figures(truth: np.ndarray, result: np.ndarray, asked: np.ndarray | None = None):
    asked = np.isfinite(truth[..., 0]).any(-1) if asked is None else asked
    there = np.isfinite(result[..., 0]).any(-1)
    return crowd_figures(person_distances(truth, result), asked, there, RATE_HZ)


def test_the_truth_itself_is_perfect_under_any_names() -> None:
    truth = lines(3)
    got = figures(truth, truth[:, [2, 0, 1]])
    assert (got.idf1, got.hota, got.switches, got.missed, got.false) == (1, pytest.approx(1), 0, 0, 0)
    assert got.mpjpe_mm == 0


def test_two_ids_swapped_half_way() -> None:
    truth = lines(2)
    result = truth.copy()
    result[FRAMES // 2 :] = truth[FRAMES // 2 :, [1, 0]]
    got = figures(truth, result)
    assert got.idf1 == pytest.approx(0.5)
    assert got.switches == 2
    assert got.per_person_minute == pytest.approx(2 / (2 * FRAMES / RATE_HZ / 60))
    # every pair shares half of the frames of each: 30 of 30 + 30 + 30
    assert got.association == pytest.approx(1 / 3)
    assert got.hota == pytest.approx(np.sqrt(1 / 3))
    assert got.detection == pytest.approx(1)


def test_misses_and_false_people_count_once_each() -> None:
    truth = lines(2)
    result = np.concatenate([truth, truth[:, :1] + [0, 5.0, 0]], axis=1)
    result[:15, 1] = np.nan
    got = figures(truth, result)
    assert got.missed == pytest.approx(15 / 120)
    assert got.false == pytest.approx(60 / 120)
    right, all_results = 105, 165
    assert got.idf1 == pytest.approx(2 * right / (120 + all_results))
    assert got.switches == 0


def test_an_error_of_a_tenth_of_the_gate_passes_17_of_19_alphas() -> None:
    truth = lines(1)
    got = figures(truth, truth + [0.051, 0, 0])
    assert got.mpjpe_mm == pytest.approx(51)
    assert got.hota == pytest.approx(17 / 19)


def test_who_is_hidden_neither_helps_nor_harms() -> None:
    truth = lines(2)
    asked = np.ones((FRAMES, 2), bool)
    asked[20:40, 1] = False
    result = truth.copy()
    both, one = figures(truth, result, asked), result.copy()
    one[20:40, 1] = np.nan
    assert both == figures(truth, one, asked)
    assert both.idf1 == 1


@pytest.mark.parametrize(("back_as", "right"), [(1, 1), (2, 0)])
def test_the_id_of_one_who_returns(back_as: int, right: int) -> None:
    truth = lines(2)
    truth[20:35, 1] = np.nan
    result = np.full((FRAMES, 3, 4, 3), np.nan)
    result[:, 0], result[:20, 1], result[35:, back_as] = truth[:, 0], truth[:20, 1], truth[35:, 1]
    asked = np.isfinite(truth[..., 0]).any(-1)
    matches = frame_matches(person_distances(truth, result), asked)
    assert returned_right(matches, asked, away_frames=10, settled_frames=5) == (right, 1)


def test_other_keypoints_are_refused() -> None:
    refusal(ShapeError, "expected", lambda: person_distances(lines(1), lines(1)[:, :, :3]))
