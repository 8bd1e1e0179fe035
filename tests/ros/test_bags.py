import re
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from built import observations_from_views, recording_from_views, standing, view_sequence
from built import poses as built_poses
from checks import refusal
from mcap.reader import make_reader

from posefuse.core import SKELETONS, InputError, LivePreview, MessageError, PoseSequence, SourceError
from posefuse.core.skeleton import BLAZEPOSE33
from posefuse.detection import read_card
from posefuse.evaluation.contracts import check_output
from posefuse.formats.joint_centres import read_joint_centres
from posefuse.foundation.parsing import plain
from posefuse.pipeline.config import TrackConfig
from posefuse.pipeline.solve import solve, solve_again
from posefuse_ros import bags, live_recording, topics
from posefuse_ros.camera_messages import info_from_camera
from posefuse_ros.live_output import publish
from posefuse_ros.mcap_output import McapSink, recorded_ns
from posefuse_ros.messages import diagnostic_status, message_from_detections, message_from_pose
from posefuse_ros.ros_output import RosOutput
from posefuse_ros.topics import Topic
from posefuse_ros.types import message


@pytest.fixture
def made(tmp_path, some_detections, some_pose, some_joints, ring_rig):
    """A recording of a little of everything, and what went in."""
    path = tmp_path / "live.mcap"
    views = [some_detections(seed=i, t_ns=1_700_000_000_000_000_000 + i * 33_000_000) for i in range(5)]
    poses = [some_pose(seed=i, t_ns=1_700_000_000_010_000_000 + i * 10_000_000) for i in range(9)]
    with bags.Recorder(path) as recorder:
        output = RosOutput(recorder, ring_rig(3, distortion=(0.1, -0.02, 0.001, 0.002, 0.0)))
        output.start(poses[0].t_ns)
        for view in views:
            recorder.publish(topics.DETECTIONS, message_from_detections(view, {"captured": view.t_ns}), view.t_ns)
        for pose in poses:
            output.step(pose, some_joints, {"fused": pose.t_ns})
        output.diagnose(poses[-1].t_ns, [diagnostic_status("camera a", 0, "fine")])
    return path, views, poses


def test_notes_come_back_and_other_libraries_see_them(made, tmp_path, some_pose):
    path, note = tmp_path / "noted.mcap", {"settings": '{"rate_hz": 100.0}', "who": "Zoë"}
    with bags.Recorder(path) as recorder:
        recorder.note(note)
        recorder.publish(topics.POSE, message_from_pose(some_pose(), {}), some_pose().t_ns)
    assert bags.read_notes(path) == note and bags.read_notes(made[0]) == {}
    with path.open("rb") as file:
        assert ("posefuse_live", note) in [(one.name, one.metadata) for one in make_reader(file).iter_metadata()]
    assert len(list(bags.read_poses(path))) == 1


def test_rosbags_reads_every_message_of_it(made):
    from rosbags.highlevel import AnyReader

    path, views, poses = made
    with AnyReader([path]) as reader:
        found = [(c.topic, reader.deserialize(raw, c.msgtype)) for c, _, raw in reader.messages()]
        qos = {c.topic: c.ext.offered_qos_profiles[0] for c in reader.connections}
    assert sum(name == "/posefuse/pose" for name, _ in found) == len(poses)
    view = next(msg for name, msg in found if name == "/posefuse/detections")
    np.testing.assert_array_equal(view.xy_px, views[0].xy_img.ravel())
    assert qos["/tf_static"].durability.name == "TRANSIENT_LOCAL"
    assert qos["/posefuse/pose"].depth == topics.POSE.depth


def test_mcap_ros2_support_reads_every_message_of_it(made):
    from mcap_ros2.decoder import DecoderFactory

    path, _, poses = made
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        found = [(channel.topic, msg) for _, channel, _, msg in reader.iter_decoded_messages(log_time_order=False)]
        # as Foxglove wants them
        assert reader.get_header().profile == "ros2"
        assert {schema.encoding for schema in reader.get_summary().schemas.values()} == {"ros2msg"}
    names = {"/tf", "/tf_static", "/humans/bodies/tracked", "/posefuse/markers", "/diagnostics", "/humans/bodies/p7/joint_angles"}
    assert {name for name, _ in found} >= names
    pose = [msg for name, msg in found if name == "/posefuse/pose"][4]
    np.testing.assert_array_equal(np.array(pose.xyz_m), poses[4].xyz_world.ravel())


def long_recording(path, some_pose, count=600):
    with bags.Recorder(path) as recorder:
        recorder.note({"who": "somebody"})
        for i in range(count):
            recorder.publish(topics.POSE, message_from_pose(some_pose(seed=i), {}), 10_000_000 * i)
    return path.read_bytes()


