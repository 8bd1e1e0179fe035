import dataclasses

import numpy as np
import pytest

from posefuse.core import SE3
from posefuse_ros import topics
from posefuse_ros.messages import diagnostic_status, ns_from_time
from posefuse_ros.ros_output import RosOutput, body_id


def world_from_frames(transforms):
    """Each tf frame in the world, by walking up to the root."""
    by_name = {tf.child_frame_id: tf for tf in transforms}

    def up(frame):
        if frame == "world":
            return SE3.identity()
        q, p = by_name[frame].transform.rotation, by_name[frame].transform.translation
        return up(by_name[frame].header.frame_id) @ SE3(np.array([q.w, q.x, q.y, q.z]), np.array([p.x, p.y, p.z]))

    return {frame: up(frame).matrix4() for frame in by_name}


def test_who_is_tracked_is_reported_when_it_changes(kept, some_pose):
    output = RosOutput(kept)
    # who is lost for a moment, and comes back, keeps the topics
    for t_s, people in ((0, 1), (1, 0), (3, 1), (5, 1), (9, 1), (10, 2), (14, 0), (15, 0), (16.9, 0)):
        output.step(some_pose(people, t_ns=round(t_s * 1e9)))
    of_bodies = {one.topic.name for one in kept.sent if one.topic.name.startswith("/humans/bodies/p")}
    assert not kept.forgotten
    output.step(some_pose(0, t_ns=17_100_000_000))
    assert [m.ids for m in kept.on("/humans/bodies/tracked")] == [["p40"], [], ["p40"], ["p40", "p7"], []]
    assert {name for name in kept.forgotten if "p7" in name} == {f"/humans/bodies/p7/{part}" for part in topics.BODY_PARTS}
    assert len(kept.forgotten) == 2 * len(topics.BODY_PARTS) and of_bodies <= set(kept.forgotten)


def test_tf_frames_stand_where_the_keypoints_are(kept, standing, some_joints):
    pose = standing(left_wrist=(0.25, 0.2, 1.1))
    joints = dataclasses.replace(some_joints, person_id=np.array([1, 9]))
    RosOutput(kept).step(pose, joints)
    (msg,) = kept.on("/tf")
    found = world_from_frames(msg.transforms)
    for frame, keypoint in (("l_wrist", "left_wrist"), ("r_knee", "right_knee"), ("l_shoulder", "left_shoulder")):
        np.testing.assert_allclose(found[f"{frame}_p1"][:3, 3], pose.xyz_world[0, pose.skeleton.index(keypoint)], atol=1e-9)
    np.testing.assert_allclose(found["body_p1"][:3, 3], [0, 0, 0.9], atol=1e-9)
    np.testing.assert_allclose(found["segment_left_thigh_p1"], joints.world_from_segment[-1, 0, 1].matrix4(), atol=1e-9)
    parents = {tf.child_frame_id: tf.header.frame_id for tf in msg.transforms}
    assert parents.pop("body_p1") == "world"
    assert set(parents.values()) == {"body_p1"}


def test_stamps_are_shifted_to_the_epoch(kept, standing, ring_rig):
    output = RosOutput(kept, ring_rig(2), epoch_offset_ns=1_000_000_000_000)
    output.step(standing(), stages={"captured": 4_000_000_000})
    (pose,) = kept.on("/posefuse/pose")
    assert ns_from_time(pose.header.stamp) == 1_005_000_000_000
    assert ns_from_time(pose.stages[0].stamp) == 1_004_000_000_000
    assert {s.t_ns for s in kept.sent} == {1_005_000_000_000}


def test_joints_are_named_after_rep155_with_the_id(kept, standing):
    RosOutput(kept).step(standing(nose=(np.nan,) * 3, left_elbow=(0, 0.5, 1.4), left_wrist=(0, 0.75, 1.4)))
    (state,) = kept.on("/humans/bodies/p1/joint_states")
    at = dict(zip(state.name, state.position, strict=True))
    assert at["l_p_shoulder_p1"] == pytest.approx(np.pi / 2)
    assert "y_head_p1" not in at
    assert "waist_p1" in at


def test_markers_show_bones_seen_at_both_ends(kept, standing):
    pose = standing(left_wrist=(np.nan,) * 3)
    RosOutput(kept).step(pose)
    bones, points, text = kept.on("/posefuse/markers")[0].markers
    lost = pose.skeleton.index("left_wrist")
    assert len(bones.points) == 2 * sum(lost not in bone for bone in pose.skeleton.bone_indices)
    assert len(points.points) == len(points.colors) == len(pose.skeleton) - 1
    assert text.text == "1"
    assert text.pose.position.z > 1.63


@pytest.mark.parametrize(("rate_hz", "period_ns"), [(30, 33_333_000), (100, 10_000_000), (60, 16_666_667), (25, 40_000_000)])
def test_markers_come_at_the_promised_rate_or_that_of_the_poses(kept, standing, rate_hz, period_ns):
    output, seconds = RosOutput(kept), 5
    kept.unwanted = {f"/humans/bodies/p1/{part}" for part in topics.BODY_PARTS} | {"/tf", "/posefuse/pose"}
    pose = standing()
    for i in range(seconds * rate_hz):
        output.step(dataclasses.replace(pose, t_ns=10**18 + i * period_ns))
    assert len(kept.on("/posefuse/markers")) == pytest.approx(seconds * min(rate_hz, 30), abs=1)


def test_markers_continue_after_a_gap_and_after_time_was_set_back(kept, standing):
    output, pose = RosOutput(kept), standing()
    for t_s in (100, 105, 50, 50.01):
        output.step(dataclasses.replace(pose, t_ns=round(t_s * 1e9)))
    assert len(kept.on("/posefuse/markers")) == 3


def test_diagnostics(kept):
    RosOutput(kept, epoch_offset_ns=5).diagnose(10, [diagnostic_status("camera cam02", 2, "no frames for 3 s", {"rate": "0 Hz"})])
    (msg,) = kept.on("/diagnostics")
    assert (msg.status[0].level, msg.status[0].name, msg.status[0].values[0].value) == (2, "posefuse: camera cam02", "0 Hz")
    assert ns_from_time(msg.header.stamp) == 15


@pytest.mark.parametrize("person", [0, 7, -3, 2**40])
def test_ids_are_parts_of_ros_names(person):
    assert body_id(person).isidentifier()


def test_what_no_person_listens_to_is_not_made(kept, standing, some_joints, ring_rig, monkeypatch):
    output = RosOutput(kept, ring_rig(2))
    of_body = {f"/humans/bodies/p1/{part}" for part in topics.BODY_PARTS}
    kept.unwanted = (of_body | {"/tf", "/posefuse/markers"}) - {"/humans/bodies/p1/joint_states"}
    monkeypatch.setattr("posefuse_ros.ros_output.person_markers", None)
    monkeypatch.setattr("posefuse_ros.ros_output.parts_from_pose", None)
    monkeypatch.setattr(RosOutput, "_frames", None)
    output.step(standing())
    assert {s.topic.name for s in kept.sent} == {"/humans/bodies/tracked", "/posefuse/pose", "/humans/bodies/p1/joint_states"}
    kept.unwanted |= {"/humans/bodies/p1/joint_states", "/posefuse/pose"}
    monkeypatch.setattr("posefuse_ros.ros_output.bodies_from_pose", None)
    output.step(standing())
    assert len(kept.sent) == 3
