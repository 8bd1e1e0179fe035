"""Our messages, those of cameras and of joint centres: what is sent comes back, what makes no sense is refused."""

import json
from dataclasses import replace

import numpy as np
import pytest
from built import camera_state
from checks import assert_same, refusal
from image_messages import jpeg_image

pytest.importorskip("rosbags", reason="the extra `ros` is not installed")

from posefuse.core import SE3, Camera, JointCentres, LiveJointCentres, MessageError, Skeleton
from posefuse.detection import read_card
from posefuse.formats.joint_centres import read_joint_centres
from posefuse_ros import camera_messages as cm
from posefuse_ros import messages
from posefuse_ros.types import Intake, decode, encode, message, type_hash

STAGES = {"captured": 1_700_000_000_000_000_001, "detected": 1_700_000_000_030_000_000}
SEVEN = Skeleton("seven", tuple(f"k{i}" for i in range(7)))


def over_the_wire(msg):
    return decode(encode(msg), msg.__msgtype__, 2**24)


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
    return replace(sent, depth_m=depth)


@pytest.mark.parametrize("people", [0, 1, 3])
def test_poses_come_back_exactly(some_pose, people):
    sent = some_pose(people)
    back, stages = messages.pose_from_message(over_the_wire(messages.message_from_pose(sent, STAGES)))
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
    first, second = messages.messages_from_joints(some_joints, 6_000_000_000)
    assert (first.person_id, second.person_id) == (40, 7)
    assert first.name[:4] == ["left_hip/flexion", "left_hip/adduction", "left_hip/rotation", "left_knee/flexion"]
    np.testing.assert_array_equal(second.angle_rad.reshape(4, 3), some_joints.angle_rad[1, 1])
    assert messages.ns_from_time(over_the_wire(first).header.stamp) == 6_000_000_000


def all_of(value):
    """What fills a field with one value."""
    return lambda one: np.full_like(one, value)


def changed(msg, fields):
    """The message with other values of fields; a function makes them of the good ones."""
    return replace(msg, **{name: one(getattr(msg, name)) if callable(one) else one for name, one in fields.items()})


# fields that are other values, or are made of their own
WRONG_DETECTIONS = {
    "people": {"people": 4},
    "too many people": {"people": 100_000},
    "score over 1": {"score": lambda one: one + 1},
    "score NaN": {"score": all_of(np.nan)},
    "infinite px": {"xy_px": all_of(np.inf)},
    "negative sigma": {"sigma_px": all_of(-1)},
    "NaN px with a score": {"xy_px": all_of(np.nan)},
    "nameless camera": {"camera": ""},
    "nameless skeleton": {"skeleton": ""},
    "known skeleton, other keypoints": {"keypoints": lambda one: one[::-1]},
    "repeated keypoints": {"skeleton": "mine", "keypoints": ["a"] * 33},
    "short boxes": {"box_px": lambda one: one[:-1]},
    "short colours": {"clothing_lab": lambda one: one[:-1]},
    "short depth": {"depth_m": np.ones(3, np.float32)},
    "negative depth": {"depth_m": np.full(198, -1, np.float32)},
    "infinite depth": {"depth_m": np.full(198, np.inf, np.float32)},
    "infinite colours": {"clothing_lab": all_of(np.inf)},
}


@pytest.mark.parametrize("fault", WRONG_DETECTIONS)
def test_wrong_detections_are_refused_and_counted(some_detections, fault):
    intake = Intake(messages.DETECTIONS_TYPE, messages.detections_from_message)
    good = messages.message_from_detections(some_detections(), {})
    assert intake.take(encode(good)) is not None
    assert intake.take(encode(changed(good, WRONG_DETECTIONS[fault]))) is None
    assert (intake.counts.accepted, intake.counts.refused) == (1, 1)
    assert "Detections2D" in intake.counts.last_refusal


WRONG_POSES = {
    "short xyz": {"xyz_m": lambda one: one[:-1]},
    "infinite": {"xyz_m": all_of(-np.inf)},
    "kind": {"kind": all_of(9)},
    "more people": {"person_id": np.arange(65)},
}


