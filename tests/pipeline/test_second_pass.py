"""Bringing every camera to common time steps, and what is kept of whom."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import built
import numpy as np
import pytest
from built import detections, poses, standing, view_sequence
from checks import refusal

from posefuse.core import DetectionBatch, InputError, LookKind, Observations, PoseSequence, Rig, ViewSequence, views_over_time
from posefuse.core.observations import observations_from_frames, on_time_steps
from posefuse.core.skeleton import BLAZEPOSE33, COCO17
from posefuse.formats.recording import read_recording
from posefuse.fusion import FuseSettings
from posefuse.health import misalignment
from posefuse.pipeline import track
from posefuse.pipeline.second_pass import long_enough, poses_over_time
from posefuse.pipeline.track import recorded_noise_scale
from posefuse.tracking import SmoothSettings

T, K, PERIOD_NS = 40, len(COCO17), 33_333_333
VELOCITY = np.array([1.4, -0.6, 0.1])
LATE_NS = np.array([0, 12_000_000, -9_000_000, 5_000_000])
BODY = np.random.default_rng(4).normal(size=(K, 3)) * [0.2, 0.2, 0.4] + [-0.5, 0.3, 1.0]
FUSE = FuseSettings()


def body(t_ns: float) -> np.ndarray:
    return BODY + VELOCITY * t_ns * 1e-9


def seen_by(
    rig, late_ns: np.ndarray, people: dict[int, range] | None = None, without: dict[int, tuple[int, ...]] | None = None
) -> Observations:
    """Every camera's frame was exposed late by its own time; `without`: time step -> cameras that saw no person."""
    batches, person_ids = [], []
    for i in range(T):
        ids = np.array([person for person, steps in (people or {0: range(T)}).items() if i in steps])
        found = []
        for c, (camera, late) in enumerate(zip(rig, late_ns.tolist(), strict=True)):
            t_ns = i * PERIOD_NS + late
            n = 0 if c in (without or {}).get(i, ()) else len(ids)
            xy = np.repeat(camera.project(body(t_ns))[None], n, axis=0)
            found.append(detections(camera.name, xy, t_ns, score=1.0, sigma_px=1.5))
        batches.append(DetectionBatch(step=i, t_ns=i * PERIOD_NS, kind=LookKind.EXPECTED, detections=tuple(found)))
        person_ids += [ids[: len(one)] for one in found]
    return Observations.from_batches(COCO17, rig.names, batches).with_person_ids(np.concatenate(person_ids))


def views_of(seen: Observations):
    return views_over_time(seen, long_enough(seen))


def raw(seen: Observations, rig) -> PoseSequence:
    """Fused as if every frame had been exposed at its time step."""
    at_steps = replace(seen, frame_t_ns=seen.step_t_ns[seen.frame_step])
    return poses_over_time(views_of(at_steps), rig, FUSE, None)


def worst_mm(sequence: PoseSequence) -> float:
    inner = slice(2, -2)
    true = np.stack([body(t) for t in sequence.t_ns])[:, None]
    return float(1000 * np.abs(sequence.xyz_world - true)[inner].max())


def test_cameras_unsynchronised_agree_once_brought_to_common_time_steps(ring_rig) -> None:
    rig = ring_rig(4, distortion=(-0.1, 0.02, 0.0, 0.0))
    seen = seen_by(rig, LATE_NS)
    views = views_of(seen)
    assert views.t_ns.tolist() == [i * PERIOD_NS for i in range(T)]
    brought = poses_over_time(views, rig, FUSE, None)
    assert worst_mm(raw(seen, rig)) > 5
    assert worst_mm(brought) < 0.3


@pytest.mark.parametrize("steps", [15, 20, 39])
def test_a_long_recording_is_solved_in_blocks_as_if_it_were_whole(ring_rig, monkeypatch: pytest.MonkeyPatch, steps: int) -> None:
    rig = ring_rig(4)
    views = views_of(seen_by(rig, LATE_NS, without={20: (0, 1, 2)}))
    whole = poses_over_time(views, rig, FUSE, SmoothSettings())
    monkeypatch.setattr("posefuse.pipeline.second_pass._BLOCK_STEPS", steps)
    monkeypatch.setattr("posefuse.pipeline.second_pass._OVERLAP_STEPS", 10)
    blocks = poses_over_time(views, rig, FUSE, SmoothSettings())
    assert blocks.t_ns.tolist() == whole.t_ns.tolist() and np.isfinite(whole.xyz_world).all()
    np.testing.assert_allclose(blocks.xyz_world, whole.xyz_world, atol=1e-4)
    assert (blocks.kind == whole.kind).all() and (blocks.n_views == whole.n_views).all()


