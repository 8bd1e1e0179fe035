import numpy as np
import pytest

from posefuse.core import SKELETONS
from posefuse.tracking.smoothing import bone_lengths
from posefuse.tracking.smoothing import hold_bones as hold_bones_in_place

COCO = SKELETONS["coco17"]
NOISE = np.diag([1.0, 4.0, 2.0]) * 1e-4


def tumbling(count: int, seed: int = 0, scale: np.ndarray | None = None) -> np.ndarray:
    """(T, 17, 3) a rigid body that turns and moves: every bone keeps its length."""
    from scipy.spatial.transform import Rotation

    rng = np.random.default_rng(seed)
    body = rng.normal(size=(17, 3)) * 0.4
    turn = Rotation.from_rotvec(np.cumsum(rng.normal(size=(count, 3)) * 0.1, axis=0)).as_matrix()
    moved = body @ np.swapaxes(turn, 1, 2) + np.cumsum(rng.normal(size=(count, 1, 3)) * 0.01, axis=0)
    return moved if scale is None else moved * scale[:, None, None]


def measured(truth: np.ndarray, seed: int = 1) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    xyz = truth + np.random.default_rng(seed).normal(size=truth.shape) @ np.sqrt(NOISE)
    return xyz, np.broadcast_to(NOISE, (*truth.shape, 3)).copy(), np.ones(truth.shape[:2], bool)


def hold_bones(xyz: np.ndarray, cov: np.ndarray, *rest) -> tuple[np.ndarray, np.ndarray]:
    held, narrowed = xyz.copy(), cov.copy()
    hold_bones_in_place(held, narrowed, *rest)
    return held, narrowed


def test_lengths_are_recovered_without_the_bias_of_noise():
    truth = tumbling(2000)
    length, spread = bone_lengths(*measured(truth), COCO, 0.002)
    one, two = COCO.bone_indices.T
    np.testing.assert_allclose(length, np.linalg.norm(truth[0, one] - truth[0, two], axis=-1), atol=0.002)
    assert (spread < 0.008).all()


def test_bones_that_change_are_held_less():
    truth = tumbling(2000, scale=1 + 0.2 * np.sin(np.arange(2000) * 0.1))
    length, spread = bone_lengths(*measured(truth), COCO, 0.002)
    assert (spread > 0.08 * length).all()


def test_holding_bones_helps_and_the_covariance_matches():
    truth = tumbling(400)
    xyz, cov, used = measured(truth)
    held, narrowed = hold_bones(xyz, cov, used, COCO, 0.002)
    assert np.linalg.norm(held - truth, axis=-1).mean() < 0.9 * np.linalg.norm(xyz - truth, axis=-1).mean()
    error = held - truth
    squared = np.einsum("tki,tkij,tkj->tk", error, np.linalg.inv(narrowed), error)
    assert squared.mean() == pytest.approx(3.0, abs=0.25)


def test_missing_keypoints_stay_missing_and_pull_on_no_person():
    truth = tumbling(50)
    xyz, cov, used = measured(truth)
    elbow, wrist = COCO.index("left_elbow"), COCO.index("left_wrist")
    xyz[10, elbow], cov[10, elbow], used[10, elbow] = np.nan, np.nan, False
    held, narrowed = hold_bones(xyz, cov, used, COCO, 0.002)
    assert np.isnan(held[10, elbow]).all()
    assert np.isnan(narrowed[10, elbow]).all()
    np.testing.assert_allclose(held[10, wrist], xyz[10, wrist], atol=1e-12)
    np.testing.assert_allclose(narrowed[10, wrist], NOISE, atol=1e-12)
    assert np.isfinite(np.delete(held[10], elbow, axis=0)).all()


def test_too_short_a_recording_teaches_no_length():
    xyz, cov, used = measured(tumbling(9))
    held, narrowed = hold_bones(xyz, cov, used, COCO, 0.002)
    np.testing.assert_array_equal(held, xyz)
    np.testing.assert_array_equal(narrowed, cov)
