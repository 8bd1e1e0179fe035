import dataclasses

import numpy as np
import pytest
from built import camera_state
from checks import assert_same, refusal

from posefuse.core import MessageError, Skeleton
from posefuse_ros import messages
from posefuse_ros.types import Intake, decode, encode

STAGES = {"captured": 1_700_000_000_000_000_001, "detected": 1_700_000_000_030_000_000}
SEVEN = Skeleton("seven", tuple(f"k{i}" for i in range(7)))


def over_the_wire(msg):
    return decode(encode(msg), msg.__msgtype__, 2**20)


@pytest.mark.parametrize(("people", "deep"), [(0, False), (1, False), (3, True)])
def test_detections_come_back_exactly(some_detections, people, deep):
    sent = with_depth(some_detections(people)) if deep else some_detections(people)
    back, stages = messages.detections_from_message(over_the_wire(messages.message_from_detections(sent, STAGES)))
    assert_same(sent, back)
    assert stages == STAGES
    assert back.skeleton.bones  # the one we know, bones included


def with_depth(sent):
    rng = np.random.default_rng(8)
    depth = rng.uniform(1, 4, sent.xy_img.shape)
    depth[rng.random(sent.score.shape) < 0.3] = np.nan
    return dataclasses.replace(sent, depth_m=depth)


@pytest.mark.parametrize("people", [0, 1, 3])
def test_poses_come_back_exactly(some_pose, people):
    sent = some_pose(people)
    back, stages = messages.pose_from_message(over_the_wire(messages.message_from_pose(sent, STAGES, "world")))
    assert_same(sent, back)
    assert stages == STAGES


def test_a_skeleton_no_person_knows_is_made_from_its_names(some_detections):
    sent = some_detections(2, SEVEN)
    back, _ = messages.detections_from_message(over_the_wire(messages.message_from_detections(sent, {})))
    assert back.skeleton == SEVEN


@pytest.mark.parametrize("t_ns", [0, 1, 999_999_999, 1_700_000_000_123_456_789, -1, -1_500_000_000])
def test_times_come_back_exactly(t_ns):
    assert messages.ns_from_time(messages.time_from_ns(t_ns)) == t_ns


def test_a_time_ros_cannot_hold_is_refused():
    refusal(MessageError, "ROS stamp holds", messages.time_from_ns, 2**62)


def test_joint_angles_are_named_and_of_the_last_time_step(some_joints):
    first, second = messages.messages_from_joints(some_joints, "world", 6_000_000_000)
    assert (first.person_id, second.person_id) == (40, 7)
    assert first.name[:4] == ["left_hip/flexion", "left_hip/adduction", "left_hip/rotation", "left_knee/flexion"]
    np.testing.assert_array_equal(second.angle_rad.reshape(4, 3), some_joints.angle_rad[1, 1])
    assert messages.ns_from_time(over_the_wire(first).header.stamp) == 6_000_000_000


WRONG_DETECTIONS = {
    "people": lambda m: dataclasses.replace(m, people=4),
    "too many people": lambda m: dataclasses.replace(m, people=100_000),
    "score over 1": lambda m: dataclasses.replace(m, score=m.score + 1),
    "score NaN": lambda m: dataclasses.replace(m, score=np.full_like(m.score, np.nan)),
    "infinite px": lambda m: dataclasses.replace(m, xy_px=np.full_like(m.xy_px, np.inf)),
    "negative sigma": lambda m: dataclasses.replace(m, sigma_px=np.full_like(m.sigma_px, -1)),
    "NaN px with a score": lambda m: dataclasses.replace(m, xy_px=np.full_like(m.xy_px, np.nan)),
    "nameless camera": lambda m: dataclasses.replace(m, camera=""),
    "nameless skeleton": lambda m: dataclasses.replace(m, skeleton=""),
    "known skeleton, other keypoints": lambda m: dataclasses.replace(m, keypoints=m.keypoints[::-1]),
    "repeated keypoints": lambda m: dataclasses.replace(m, skeleton="mine", keypoints=["a"] * 33),
    "short boxes": lambda m: dataclasses.replace(m, box_px=m.box_px[:-1]),
    "short colours": lambda m: dataclasses.replace(m, clothing_lab=m.clothing_lab[:-1]),
    "short depth": lambda m: dataclasses.replace(m, depth_m=np.ones(3, np.float32)),
    "negative depth": lambda m: dataclasses.replace(m, depth_m=np.full_like(m.xy_px, -1)),
    "infinite depth": lambda m: dataclasses.replace(m, depth_m=np.full_like(m.xy_px, np.inf)),
    "infinite colours": lambda m: dataclasses.replace(m, clothing_lab=np.full_like(m.clothing_lab, np.inf)),
}


@pytest.mark.parametrize("fault", WRONG_DETECTIONS)
def test_wrong_detections_are_refused_and_counted(some_detections, fault):
    intake = Intake(messages.DETECTIONS_TYPE, messages.detections_from_message)
    good = messages.message_from_detections(some_detections(), {})
    assert intake.take(encode(good)) is not None
    assert intake.take(encode(WRONG_DETECTIONS[fault](good))) is None
    assert (intake.counts.accepted, intake.counts.refused) == (1, 1)
    assert "Detections2D" in intake.counts.last_refusal


WRONG_POSES = {
    "short xyz": lambda m: dataclasses.replace(m, xyz_m=m.xyz_m[:-1]),
    "infinite": lambda m: dataclasses.replace(m, xyz_m=np.full_like(m.xyz_m, -np.inf)),
    "kind": lambda m: dataclasses.replace(m, kind=np.full_like(m.kind, 9)),
    "more people": lambda m: dataclasses.replace(m, person_id=np.arange(65)),
}


@pytest.mark.parametrize("fault", WRONG_POSES)
def test_wrong_poses_are_refused(some_pose, fault):
    good = messages.message_from_pose(some_pose(), {}, "world")
    refusal(MessageError, "Pose3D message", lambda: messages.pose_from_message(over_the_wire(WRONG_POSES[fault](good))))


def test_a_message_too_long_is_refused_unread(some_detections):
    raw = encode(messages.message_from_detections(some_detections(), {}))
    intake = Intake(messages.DETECTIONS_TYPE, messages.detections_from_message, max_bytes=len(raw) - 1)
    assert intake.take(raw) is None
    assert f"at most {len(raw) - 1} bytes" in intake.counts.last_refusal


def test_a_list_of_impossible_length_is_refused_immediately():
    pytest.importorskip("rosbags", reason="the extra `ros` is not installed")
    intake = Intake(messages.DETECTIONS_TYPE, messages.detections_from_message)
    raw = b"\0\1\0\0" + bytes(8) + b"\1\0\0\0\0\0\0\0" + b"\1\0\0\0\0\0\0\0" * 2 + b"\xff\xff\xff\xff" * 4
    assert intake.take(raw) is None


def test_counts_of_the_source_arrive_and_absurd_ones_are_refused(some_detections):
    counts = camera_state("cam 3/left", 900, 300)
    msg = over_the_wire(messages.message_from_detections(some_detections(), {}, counts))
    assert messages.state_from_message(msg) == counts
    unknown = over_the_wire(messages.message_from_detections(some_detections(), {}))
    assert messages.state_from_message(unknown) is None
    for name, value in (("used", 901), ("captured", 2**60)):
        wrong = over_the_wire(messages.message_from_detections(some_detections(), {}, counts))
        setattr(wrong, name, value)
        refusal(MessageError, "frames used", messages.state_from_message, wrong)
