import numpy as np
import pytest

from posefuse.core import SKELETONS
from posefuse.fusion import FuseSettings
from posefuse.fusion.triangulation import SEGMENT_OF, SEGMENTS, distance_weight, full_weight, score_weight, side_view


def test_score_weight_is_the_square_above_the_threshold():
    score = np.array([0.0, 0.39, 0.4, 0.5, 1.0])
    np.testing.assert_allclose(score_weight(score, FuseSettings()), [0, 0, 0.16, 0.25, 1])


def test_distance_weight_is_a_trapezoid():
    settings = FuseSettings(distance_min_m=2, distance_max_m=5, distance_fall_m=2)
    away = np.array([0.0, 1.0, 2.0, 3.0, 5.0, 6.0, 7.0, 9.0])
    np.testing.assert_allclose(distance_weight(away, settings), [0, 0.5, 1, 1, 1, 0.5, 0, 0])


def test_side_view_is_large_across_and_small_along_the_optical_axis(ring_rig, standing):
    rig, skeleton = ring_rig(3), SKELETONS["coco17"]
    pose = standing.copy()
    elbow, wrist = skeleton.index("left_elbow"), skeleton.index("left_wrist")
    optical = rig.cameras[1].cam_from_world.matrix()[2]
    pose[elbow] = pose[wrist] + 0.25 * optical
    assert side_view(rig, skeleton, pose)[1, wrist] == pytest.approx(0, abs=1e-12)
    pose[elbow] = pose[wrist] + 0.25 * rig.cameras[1].cam_from_world.matrix()[0]
    assert side_view(rig, skeleton, pose)[1, wrist] == pytest.approx(1, abs=1e-12)
    assert (side_view(rig, skeleton, pose)[:, skeleton.index("nose")] == 1).all()
    with_segment = [name in SEGMENT_OF for name in skeleton.keypoints]
    assert ((side_view(rig, skeleton, standing) < 1).any(axis=0) == with_segment).all()


def test_a_missing_segment_leaves_distance_alone_to_decide(ring_rig, standing):
    rig, skeleton = ring_rig(3), SKELETONS["coco17"]
    wrist = skeleton.index("left_wrist")
    pose = standing.copy()
    pose[skeleton.index("left_elbow")] = np.nan
    settings = FuseSettings(distance_min_m=0.5, distance_max_m=1.0, distance_fall_m=10.0)
    away = np.linalg.norm(pose[wrist] - rig.centres_world(), axis=-1)
    weight = full_weight(rig, skeleton, np.full((3, 17), 0.8), pose, settings)
    np.testing.assert_allclose(weight[:, wrist], 0.64 * distance_weight(away, settings))
    pose[wrist] = np.nan
    np.testing.assert_allclose(full_weight(rig, skeleton, np.full((3, 17), 0.8), pose, settings)[:, wrist], 0.64)


FACE = {
    "brow", "chin", "ear", "eye", "eye_inner", "eye_outer", "head", "inner_lip_lower", "inner_lip_upper", "inner_mouth", "jaw",
    "lid_lower", "lid_upper", "lip_lower", "lip_upper", "mouth", "nose", "nose_base", "nose_bridge", "nostril",
}  # fmt: skip
FINGERS = {"hand_root", "thumb", "index", "middle", "ring", "pinky"}


@pytest.mark.parametrize("name", SKELETONS)
def test_every_body_keypoint_belongs_to_a_segment(name):
    skeleton = SKELETONS[name]
    loose = {
        k.removeprefix("left_").removeprefix("right_").rstrip("0123456789") for k in skeleton.keypoints if k not in SEGMENT_OF
    }
    assert loose <= FACE | FINGERS
    assert {SEGMENT_OF[k] for k in skeleton.keypoints if k in SEGMENT_OF} == set(SEGMENTS)
