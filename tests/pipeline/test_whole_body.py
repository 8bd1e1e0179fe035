"""When a solve fits skeletons, what stays missing, and what that does for a limb that only one camera sees."""

from dataclasses import replace
from typing import Any

import built
import numpy as np
import pytest
from built import arrays_of, recording_from_views, simulated

from posefuse.core import Kind, PoseSequence, Recording
from posefuse.core.skeleton import COCO17
from posefuse.detection.card import read_card
from posefuse.formats.joint_centres import read_joint_centres
from posefuse.kinematics.body import BodySettings, fit_views
from posefuse.pipeline import second_pass
from posefuse.pipeline.config import TrackConfig, changed_config
from posefuse.pipeline.second_pass import fit_bodies_in_place, hidden_people
from posefuse.pipeline.solve import fits_bodies

SIGMA_PX, SIGMA_M, STEPS = 1.0, 0.005, 40
HIDDEN = slice(12, 30)
WRIST, ELBOW = COCO17.index("left_wrist"), COCO17.index("left_elbow")


def keypoints_of(motion: dict, steps: int) -> np.ndarray:
    """(T, 1, K, 3) keypoints of a simulated person at 30 Hz."""
    return simulated(motion, steps / 30, 30)[:steps, :, : len(COCO17)]


@pytest.fixture(scope="module")
def walker() -> np.ndarray:
    return keypoints_of({"kind": "walk", "path": {"shape": "line", "start_m": [-1, 0], "end_m": [1, 0.4]}}, STEPS)


def seen_by(rig, xyz: np.ndarray, hidden_from: int) -> Recording:
    """The first `hidden_from` cameras do not see the left forearm for half a second; it is then without 3D."""
    rng = np.random.default_rng(7)
    xy = np.moveaxis(rig.project(xyz), 0, 2)
    score = np.ones(xy.shape[:-1])
    for joint in (ELBOW, WRIST):
        score[HIDDEN, :, :hidden_from, joint] = 0
    xy = np.where(score[..., None] > 0, xy + rng.normal(size=xy.shape) * SIGMA_PX, np.nan)
    there = np.ones(xyz.shape[:-1], bool)
    there[HIDDEN, :, [[ELBOW], [WRIST]]] = False
    noisy = np.where(there[..., None], xyz + rng.normal(size=xyz.shape) * SIGMA_M, np.nan)
    t_ns, kind = np.arange(len(xyz)) * 33_333_333, np.where(there, Kind.SMOOTHED, Kind.MISSING)
    poses = built.poses(noisy, SIGMA_M, t_ns=t_ns, n_views=there * len(rig), kind=kind)
    return recording_from_views(rig, poses, xy, score, np.where(score > 0, SIGMA_PX, np.nan))


def with_bodies(recording: Recording, *arguments: Any, **options: Any) -> Recording:
    """`fit_bodies_in_place` of a copy."""
    copied = replace(recording.poses, **arrays_of(recording.poses, np.array))
    return fit_bodies_in_place(replace(recording, poses=copied), *arguments, **options)


def test_a_forearm_in_one_view_is_found_with_its_uncertainty(walker, ring_rig) -> None:
    rig = ring_rig(4)
    recording = seen_by(rig, walker, hidden_from=3)
    poses = with_bodies(recording, recording.views, BodySettings(), None).poses
    error = np.linalg.norm(poses.xyz_world - walker, axis=-1)[HIDDEN, 0, WRIST]
    sigma = np.sqrt(np.trace(poses.cov_world, axis1=-2, axis2=-1))[HIDDEN, 0, WRIST]
    assert (poses.kind[HIDDEN, 0, WRIST] == Kind.INTERPOLATED).all()
    assert np.mean(error) < 0.03
    assert (error < 3 * sigma).all()


