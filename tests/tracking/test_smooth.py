import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from built import arrays_of, of_white_jerk, poses
from scipy.spatial.transform import Rotation

from posefuse.core import SKELETONS, Kind, PoseSequence
from posefuse.core.skeleton import COCO17
from posefuse.tracking import SmoothSettings, cutoff_hz, smooth, smooth_in_place
from posefuse.tracking.smoothing import _jerk_density, bone_lengths
from posefuse.tracking.smoothing import hold_bones as hold_bones_in_place

RATE_HZ = 60.0
NOISE = np.array([[4.0, 1.0, 0.5], [1.0, 9.0, 2.0], [0.5, 2.0, 3.0]]) * 1e-5
LOOSE = SmoothSettings(bones=False)


def times_ns(count: int) -> np.ndarray:
    return np.round(np.arange(count) * 1e9 / RATE_HZ).astype(np.int64)


def sequence(xyz: np.ndarray, cov: np.ndarray = NOISE, t_ns: np.ndarray | None = None) -> PoseSequence:
    """(T, N, 17, 3) as measured: NaN is missing."""
    return poses(xyz, cov=cov, t_ns=times_ns(len(xyz)) if t_ns is None else t_ns)


def wander(count: int, people: int = 1, seed: int = 0, noise: np.ndarray = NOISE) -> tuple[np.ndarray, np.ndarray]:
    """Truth that is exactly the smoother's model (white jerk), and its measurements (T, N, 17, 3)."""
    rng, dt = np.random.default_rng(seed), 1 / RATE_HZ
    truth = of_white_jerk(count, people, dt, _jerk_density(np.arange(count) * dt, noise[None], 6.0), rng)
    return truth, truth + rng.normal(size=truth.shape) @ np.linalg.cholesky(noise).T


def test_gaps_are_bridged_marked_and_less_certain_the_deeper_in():
    _, seen = wander(200)
    seen[80:90, 0, 3] = np.nan
    result = smooth(sequence(seen), LOOSE)
    assert (result.kind[80:90, 0, 3] == Kind.INTERPOLATED).all()
    assert (result.n_views[80:90, 0, 3] == 0).all()
    assert np.isnan(result.reproj_px[80:90, 0, 3]).all()
    spread = np.trace(result.cov_world[79:91, 0, 3], axis1=-2, axis2=-1)
    assert (np.diff(spread[:6]) > 0).all()
    assert (np.diff(spread[6:]) < 0).all()
    assert (np.delete(result.kind[:, 0, 3], np.arange(80, 90)) == Kind.SMOOTHED).all()


def test_noise_at_the_ends_of_a_gap_does_not_carry_the_path_away():
    """A keypoint that stands still, seen once before a gap of 0.4 s and with errors of 10 cm that alternate after it."""
    seen = np.zeros((90, 1, 17, 3))
    seen[:20, 0, 6] = np.nan
    seen[21:45, 0, 6] = np.nan
    seen[45:60:2, 0, 6, 1] = -0.2
    result = smooth(sequence(seen, np.eye(3) * 4e-3), LOOSE)
    assert (result.kind[21:45, 0, 6] == Kind.INTERPOLATED).all()
    assert np.abs(result.xyz_world[20:45, 0, 6]).max() < 0.4


def test_a_gap_longer_than_allowed_stays_a_gap():
    _, seen = wander(200)
    seen[80:121, 0, 3] = np.nan
    result = smooth(sequence(seen), SmoothSettings(bones=False, max_gap_s=0.5))
    assert (result.kind[80:121, 0, 3] == Kind.MISSING).all()
    assert np.isnan(result.xyz_world[80:121, 0, 3]).all()
    assert np.isnan(result.cov_world[80:121, 0, 3]).all()
    bridged = smooth(sequence(seen), SmoothSettings(bones=False, max_gap_s=1.0))
    assert (bridged.kind[80:121, 0, 3] == Kind.INTERPOLATED).all()


def test_nothing_is_invented_before_the_first_or_after_the_last():
    _, seen = wander(100)
    seen[:7, 0, 2], seen[-5:, 0, 2] = np.nan, np.nan
    seen[:, 0, 4] = np.nan
    result = smooth(sequence(seen), LOOSE)
    assert (result.kind[:7, 0, 2] == Kind.MISSING).all()
    assert (result.kind[-5:, 0, 2] == Kind.MISSING).all()
    assert (result.kind[:, 0, 4] == Kind.MISSING).all()