@pytest.mark.parametrize("fault", WRONG_POSES)
def test_wrong_poses_are_refused(some_pose, fault):
    good = messages.message_from_pose(some_pose(), {})
    refusal(MessageError, "Pose3D message", lambda: messages.pose_from_message(over_the_wire(changed(good, WRONG_POSES[fault]))))


def test_a_message_too_long_is_refused_unread(some_detections):
    raw = encode(messages.message_from_detections(some_detections(), {}))
    intake = Intake(messages.DETECTIONS_TYPE, messages.detections_from_message, max_bytes=len(raw) - 1)
    assert intake.take(raw) is None
    assert f"at most {len(raw) - 1} bytes" in intake.counts.last_refusal


def test_a_list_of_impossible_length_is_refused_immediately():
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


# as ROS 2 Jazzy announces them (REP-2016): nested types, sequences, arrays, bounded strings
HASHES = {
    "rmw_dds_common/msg/ParticipantEntitiesInfo": "91a0593bacdcc50ea9bdcf849a938b128412cc1ea821245c663bcd26f83c295e",
    "tf2_msgs/msg/TFMessage": "e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
    "rosgraph_msgs/msg/Clock": "692f7a66e93a3c83e71765d033b60349ba68023a8c689a79e48078bcb5c58564",
    "visualization_msgs/msg/MarkerArray": "86cb8800b6fb05b5eff1abd7a56f62a5641d3ae9a1c29e78e67e704f1d067dcf",
    "sensor_msgs/msg/JointState": "a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e",
    "geometry_msgs/msg/PoseStamped": "10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8",
    "geometry_msgs/msg/PoseWithCovarianceStamped": "26432f9803e43727d3c8f668d1fdb3c630f548af631e2f4e31382371bfea3b6e",
}


@pytest.mark.parametrize("type_name", HASHES)
def test_the_hash_of_a_type_is_that_of_ros_2(type_name):
    assert type_hash(type_name) == f"RIHS01_{HASHES[type_name]}"


# --- cameras and their images


POSE = SE3.from_rotvec([0.1, 0.2, 0.3], [1.0, 2, 3])
K = np.array([[500.0, 0.3, 319.5], [0, 510.0, 239.5], [0, 0, 1]])
CAMERA = Camera(name="cam", size_wh=(640, 480), K=K, cam_from_world=POSE)


@pytest.mark.parametrize(
    ("count", "model", "said"),
    [(0, "pinhole", "plumb_bob"), (4, "pinhole", "plumb_bob"), (5, "pinhole", "plumb_bob"), (8, "pinhole", "rational_polynomial"),
     (14, "pinhole", "rational_polynomial"), (4, "fisheye", "equidistant")],
)  # fmt: skip
@pytest.mark.parametrize("largest", [0.02, 0.0])
def test_a_camera_comes_back_and_projects_alike(count, model, said, largest):
    sent = replace(CAMERA, distortion=np.linspace(largest / 2, largest, count), model=model)
    msg = over_the_wire(cm.info_from_camera(sent, 5))
    assert msg.distortion_model == said
    back = cm.camera_from_info("cam", msg, POSE)
    points = np.random.default_rng(0).uniform(-1, 1, (50, 3)) + POSE.inverse() @ np.array([0, 0, 4.0])
    np.testing.assert_allclose(back.project(points), sent.project(points), atol=1e-9)
    assert back.size_wh == (640, 480)


@pytest.mark.parametrize(
    "change",
    [
        {"distortion_model": "thin_prism"},
        {"binning_x": 2},
        {"k": np.zeros(9)},
        {"d": np.ones(3)},
        {"width": 0},
        {"d": np.full(5, np.nan)},
    ],
)
def test_an_info_that_cannot_be_a_camera_is_refused(change):
    good = cm.info_from_camera(CAMERA, 5)
    refusal(MessageError, "CameraInfo of cam", cm.camera_from_info, "cam", replace(good, **change), POSE)


