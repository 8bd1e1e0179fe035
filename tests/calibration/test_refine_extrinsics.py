"""Extrinsics refined from people: what comes back, what stays, and that the world does not matter."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from built import poses, turned, view_sequence
from checks import refusal
from synthetic_walk import BODY, walker

from posefuse.calibration.extrinsics.refine import refined_extrinsics
from posefuse.calibration.settings import RefineSettings
from posefuse.core import SE3, InputError, Rig, ViewSequence

NOISE_PX, MOVED_M, TURNED_RAD = 0.5, (0.004, -0.006, 0.003), (0.003, -0.002, 0.004)


def views_of(rig: Rig, noise_px: float = NOISE_PX, seconds: float = 20.0) -> ViewSequence:
    """What the cameras see of the walker at 10 Hz."""
    sequence = poses(walker(np.arange(round(seconds * 10)) / 10)[:, None], rate_hz=10)
    xy = np.stack([camera.project(sequence.xyz_world) for camera in rig], axis=2)
    xy = xy + np.random.default_rng(3).normal(size=xy.shape) * noise_px
    return view_sequence(rig, sequence, xy, np.full(xy.shape[:-1], 0.9), 2.0)


def repeated(once: ViewSequence) -> ViewSequence:
    """Of a standing person, 30 s."""
    arrays = {name: np.repeat(getattr(once, name), 60, axis=0) for name in ("xy_img", "score", "sigma_px")}
    return replace(once, t_ns=np.arange(60) * 500_000_000, **arrays)


def displaced(rig: Rig, which: int) -> Rig:
    """One camera of the rig moved and turned."""
    cameras = list(turned(rig, which, TURNED_RAD))
    R = cameras[which].cam_from_world.matrix()
    cameras[which] = replace(cameras[which], cam_from_world=SE3.from_matrix(R, -R @ (rig.centres_world()[which] + MOVED_M)))
    return replace(rig, cameras=tuple(cameras))


def test_a_rig_that_is_right_stays(ring_rig: Callable[..., Rig]) -> None:
    rig = ring_rig(4, distortion=(-0.1, 0.02, 0.001, -0.001))
    found = refined_extrinsics(rig, views_of(rig, noise_px=0.0))
    assert found.moved_m.max() < 1e-5
    assert found.turned_rad.max() < 1e-5


@pytest.mark.parametrize("which", [0, 2])
def test_a_camera_that_was_displaced_comes_back(ring_rig: Callable[..., Rig], which: int) -> None:
    """The others share a small part of its displacement: only images tell, and the world itself is free within the prior."""
    rig = ring_rig(4, distortion=(-0.1, 0.02, 0.001, -0.001))
    wrong, views = displaced(rig, which), views_of(rig)
    # here the noise of every keypoint is independent
    found = refined_extrinsics(wrong, views, RefineSettings(together=1.0))
    # of the eight coordinates of a point that four cameras see, three are taken up by the point
    assert found.after_px == pytest.approx(NOISE_PX * np.sqrt(5 / 8), rel=0.1)
    assert found.before_px > 1.3 * found.after_px
    assert int(np.argmax(found.turned_rad)) == which
    before, after = (relative_errors(one, rig, which) for one in (wrong, found.rig))
    assert (after < np.array([0.5, 0.2]) * before).all(), (before, after)


def relative_errors(rig: Rig, truth: Rig, which: int) -> np.ndarray:
    """Of the camera's pose in the axes of each other camera: position in m and orientation in rad, the worst of them."""
    worst = np.zeros(2)
    for other in set(range(len(rig))) - {which}:
        poses = ([some.cameras[c].cam_from_world for c in (which, other)] for some in (rig, truth))
        one, right = (mine @ theirs.inverse() for mine, theirs in poses)
        off = one @ right.inverse()
        worst = np.maximum(worst, [np.linalg.norm(off.xyz), np.linalg.norm(off.rotvec())])
    return worst


def test_a_narrow_prior_holds_the_cameras(ring_rig: Callable[..., Rig]) -> None:
    rig = ring_rig(4)
    wrong = displaced(rig, 1)
    held = refined_extrinsics(wrong, views_of(rig), RefineSettings(move_sigma_m=1e-6, turn_sigma_rad=1e-6))
    free = refined_extrinsics(wrong, views_of(rig))
    assert held.moved_m.max() < 1e-4 < free.moved_m.max()
    assert held.turned_rad.max() < 1e-4 < free.turned_rad.max()


def test_the_world_does_not_matter(ring_rig: Callable[..., Rig]) -> None:
    rig = ring_rig(4)
    wrong, views = displaced(rig, 1), views_of(rig)
    new_from_old = SE3.from_rotvec(np.array([0.3, -0.8, 1.1]), np.array([2.0, -3.0, 0.7]))
    here, there = refined_extrinsics(wrong, views), refined_extrinsics(wrong.moved(new_from_old), views)
    np.testing.assert_allclose(there.moved_m, here.moved_m, atol=1e-5)
    np.testing.assert_allclose(there.rig.centres_world(), here.rig.moved(new_from_old).centres_world(), atol=1e-5)


def test_wild_keypoints_do_little_harm(ring_rig: Callable[..., Rig]) -> None:
    rig = ring_rig(4)
    wrong, views = displaced(rig, 1), views_of(rig)
    xy = np.array(views.xy_img)
    wild = np.random.default_rng(5).random(xy.shape[:-1]) < 0.05
    xy[wild] += 80.0
    clean, spoilt = (refined_extrinsics(wrong, one) for one in (views, replace(views, xy_img=xy)))
    off_m = np.linalg.norm(clean.rig.centres_world() - spoilt.rig.centres_world(), axis=-1)
    assert off_m.max() < 0.3 * np.linalg.norm(MOVED_M)


def test_views_that_cannot_be_used_are_refused(ring_rig: Callable[..., Rig]) -> None:
    rig = ring_rig(4)
    views = views_of(rig)
    blind = replace(views, score=np.zeros(views.score.shape))
    refusal(InputError, "expected views of cameras", refined_extrinsics, ring_rig(3), views)
    refusal(InputError, "no keypoint was seen by two cameras", refined_extrinsics, rig, blind)


def test_someone_who_stands_counts_as_one_look(ring_rig: Callable[..., Rig]) -> None:
    """A network errs in the same way all the time then, here by 4 px, in each camera differently: that says little of the rig."""
    rig = ring_rig(4)
    once = views_of(rig, noise_px=4.0, seconds=0.1)
    one, many = (refined_extrinsics(rig, views) for views in (once, repeated(once)))
    np.testing.assert_allclose(many.moved_m, one.moved_m, rtol=0.02)
    np.testing.assert_allclose(many.turned_rad, one.turned_rad, rtol=0.02)


@pytest.mark.parametrize("hidden", ["left_wrist", "left_"])
def test_limbs_that_no_camera_sees_make_no_look_count_for_more(ring_rig: Callable[..., Rig], hidden: str) -> None:
    rig = ring_rig(4)
    once = views_of(rig, noise_px=4.0, seconds=0.1)
    score = np.array(once.score)
    score[..., [name.startswith(hidden) for name in BODY.keypoints]] = 0
    once = replace(once, score=score)
    long = repeated(once)
    one, many = (refined_extrinsics(rig, views, RefineSettings(together=1.0)) for views in (once, long))
    np.testing.assert_allclose(many.moved_m, one.moved_m, rtol=0.02)
    # and one look is one look
    np.testing.assert_array_less(one.moved_m, refined_extrinsics(rig, long, RefineSettings(together=1 / 60)).moved_m)