def test_a_measurement_alone_comes_back_as_it_was():
    _, seen = wander(100)
    seen[:, 0, 1] = np.nan
    seen[50, 0, 1] = [0.1, 0.2, 0.3]
    result = smooth(sequence(seen), LOOSE)
    np.testing.assert_allclose(result.xyz_world[50, 0, 1], [0.1, 0.2, 0.3], atol=1e-9)
    np.testing.assert_allclose(result.cov_world[50, 0, 1], NOISE, rtol=1e-3)


@pytest.mark.parametrize("width", [1, 3])
def test_outliers_are_left_out_and_marked(width):
    truth, seen = wander(200, seed=1)
    seen[60 : 60 + width, 0, 5] += [0.3, -0.2, 0.4]
    result = smooth(sequence(seen), LOOSE)
    assert (result.kind[60 : 60 + width, 0, 5] == Kind.INTERPOLATED).all()
    assert np.abs(result.xyz_world[55:70, 0, 5] - truth[55:70, 0, 5]).max() < 0.1
    # and only they: one in a million of the good ones would be
    assert (result.kind == Kind.INTERPOLATED).sum() <= width + 1


def test_understated_noise_shows_in_the_covariance():
    truth, seen = wander(400, seed=2)
    result = smooth(sequence(seen, NOISE / 25), LOOSE)
    error = result.xyz_world - truth
    squared = np.einsum("tnki,tnkij,tnkj->tnk", error, np.linalg.inv(result.cov_world), error)
    assert squared.mean() < 9


@pytest.mark.parametrize(("share", "lasts_s"), [(0.8, 0.35), (0.6, 0.1)])
def test_errors_that_last_are_stated_and_not_averaged_away(share, lasts_s):
    """NEES of 3 in the middle, at the ends and in gaps; far off when errors are taken for independent."""
    # so little noise that the accelerations of the truth are those of a person: in gaps larger ones are held back
    noise = NOISE / 100
    truth, _ = wander(300, people=12, seed=4, noise=noise)
    rng, keep = np.random.default_rng(5), np.exp(-1 / (RATE_HZ * lasts_s))
    slow, errors = rng.normal(size=truth.shape[1:]), np.empty(truth.shape)
    for i in range(len(truth)):
        errors[i] = np.sqrt(share) * slow + np.sqrt(1 - share) * rng.normal(size=slow.shape)
        slow = keep * slow + np.sqrt(1 - keep**2) * rng.normal(size=slow.shape)
    seen = truth + errors @ np.linalg.cholesky(noise).T
    for start in range(20, 280, 40):
        seen[start : start + 9] = np.nan

    def nees(stated_share: float) -> tuple[PoseSequence, np.ndarray]:
        settings = SmoothSettings(bones=False, lasting_share=stated_share, lasting_s=lasts_s)
        result = smooth(sequence(seen, noise), settings)
        error = result.xyz_world - truth
        return result, np.einsum("tnki,tnkij,tnkj->tnk", error, np.linalg.inv(result.cov_world), error)

    result, squared = nees(share)
    assert squared[result.kind == Kind.SMOOTHED].mean() == pytest.approx(3.0, abs=0.2)
    assert squared[result.kind == Kind.INTERPOLATED].mean() == pytest.approx(2.7, abs=0.4)
    assert squared[[0, -1]].mean() == pytest.approx(2.7, abs=0.5)
    independent, squared = nees(0.0)
    assert squared[result.kind == Kind.SMOOTHED].mean() > 6
    np.testing.assert_array_equal(independent.xyz_world, result.xyz_world)
    with_bones = [smooth(sequence(seen, noise), SmoothSettings(lasting_share=each)).xyz_world for each in (share, 0.0)]
    np.testing.assert_array_equal(*with_bones)


def test_bones_keep_their_length_unless_the_settings_say_otherwise():
    """Two rigid bodies of different size that turn slowly: by default their bones hold each person's own lengths."""
    one, two = COCO17.bone_indices.T
    body = np.random.default_rng(6).normal(size=(2, 17, 3)) * [[[0.3]], [[0.4]]]
    turn = Rotation.from_euler("z", 0.5 * times_ns(240)[:, None] * 1e-9).as_matrix()
    truth = np.einsum("tij,nkj->tnki", turn, body)
    seen = truth + np.random.default_rng(7).normal(size=truth.shape) @ np.linalg.cholesky(NOISE).T
    off_m = {}
    for settings in (SmoothSettings(), LOOSE):
        xyz = smooth(sequence(seen), settings).xyz_world
        lengths, true = (np.linalg.norm(points[..., one, :] - points[..., two, :], axis=-1) for points in (xyz, truth))
        off_m[settings.bones] = np.sqrt(np.mean((lengths - true) ** 2))
    assert off_m[True] < 0.85 * off_m[False]