def test_a_recording_cut_off_anywhere_is_read_to_its_last_whole_chunk(tmp_path, some_pose):
    path = tmp_path / "a.mcap"
    whole = long_recording(path, some_pose)
    seen, said = [], []
    for share in np.linspace(0.02, 0.999, 40):
        path.write_bytes(whole[: int(len(whole) * share)])
        said.clear()
        seen.append(len(list(bags.read_poses(path, warn=said.append))))
        assert len(said) == 1 and "was cut off" in said[0] and "MB are unfinished" in said[0]
        assert bags.read_notes(path) == {"who": "somebody"}
    assert seen == sorted(seen)
    assert seen[0] < 100 < 300 < seen[-1] <= 600
    with pytest.warns(UserWarning, match="cut off"):
        list(bags.read_poses(path))


def test_what_is_no_mcap_or_ends_before_its_header_does_is_reported(tmp_path, some_pose):
    path = tmp_path / "a.mcap"
    whole = long_recording(path, some_pose, 2)
    for raw in (whole[:0], whole[:3], whole[:12], b"RIFF" * 100):
        path.write_bytes(raw)
        refusal(SourceError, "cannot be read as MCAP", lambda: list(bags.read_poses(path)))
    refusal(SourceError, "cannot be opened", lambda: list(bags.read_poses(tmp_path / "no.mcap")))


def test_a_full_disk_leaves_no_empty_file(tmp_path, monkeypatch):
    """Without the flush of the header it would be noticed a chunk later."""
    real = Path.open

    def full(self, mode="r", *args, **kwargs):
        file = real(self, mode, *args, **kwargs)
        if mode == "xb":
            file.close()
            return real(Path("/dev/full"), "wb")
        return file

    if not Path("/dev/full").exists():
        pytest.skip("this system has no /dev/full")
    monkeypatch.setattr(Path, "open", full)
    refusal(InputError, "No space left", bags.Recorder, tmp_path / "a.mcap")
    assert not list(tmp_path.iterdir())


def test_a_recording_is_never_written_over(tmp_path):
    bags.Recorder(tmp_path / "a.mcap").close()
    refusal(InputError, "already exists", bags.Recorder, tmp_path / "a.mcap")
    refusal(InputError, "cannot be written", bags.Recorder, tmp_path / "no" / "a.mcap")


def of_others(path, topic, name, definition):
    """A recording by another program of one message of a type."""
    pytest.importorskip("rosbags", reason="the extra `ros` is not installed")
    from mcap.writer import Writer

    writer = Writer(str(path))
    writer.start(profile="ros2", library="other")
    schema = writer.register_schema(name, "ros2msg", definition)
    writer.add_message(writer.register_channel(topic, "cdr", schema), 1, b"\0\1\0\0\0\0\0\0", 1)
    writer.finish()
    return path


def test_a_type_of_our_name_but_other_fields_is_refused_and_types_no_person_here_knows_are_passed_over(tmp_path):
    with pytest.raises(MessageError, match="another definition"):
        list(bags.read_poses(of_others(tmp_path / "a.mcap", "/posefuse/pose", "posefuse_msgs/msg/Pose3D", b"float64[] xyz\n")))
    assert list(bags.read_mcap(of_others(tmp_path / "b.mcap", "/thing", "strange_msgs/msg/Thing", b"float64 x\n"))) == []


def test_a_rig_without_poses_is_reported(tmp_path, ring_rig):
    with bags.Recorder(tmp_path / "a.mcap") as recorder:
        recorder.publish(topics.camera_info("cam00"), info_from_camera(ring_rig(2)["cam00"], 1), 1)
    refusal(SourceError, "no pose in /tf_static for cam00_optical_frame", bags.read_rig, tmp_path / "a.mcap")


def test_a_rig_is_that_of_the_images_and_not_of_their_small_previews(tmp_path, ring_rig):
    path, rig = tmp_path / "p.mcap", ring_rig(2)
    with bags.Recorder(path) as recorder:
        output = RosOutput(recorder, rig)
        output.start(1_000)
        publish(output, LivePreview(camera="cam00", t_ns=2_000, jpeg=b"jpeg", size_wh=(64, 48)))
        recorder.publish(topics.node_camera_info("cam01"), info_from_camera(rig["cam01"].scaled((32, 24)), 3_000), 3_000)
    assert [camera.size_wh for camera in bags.read_rig(path)] == [camera.size_wh for camera in rig]