def test_a_region_of_interest_may_be_all_of_the_image_or_is_refused():
    # sensor_msgs/CameraInfo: all zero is the same as full resolution
    info, whole = cm.info_from_camera(CAMERA, 5), {"width": 640, "height": 480}
    for fields, fits in [({}, True), (whole, True), ({**whole, "x_offset": 8}, False), ({**whole, "height": 240}, False)]:
        msg = replace(info, roi=replace(info.roi, **fields))
        if fits:
            assert cm.camera_from_info("cam", msg, POSE).size_wh == (640, 480)
        else:
            refusal(MessageError, "full image", cm.camera_from_info, "cam", msg, POSE)


RGB = np.random.default_rng(1).integers(0, 256, (6, 10, 3), np.uint8)


def raw(encoding, data, step, size=(10, 6), **more):
    header = cm.header(7_000_000_001, "cam_optical_frame")
    fields = {"header": header, "height": size[1], "width": size[0], "encoding": encoding, "is_bigendian": 0, "step": step}
    return message("sensor_msgs/msg/Image", **fields, data=np.ascontiguousarray(data).ravel().view(np.uint8), **more)


@pytest.mark.parametrize(
    ("encoding", "data"),
    [
        ("rgb8", RGB),
        ("bgr8", RGB[..., ::-1]),
        ("rgba8", np.dstack([RGB, RGB[..., 0]])),
        ("BGRA8", np.dstack([RGB[..., ::-1], RGB[..., 0]])),
    ],
)
def test_colour_encodings(encoding, data):
    padded = np.pad(data.reshape(6, -1), ((0, 0), (0, 5)))
    frame = cm.frame_from_message(over_the_wire(raw(encoding, padded, padded.shape[1])), "cam", 4, 9)
    np.testing.assert_array_equal(frame.image, RGB)
    assert (frame.t_ns, frame.seq, frame.received_ns, frame.camera) == (7_000_000_001, 4, 9, "cam")


def test_grey():
    image = cm.image_from_message(raw("mono8", RGB[..., 0], 10))
    np.testing.assert_array_equal(image, np.repeat(RGB[..., :1], 3, axis=2))


@pytest.mark.parametrize(("encoding", "order"), [("yuv422", [1, 0]), ("yuv422_yuy2", [0, 1])])
def test_yuv_with_neutral_chroma_is_grey(encoding, order):
    pair = np.full((6, 10, 2), [130, 128], np.uint8)[..., order]
    image = cm.image_from_message(raw(encoding, pair, 20))
    assert np.ptp(image) == 0 and 100 < image[0, 0, 0] < 180


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
def test_bayer_patterns_by_their_first_row(pattern):
    """A red wall through each colour filter array is red."""
    level = {"r": 200, "g": 20, "b": 30}
    cell = np.array([level[c] for c in pattern], np.uint8).reshape(2, 2)
    image = cm.image_from_message(raw(f"bayer_{pattern}8", np.tile(cell, (3, 5)), 10))
    np.testing.assert_array_equal(image[2:4, 2:8], np.broadcast_to([200, 20, 30], (2, 6, 3)))


def test_jpeg_comes_back_nearly():
    smooth = np.stack(np.meshgrid(np.arange(64), np.arange(48)), axis=-1).astype(np.uint8)
    smooth = np.dstack([smooth * 3, np.full((48, 64), 90, np.uint8)])
    back = cm.image_from_message(over_the_wire(jpeg_image(smooth, 1)))
    assert back.shape == smooth.shape
    assert np.abs(back.astype(int) - smooth).mean() < 3


@pytest.mark.parametrize(
    "msg",
    [
        raw("mono16", np.zeros((6, 20)), 20),
        raw("rgb8", RGB, 29),
        raw("rgb8", RGB, 30, size=(10, 7)),
        raw("rgb8", RGB, 30, size=(0, 6)),
        raw("yuv422", np.zeros((6, 18), np.uint8), 18, size=(9, 6)),
    ],
)
def test_images_that_do_not_fit_are_refused(msg):
    refusal(MessageError, "cam_optical_frame", cm.image_from_message, msg)