def test_cameras_synchronised_are_left_as_they_are(ring_rig) -> None:
    rig = ring_rig(4)
    seen = seen_by(rig, np.array([0, 50_000, -80_000, 0]))
    views = views_of(seen)
    for i in (0, 7, T - 1):
        for c in range(4):
            assert np.array_equal(views.xy_img[i, 0, c], seen.detections(i * 4 + c).xy_img[0])


def test_no_interpolation_across_a_hole(ring_rig) -> None:
    rig = ring_rig(4)
    seen = seen_by(rig, LATE_NS, without={10: (1,), 11: (1,)})
    views = views_of(seen)
    assert np.isnan(views.xy_img[10, 0, 1]).all()
    assert (views.score[10, 0, 1] == 0).all()
    nine = views.xy_img[9, 0, 1]  # late frame, so its other neighbour is time step 8, which is there
    assert np.allclose(nine, rig.cameras[1].project(body(9 * PERIOD_NS)), atol=0.2)


def at_rates(rig: Rig, rates_hz: Sequence[float], seen: Callable[[int, int], bool]) -> ViewSequence:
    """Views at 30 Hz of cameras with rates of their own; `seen` (camera, its frame): whether the person is in the image."""
    frames = []
    for c, (camera, rate_hz) in enumerate(zip(rig, rates_hz, strict=True)):
        for i in range(int(T * PERIOD_NS * 1e-9 * rate_hz) + 2):
            t_ns = round(i * 1e9 / rate_hz)
            xy = camera.project(body(t_ns))[None][: int(seen(c, i))]
            frames.append(detections(camera.name, xy, t_ns, score=1.0, sigma_px=1.5))
    log = on_time_steps(observations_from_frames(COCO17, rig.names, frames), PERIOD_NS * np.arange(T))
    return views_over_time(log.with_person_ids(np.where(log.frame_step[log.detection_frame] >= 0, 0, -1)), [0])


@pytest.mark.parametrize("rate_hz", [25.0, 23.976, 15.0])
def test_a_slower_camera_has_a_view_between_its_own_frames(ring_rig, rate_hz: float) -> None:
    rig = ring_rig(4)
    views = at_rates(rig, (30.0, 30.0, 30.0, rate_hz), lambda c, i: True)
    true = np.stack([rig.cameras[3].project(body(t_ns)) for t_ns in views.t_ns])
    inner = slice(1, -2)
    np.testing.assert_allclose(views.xy_img[inner, 0, 3], true[inner], atol=0.2)
    np.testing.assert_allclose(views.sigma_px[inner, 0, 3], 1.5)


def test_a_slower_camera_has_none_where_a_frame_does_not_show_the_person_or_its_frames_are_far_apart(ring_rig) -> None:
    rig = ring_rig(4)
    views = at_rates(rig, (30.0, 30.0, 30.0, 15.0), lambda c, i: c < 3 or i != 10)
    assert np.flatnonzero((views.score[:, 0, 3] == 0).all(axis=-1))[:3].tolist() == [19, 20, 21]
    slow = at_rates(rig, (30.0, 30.0, 30.0, 10.0), lambda c, i: True)
    assert np.flatnonzero((slow.score[:, 0, 3] > 0).any(axis=-1)).tolist() == list(range(0, T, 3))


def test_any_person_was_seen_for_a_moment_only_is_left_out(ring_rig) -> None:
    rig = ring_rig(4)
    seen = seen_by(rig, LATE_NS * 0, people={0: range(T), 1: range(3)})
    assert views_of(seen).person_id.tolist() == [0]
    kept = seen.keeping(long_enough(seen))
    assert len(kept) == len(seen)
    assert set(kept.person_id.tolist()) == {0, -1}
    refusal(InputError, "no person could be followed", lambda: long_enough(seen.keeping([])))


def test_limbs_keep_their_sides_between_two_frames_that_name_them_differently(ring_rig) -> None:
    rig = ring_rig(4)
    seen = seen_by(rig, LATE_NS)
    confused = seen.detection_frame % 8 < 4  # every other time step, in all cameras
    xy, mirror, sided = np.array(seen.xy_img), COCO17.mirror, np.arange(COCO17.index("left_shoulder"), K)
    xy[np.ix_(confused, sided)] = xy[np.ix_(confused, mirror[sided])]
    views, right = views_of(replace(seen, xy_img=xy)), views_of(seen)
    # time steps at which the nearer frame names them right, and those at which it does not: never a leg halfway to the other
    assert np.allclose(views.xy_img[1::2], right.xy_img[1::2], atol=1e-3)
    assert np.allclose(views.xy_img[2:-2:2][..., sided, :], right.xy_img[2:-2:2][..., mirror[sided], :], atol=1e-3)