def test_uncertain_time_steps_are_followed_less():
    _, seen = wander(200)
    cov = np.broadcast_to(NOISE, (200, 1, 17, 3, 3)).copy()
    seen[100, 0, 0] += 0.03
    cov[100, 0, 0] *= 100
    plain, wary = smooth(sequence(seen), LOOSE), smooth(sequence(seen, cov), LOOSE)
    without = seen.copy()
    without[100, 0, 0] = np.nan
    away = [np.linalg.norm(r.xyz_world[100, 0, 0] - smooth(sequence(without), LOOSE).xyz_world[100, 0, 0]) for r in (plain, wary)]
    assert away[1] < 0.1 * away[0]


def test_the_cutoff_gives_way_to_slow_cameras():
    assert cutoff_hz(times_ns(10), SmoothSettings(cutoff_hz=6.0)) == 6.0
    assert cutoff_hz(times_ns(10) * 6, SmoothSettings(cutoff_hz=6.0)) == pytest.approx(3.5, rel=1e-6)
    assert cutoff_hz(times_ns(1), SmoothSettings(cutoff_hz=6.0)) == 6.0


def test_a_single_time_step_and_no_people():
    _, seen = wander(1)
    np.testing.assert_allclose(smooth(sequence(seen), SmoothSettings()).xyz_world, seen, atol=1e-9)
    assert smooth(sequence(seen[:, :0]), SmoothSettings()).xyz_world.shape == (1, 0, 17, 3)


def test_people_who_come_and_go_get_rows_throughout():
    _, seen = wander(3, people=2)
    whole = sequence(seen)
    poses = [whole.at(i) for i in range(3)]
    poses[1] = replace(poses[1], person_id=[1], **arrays_of(poses[1], lambda one: one[1:]))
    stacked = PoseSequence.from_poses(poses)
    assert stacked.person_id.tolist() == [0, 1]
    assert (stacked.kind[1, 0] == Kind.MISSING).all()
    np.testing.assert_array_equal(stacked.xyz_world[:, 1], whole.xyz_world[:, 1])
    np.testing.assert_array_equal(stacked.xyz_world[[0, 2]], whole.xyz_world[[0, 2]])


def test_smoothing_in_place_takes_no_second_copy_of_a_long_recording():
    _, seen = wander(3000, people=4)
    poses = sequence(seen)
    expected = smooth(poses, LOOSE).xyz_world
    xyz, cov = poses.xyz_world.copy(), poses.cov_world.copy()
    tracemalloc.start()
    try:
        smooth_in_place(poses.t_ns, COCO17, xyz, cov, LOOSE)
        most = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert most < 0.5 * (xyz.nbytes + cov.nbytes)
    np.testing.assert_array_equal(xyz, expected)


COCO = SKELETONS["coco17"]
BONE_NOISE = np.diag([1.0, 4.0, 2.0]) * 1e-4


def tumbling(count: int, seed: int = 0, scale: np.ndarray | None = None) -> np.ndarray:
    """(T, 17, 3) a rigid body that turns and moves: every bone keeps its length."""
    rng = np.random.default_rng(seed)
    body = rng.normal(size=(17, 3)) * 0.4
    turn = Rotation.from_rotvec(np.cumsum(rng.normal(size=(count, 3)) * 0.1, axis=0)).as_matrix()
    moved = body @ np.swapaxes(turn, 1, 2) + np.cumsum(rng.normal(size=(count, 1, 3)) * 0.01, axis=0)
    return moved if scale is None else moved * scale[:, None, None]


def measured(truth: np.ndarray, seed: int = 1) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    xyz = truth + np.random.default_rng(seed).normal(size=truth.shape) @ np.sqrt(BONE_NOISE)
    return xyz, np.broadcast_to(BONE_NOISE, (*truth.shape, 3)).copy(), np.ones(truth.shape[:2], bool)


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
    np.testing.assert_allclose(narrowed[10, wrist], BONE_NOISE, atol=1e-12)
    assert np.isfinite(np.delete(held[10], elbow, axis=0)).all()


def test_too_short_a_recording_teaches_no_length():
    xyz, cov, used = measured(tumbling(9))
    held, narrowed = hold_bones(xyz, cov, used, COCO, 0.002)
    np.testing.assert_array_equal(held, xyz)
    np.testing.assert_array_equal(narrowed, cov)