@pytest.mark.parametrize("data", [b"", b"\xff\xd8\xff\xe0 no jpeg", bytes(1000)])
def test_broken_jpegs_are_refused_and_counted(data):
    intake, content = Intake(cm.COMPRESSED_TYPE, cm.image_from_message), np.frombuffer(data, np.uint8)
    msg = message(cm.COMPRESSED_TYPE, header=cm.header(1, "cam"), format="jpeg", data=content)
    assert intake.take(encode(msg)) is None
    assert intake.counts.refused == 1
    assert "CompressedImage" in intake.counts.last_refusal


# --- joint centres on the network: a table comes back, nonsense is refused


HIP = JointCentres(made_by="x", offsets={"hip": {"up": 0.01}})
FULL = read_joint_centres(read_card("blazepose_full").joint_centres_file)


def centres(cameras, table):
    return LiveJointCentres(t_ns=1_700_000_000_000_000_000, cameras=cameras, table=table)


@pytest.mark.parametrize("table", [FULL, HIP, None])
def test_a_table_comes_back_from_the_network(table) -> None:
    msg = cm.message_from_joint_centres(centres(("cam00", "cam02"), table))
    assert cm.joint_centres_from_message(over_the_wire(msg)) == centres(("cam00", "cam02"), table)


SMALL = replace(HIP, lengths={"thigh": 0.4}, by_length={"hip": {"up": {"thigh": 0.1}}})


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"offsets": {"tail": {}}}, "no joint 'tail'"),
        ({"offsets": {"hip": {"sideways": 0.0}}}, "no direction 'sideways'"),
        ({"lengths": {"tail": 0.4}}, "no segment 'tail'"),
        ({"by_length": {"hip": {"up": {"shank": 0.1}}}}, "no segment 'shank'"),
        ({"offsets": {"hip": {"up": np.nan}}}, "input should be a finite number"),
        ({"offsets": {"hip": {"up": 7.0}}}, "offsets: expected numbers from -0.5 to 0.5"),
        ({"lengths": {"thigh": -0.4}}, "lengths: expected numbers from 0.001 to 3"),
        ({"by_length": {"hip": {"up": {"thigh": -2.0}}}}, "by_length: expected numbers from -1 to 1"),
        ({"offsets": {"hip": {"up": "much"}}}, "offsets.hip.up: input should be a valid number"),
        ({"offsets": 3}, "offsets: input should be"),
        ({"more": 3}, "unknown key 'more'"),
    ],
)
def test_a_table_that_makes_no_sense_is_refused(change, words) -> None:
    msg = cm.message_from_joint_centres(centres(("cam00",), SMALL))
    assert cm.joint_centres_from_message(msg).table == SMALL
    content = json.loads(msg.data)
    sent = json.dumps({**content, "table": {**content["table"], **change}})
    refusal(MessageError, words, cm.joint_centres_from_message, replace(msg, data=sent))


@pytest.mark.parametrize(
    ("sent", "words"),
    [
        ("", "expected a JSON object"),
        ("[]", "expected a JSON object"),
        ("[" * 100_000, "expected a JSON object"),
        ('{"t_ns": 1, "cameras": ["a"]}', "expected a JSON object"),
        ('{"t_ns": 1, "cameras": [], "table": null}', "1 to 512 cameras, got"),
        (f'{{"t_ns": 1, "cameras": [{", ".join(600 * ["0"])}], "table": null}}', "1 to 512 cameras, got"),
        ('{"t_ns": 1, "cameras": [7], "table": null}', "1 to 512 cameras, got"),
        (f'{{"t_ns": {10**30}, "cameras": ["a"], "table": null}}', "t_ns: expected nanoseconds"),
        ('{"t_ns": "x", "cameras": ["a"], "table": null}', "t_ns: expected nanoseconds"),
        ('{"t_ns": 1, "cameras": ["a"], "table": 7}', "joint centres message"),
    ],
)
def test_joint_centres_that_make_no_sense_are_refused(sent, words) -> None:
    refusal(MessageError, words, cm.joint_centres_from_message, message(cm.JOINT_CENTRES_TYPE, data=sent))