def test_a_raised_arm_without_3d_at_the_beginning_is_found_although_two_cameras_see_a_hanging_one(ring_rig) -> None:
    """An arm that began hanging would stay so: rays far off count little."""
    raised = keypoints_of({"kind": "overhead"}, 60)[28:]
    rig = ring_rig(4)
    recording = seen_by(rig, raised, hidden_from=0)
    start = slice(0, 4)
    xy, sigma_px = np.array(recording.views.xy_img), np.array(recording.views.sigma_px)
    shoulder = raised[:, :, COCO17.index("left_shoulder")]
    for joint, below_m in ((ELBOW, 0.28), (WRIST, 0.52)):
        hanging = np.moveaxis(rig.project(shoulder + [0, 0.05, -below_m]), 0, 2)
        for camera in (0, 3):
            xy[:, :, camera, joint], sigma_px[:, :, camera, joint] = hanging[:, :, camera], 4 * SIGMA_PX
    poses = without_3d(recording.poses, [ELBOW, WRIST], start)
    views = replace(recording.views, xy_img=xy, sigma_px=sigma_px)
    fitted = with_bodies(replace(recording, poses=poses), views, BodySettings(), None).poses
    error = np.linalg.norm(fitted.xyz_world - raised, axis=-1)[start, 0, WRIST]
    assert error.max() < 0.03


def without_3d(poses: PoseSequence, joints: int | list[int], steps: slice = slice(None)) -> PoseSequence:
    xyz, cov, kind = (np.array(getattr(poses, name)) for name in ("xyz_world", "cov_world", "kind"))
    xyz[steps, :, joints], cov[steps, :, joints], kind[steps, :, joints] = np.nan, np.nan, Kind.MISSING
    return replace(poses, xyz_world=xyz, cov_world=cov, kind=kind)


def test_a_shoulder_without_3d_is_no_obstacle(walker, ring_rig) -> None:
    """Two cameras of four see it, but it never got a point: the person has a skeleton, and the shoulder is found."""
    recording = seen_by(ring_rig(4), walker, hidden_from=0)
    shoulder = COCO17.index("left_shoulder")
    views = recording.views
    score = np.array(views.score)
    score[:, :, :2, shoulder] = 0
    poses = without_3d(recording.poses, shoulder)
    fitted = with_bodies(replace(recording, poses=poses), replace(views, score=score), BodySettings(), None)
    error = np.linalg.norm(fitted.poses.xyz_world - walker, axis=-1)[:, 0, shoulder]
    assert fitted.provenance["fitted_people"] == [0]
    assert (fitted.poses.kind[:, 0, shoulder] == Kind.INTERPOLATED).all()
    assert np.mean(error) < 0.03


def test_a_stand_in_that_no_camera_sees_is_not_invented(walker, ring_rig) -> None:
    recording = seen_by(ring_rig(4), walker, hidden_from=0)
    arm = [COCO17.index(f"left_{joint}") for joint in ("shoulder", "elbow", "wrist")]
    score = np.array(recording.views.score)
    score[..., arm] = 0
    poses = without_3d(recording.poses, arm)
    settings = BodySettings(most_sigma_m=0.02)
    fitted = with_bodies(replace(recording, poses=poses), replace(recording.views, score=score), settings, None).poses
    assert np.isnan(fitted.xyz_world[:, 0, arm]).all()


def test_what_is_not_seen_and_not_certain_stays_missing(walker, ring_rig) -> None:
    recording = seen_by(ring_rig(4), walker, hidden_from=4)
    for most_m in (0.02, 0.5):
        poses = with_bodies(recording, recording.views, BodySettings(most_sigma_m=most_m), None).poses
        found = np.isfinite(poses.xyz_world[HIDDEN, 0, WRIST, 0])
        sigma = np.sqrt(np.trace(poses.cov_world, axis1=-2, axis2=-1) / 3)[HIDDEN, 0, WRIST]
        assert (sigma[found] < most_m).all()
        assert found.all() == (most_m > 0.1)
        assert (poses.kind[HIDDEN, 0, WRIST] == np.where(found, Kind.INTERPOLATED, Kind.MISSING)).all()


def test_a_person_without_hips_keeps_their_poses(walker, ring_rig) -> None:
    hips = [COCO17.index(f"{side}_hip") for side in ("left", "right")]
    headless = np.where(np.isin(np.arange(len(COCO17)), hips)[:, None], np.nan, walker)
    recording = seen_by(ring_rig(4), headless, hidden_from=0)
    fitted = with_bodies(recording, recording.views, BodySettings(), None)
    np.testing.assert_array_equal(fitted.poses.xyz_world, recording.poses.xyz_world)