def test_ankles_that_cross_between_two_frames_do_not_swap_the_legs(ring_rig) -> None:
    rig = ring_rig(4)
    seen = seen_by(rig, LATE_NS)
    ankles = list(COCO17.indices(["left_ankle", "right_ankle"]))
    xy = np.array(seen.xy_img)
    swap = seen.detection_frame % 8 < 4
    xy[np.ix_(swap, ankles)] = xy[np.ix_(swap, ankles[::-1])]
    views = views_of(replace(seen, xy_img=xy))
    hips = COCO17.indices(["left_hip", "right_hip", "left_knee", "right_knee"])
    assert np.allclose(views.xy_img[..., hips, :], views_of(seen).xy_img[..., hips, :], atol=1e-3, equal_nan=True)


def test_limbs_that_all_cameras_swap_until_out_of_sight_are_named_by_where_feet_and_nose_point(ring_rig) -> None:
    rig = ring_rig(4)
    xyz = standing(skeleton=BLAZEPOSE33)
    xy = np.tile(np.stack([camera.project(xyz) for camera in rig]), (T, 1, 1, 1, 1))
    xy[:10] = xy[:10][..., BLAZEPOSE33.mirror, :]
    xy[10:14] = np.nan
    still = poses(np.tile(xyz, (T, 1, 1, 1)), t_ns=np.arange(T) * PERIOD_NS, skeleton=BLAZEPOSE33)
    fused = poses_over_time(view_sequence(rig, still, xy, sigma_px=1.5), rig, FUSE, None)
    limbs = np.concatenate([side for limb in BLAZEPOSE33.limbs for side in limb])
    found = fused.xyz_world[np.r_[0:10, 14:T]][:, 0, limbs]
    assert np.allclose(found, xyz[limbs], atol=1e-3, equal_nan=True)
    assert np.isfinite(found).any(axis=(0, 2)).sum() >= 14


# --- views that confuse the legs while they pass each other: what one round of naming leaves wrong, the next ones put right


STRIDES = 90
LEFT = COCO17.indices(["left_hip", "left_knee", "left_ankle"])
LEGS, MIRRORED = [*LEFT, *COCO17.mirror[LEFT]], [*COCO17.mirror[LEFT], *LEFT]
T_S = np.arange(STRIDES) / 30
CROSSINGS = (17, 33, 50, 67)


def walker() -> np.ndarray:
    """(T, K, 3) m: legs that swing past each other at 0.9 Hz, walking 1 m/s."""
    xyz = np.tile(np.random.default_rng(5).normal(size=(1, K, 3)) * 0.05 + [-1.5, 0, 1], (STRIDES, 1, 1))
    xyz[..., 0] += T_S[:, None]
    swing = 0.3 * np.sin(2 * np.pi * 0.9 * T_S)[:, None] * [0.1, 0.6, 1.0]
    for limb, sign in ((LEFT, 1), (COCO17.mirror[LEFT], -1)):
        xyz[:, limb, 0] += sign * swing
        xyz[:, limb, 1] += sign * 0.1
    return xyz


def confused_views(rig: Rig, xyz: np.ndarray, seed: int) -> ViewSequence:
    """Four in ten views have the legs swapped, each for its own time, whenever they cross; noise of 2 px."""
    rng = np.random.default_rng(seed)
    xy = np.stack([camera.project(xyz) for camera in rig], axis=1) + rng.normal(size=(STRIDES, len(rig), K, 2)) * 2
    for crossing in CROSSINGS:
        for c in np.flatnonzero(rng.uniform(size=len(rig)) < 0.4):
            length = rng.integers(4, 16)
            first = crossing - rng.integers(0, length + 1)
            seen = xy[max(first, 0) : first + length, c]
            seen[:, LEGS] = seen[:, MIRRORED]
    return view_sequence(rig, poses(xyz[:, None], t_ns=(T_S * 1e9).astype(np.int64)), xy[:, None], sigma_px=2.0)


def worst_leg_mm(rig: Rig, seed: int) -> float:
    xyz = walker()
    found = poses_over_time(confused_views(rig, xyz, seed), rig, FuseSettings(), None).xyz_world[:, 0]
    return float(1000 * np.nanmax(np.linalg.norm(found - xyz, axis=-1)[:, LEGS]))