def test_the_sink_writes_what_a_live_session_publishes(tmp_path, ring_rig, some_pose):
    t, n, c, k = 4, 2, 3, 17
    rng = np.random.default_rng(0)
    poses = PoseSequence.from_poses([some_pose(seed=i, t_ns=1_000_000_000 * (i + 1)) for i in range(t)])
    score = rng.uniform(0.1, 1, (t, n, c, k))
    score[1, 1, 2] = 0
    xy = rng.uniform(0, 400, (t, n, c, k, 2))
    xy[score == 0] = np.nan
    recording = recording_from_views(ring_rig(c), poses, xy, score, np.where(score > 0, 2.0, np.nan))
    check_output(McapSink().build(), recording, tmp_path)
    (path,) = McapSink(epoch_offset_ns=50).build().write(recording, tmp_path)
    views = [v for v, _ in bags.read_detections(path)]
    assert [v.camera for v in views[:3]] == ["cam00", "cam01", "cam02"]
    assert [len(v) for v in views[3:6]] == [2, 2, 1]
    assert views[0].t_ns == 1_000_000_050
    assert views[0].skeleton == SKELETONS["coco17"]
    np.testing.assert_allclose(views[0].box_img[0, :2], xy[0, 0, 0].min(axis=0), rtol=1e-6)
    back = [p for p, _ in bags.read_poses(path)]
    np.testing.assert_array_equal(back[2].xyz_world, poses.xyz_world[2])
    assert bags.read_rig(path).id == recording.rig.id
    # cameras with clock offsets: the first of them began before the session's zero
    poses = replace(poses, t_ns=poses.t_ns - 1_400_000_000)
    early = recording_from_views(ring_rig(c), poses, xy, score, np.where(score > 0, 2.0, np.nan))
    (path,) = McapSink().build().write(early, tmp_path)
    assert [p.t_ns for p, _ in bags.read_poses(path)] == [0, 1_000_000_000, 2_000_000_000, 3_000_000_000]


@pytest.mark.parametrize("offset_ns", [None, 1_700_000_000_000_000_000])
def test_what_the_sink_writes_solves_again_as_the_result_does(tmp_path, ring_rig, offset_ns):
    rig, table = ring_rig(4), read_joint_centres(read_card("blazepose_full").joint_centres_file)
    rng, t_ns = np.random.default_rng(1), 1_900_000_000 + 33_333_333 * np.arange(30)
    walked = standing(skeleton=BLAZEPOSE33) + np.outer(np.arange(30), [0.03, 0.01, 0])[:, None]
    xy = np.stack([camera.project(walked) for camera in rig], axis=1)[:, None] + rng.normal(0, 2, (30, 1, 4, 33, 2))
    seen = view_sequence(rig, built_poses(walked[:, None], t_ns=t_ns, skeleton=BLAZEPOSE33), xy, sigma_px=2.0)
    config = plain(asdict(TrackConfig(body="off", start_s=1.95)))
    about = {"session": "walk", "config": config, "joint_centres": plain(asdict(table))}
    result = solve(observations_from_views(seen), rig, about)
    (path,) = McapSink(epoch_offset_ns=offset_ns).build().write(result, tmp_path)
    read = live_recording.read(path)
    assert read.poses.t_ns.tolist() == t_ns.tolist()
    again, wanted = solve_again(read), solve_again(result)
    assert again.provenance["joint_centres"] == about["joint_centres"] and again.provenance["session"] == "walk"
    assert again.poses.t_ns.tolist() == wanted.poses.t_ns.tolist()
    np.testing.assert_allclose(again.poses.xyz_world, wanted.poses.xyz_world, atol=1e-6)


def test_every_rosbag2_reads_how_topics_are_offered(tmp_path):
    """Up to Iron policies have to be numbers; later ones take numbers where the record `rosbag2` holds no metadata of its own."""
    with bags.Recorder(tmp_path / "a.mcap") as recorder:
        for name, latched in (("/once", True), ("/often", False)):
            recorder.publish(Topic(name, "std_msgs/msg/String", latched=latched), message("std_msgs/msg/String", data="x"), 1)
    with (tmp_path / "a.mcap").open("rb") as file:
        reader = make_reader(file)
        made_by = {one.name: one.metadata for one in reader.iter_metadata()}
        offered = [channel.metadata["offered_qos_profiles"] for channel in reader.get_summary().channels.values()]
    assert "serialized_metadata" not in made_by["rosbag2"]
    policies = [re.findall(r"^.*(?:history|reliability|durability|liveliness): (.*)$", one, re.MULTILINE) for one in offered]
    # keep last, reliable, transient local or volatile, automatic; see rmw/types.h
    assert policies == [["1", "1", "1", "1"], ["1", "1", "2", "1"]]


def test_a_topic_that_was_latched_is_offered_latched_again(tmp_path):
    latched = Topic("/once", "std_msgs/msg/String", depth=1, latched=True)
    with bags.Recorder(tmp_path / "a.mcap") as recorder:
        recorder.publish(latched, message("std_msgs/msg/String", data="x"), 1)
    (found,) = bags.read_mcap(tmp_path / "a.mcap")
    assert (found.topic, found.msg.data, found.logged_ns) == ("/once", "x", 1)


@pytest.mark.parametrize(
    ("provenance", "expected_ns"),
    [
        ({}, 0),
        ({"start_ns": 1_700_000_000_000_000_123}, 1_700_000_000_000_000_123),
        ({"recorded": "2023-11-14T22:13:20Z"}, 1_700_000_000_000_000_000),
        ({"recorded": "on a Tuesday"}, 0),
    ],
)
def test_stamps_begin_when_the_files_say_it_was_recorded(provenance, expected_ns):
    assert recorded_ns(provenance) == expected_ns