@pytest.mark.parametrize(
    ("changes", "fitted", "wanted"),
    [
        ({}, True, True),
        ({"body": "auto"}, True, True),
        ({"body": "auto"}, False, False),
        ({"body": "on"}, False, True),
        ({"body": "off"}, True, False),
        ({"body": "auto", "raw": True}, True, False),
        ({"body": "auto", "fuse.weights": "score"}, True, False),
        ({"body": "auto", "joint_centres": False}, True, False),
    ],
)
def test_a_body_is_fitted_if_asked_for_and_with_auto_where_it_is_known_to_help(changes: dict, fitted: bool, wanted: bool) -> None:
    table = read_joint_centres(read_card("blazepose_full").joint_centres_file) if fitted else None
    assert fits_bodies(changed_config(TrackConfig(), changes), table) == wanted


def two_people(recording: Recording, second: np.ndarray) -> Recording:
    """The person of a recording, and another one (id 1) with keypoints of this kind (T, K)."""
    poses, views = recording.poses, recording.views
    both = arrays_of(poses, lambda one: np.repeat(one, 2, axis=1))
    both["xyz_world"] = both["xyz_world"] + np.array([[0, 0, 0], [2.0, 0, 0]])[:, None]
    both["kind"][:, 1] = second
    planes = (np.repeat(plane, 2, axis=1) for plane in (views.xy_img, views.score, views.sigma_px))
    return recording_from_views(recording.rig, replace(poses, person_id=[0, 1], **both), *planes)


def test_people_with_hidden_limbs_are_those_of_whom_a_joint_was_long_unmeasured(walker, ring_rig) -> None:
    recording = seen_by(ring_rig(4), walker, hidden_from=3)
    in_view = np.full((STEPS, len(COCO17)), Kind.SMOOTHED)
    assert hidden_people(two_people(recording, in_view).poses) == {0}
    for steps, hidden in ((2, False), (3, True)):
        gap = in_view.copy()
        gap[5 : 5 + steps, ELBOW] = Kind.INTERPOLATED
        assert (1 in hidden_people(two_people(recording, gap).poses)) == hidden
    # a head turned away is no limb, and time before a person came does not count
    gap = in_view.copy()
    gap[:, 0], gap[:20] = Kind.INTERPOLATED, Kind.MISSING
    assert 1 not in hidden_people(two_people(recording, gap).poses)


def test_without_hidden_limbs_no_person_is_fitted_if_so_asked(walker, ring_rig) -> None:
    in_view = seen_by(ring_rig(4), walker, hidden_from=0)
    poses = replace(in_view.poses, xyz_world=walker, kind=np.full(walker.shape[:-1], Kind.SMOOTHED))
    in_view = replace(in_view, poses=poses)
    assert fit_bodies_in_place(in_view, in_view.views, BodySettings(), None, only_hidden=True) is in_view
    assert with_bodies(in_view, in_view.views, BodySettings(), None) is not in_view


def test_a_mirrored_person_does_not_cost_the_others_their_fit(walker, ring_rig) -> None:
    recording = two_people(seen_by(ring_rig(4), walker, hidden_from=3), np.full((STEPS, len(COCO17)), Kind.SMOOTHED))
    xyz = recording.poses.xyz_world.copy()
    xyz[:, 1] = walker[:, 0][:, list(COCO17.mirror)] + [2.0, 0, 0]
    fitted = with_bodies(replace(recording, poses=replace(recording.poses, xyz_world=xyz)), recording.views, BodySettings(), None)
    assert fitted.provenance["fitted_people"] == [0]


def test_a_fit_of_one_person_is_the_same_next_to_others_and_leaves_them_out(walker, ring_rig, monkeypatch) -> None:
    recording = two_people(seen_by(ring_rig(4), walker, hidden_from=3), np.full((STEPS, len(COCO17)), Kind.SMOOTHED))
    everybody = with_bodies(recording, recording.views, BodySettings(), None)
    fitted: list[int] = []

    def spied(poses, *rest, **options):
        fitted.extend(poses.person_id.tolist())
        return fit_views(poses, *rest, **options)

    monkeypatch.setattr(second_pass, "fit_views", spied)
    alone = with_bodies(recording, recording.views, BodySettings(), None, only_hidden=True)
    assert fitted == alone.provenance["fitted_people"] == [0]
    for name in ("xyz_world", "cov_world", "kind"):
        found = getattr(alone.poses, name)
        np.testing.assert_array_equal(found[:, 0], getattr(everybody.poses, name)[:, 0])
        np.testing.assert_array_equal(found[:, 1], getattr(recording.poses, name)[:, 1])