# drawn first to last, none left out; in 16 of them one was not mended, where nearly all views were confused at once
SEEDS = range(10)


def test_legs_that_several_views_confuse_at_once_are_named_right(ring_rig) -> None:
    rig = ring_rig(4)
    assert max(worst_leg_mm(rig, seed) for seed in SEEDS) < 100


# --- the scale of noise that was not fitted is found from what cameras disagree on, and stated


STATED_PX = 2.0
SETTINGS = FuseSettings()


def seen(rig: Rig, true_px: float, steps: int, wrong: float = 0.0) -> Observations:
    """A person who glides past, seen with errors of `true_px`; a share of the keypoints is elsewhere."""
    rng = np.random.default_rng(5)
    xyz = built.standing()[None, None] + np.linspace(-0.5, 0.5, steps)[:, None, None, None] * [1, 0.3, 0]
    xy = np.stack([camera.project(xyz) for camera in rig], axis=2)
    xy += true_px * rng.standard_normal(xy.shape)
    elsewhere = rng.random(xy.shape[:-1]) < wrong
    xy[elsewhere] += rng.uniform(-80, 80, (elsewhere.sum(), 2))
    shape = xy.shape[:-1]
    poses = built.poses(xyz, rate_hz=30.0)
    return built.recording_from_views(rig, poses, xy, np.full(shape, 0.9), np.full(shape, STATED_PX)).observations


# two cameras do not show which of them is wrong
@pytest.mark.parametrize(("cameras", "wrong"), [(2, 0.0), (4, 0.0), (4, 0.05), (7, 0.0), (7, 0.05)])
@pytest.mark.parametrize("factor", [0.7, 1.0, 2.0])
def test_the_true_factor_is_found(factor: float, cameras: int, wrong: float, ring_rig: Callable[..., Rig]) -> None:
    rig = ring_rig(cameras)
    assert recorded_noise_scale(seen(rig, factor * STATED_PX, 150, wrong), rig, SETTINGS) == pytest.approx(factor, rel=0.1)


def test_a_long_recording_is_judged_by_a_part_of_it(ring_rig: Callable[..., Rig], monkeypatch: pytest.MonkeyPatch) -> None:
    rig = ring_rig(4)
    monkeypatch.setattr(track, "_NOISE_TIME_STEPS", 50)
    assert recorded_noise_scale(seen(rig, 2 * STATED_PX, 151), rig, SETTINGS) == pytest.approx(2.0, rel=0.1)


def test_it_is_bounded_and_unknown_where_too_little_is_seen(ring_rig: Callable[..., Rig]) -> None:
    rig = ring_rig(4)
    assert recorded_noise_scale(seen(rig, 20.0, 60), rig, SETTINGS) == 3.0
    assert recorded_noise_scale(seen(rig, 0.1, 60), rig, SETTINGS) == 0.5
    # 12 limb joints
    assert recorded_noise_scale(seen(rig, 2.0, 16), rig, SETTINGS) is None
    assert recorded_noise_scale(seen(rig, 2.0, 17), rig, SETTINGS) is not None


def test_track_scales_and_states_it(ring_rig: Callable[..., Rig], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Exact discs by a network without a noise file: as far down as the limit, in the result and in what is stated of it."""
    discs = pytest.importorskip("discs", reason="the package onnx is not installed")
    from posefuse.cli.main import main
    from posefuse.formats.rig import write_rig

    rig = ring_rig(4, size_wh=(720, 560))
    discs.draw(rig, discs.true_xyz(), tmp_path / "session" / "images")
    write_rig(tmp_path / "session" / "rig.toml", rig)
    (tmp_path / "session" / "posefuse.toml").write_text(f"rate_hz = {discs.RATE_HZ}\n")
    card = str(discs.card_of("simcc", tmp_path))
    found = []
    for least in (10_000, 100):
        monkeypatch.setattr(misalignment, "_LEAST_SEEN", least)
        out = tmp_path / f"out{least}"
        assert main(["track", str(tmp_path / "session"), "--out", str(out), "--networks", card, "--outputs", "trc", "--raw"]) == 0
        found.append(read_recording(out))
    before, after = found
    assert before.provenance["network"]["unknown"].startswith("noise not fitted, keypoints")
    assert after.provenance["network"]["unknown"].startswith("noise not fitted; scaled by 0.5 from this recording, keypoints")
    np.testing.assert_allclose(after.observations.sigma_px, before.observations.sigma_px / 2, rtol=1e-5)
    assert np.nanmedian(after.poses.cov_world / before.poses.cov_world) == pytest.approx(0.25, rel=0.1)
