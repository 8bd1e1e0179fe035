import dataclasses

import numpy as np
import pytest
from checks import refusal
from image_messages import jpeg_image

pytest.importorskip("rosbags", reason="the extra `ros` is not installed")

from posefuse.core import SE3, Camera, JointCentres, LiveJointCentres, MessageError
from posefuse.detection import read_card
from posefuse.formats.joint_centres import read_joint_centres
from posefuse_ros import camera_messages as cm
from posefuse_ros.types import Intake, decode, encode, message

K = np.array([[500.0, 0.3, 319.5], [0, 510.0, 239.5], [0, 0, 1]])
POSE = SE3.from_rotvec([0.1, 0.2, 0.3], [1.0, 2, 3])


def over_the_wire(msg):
    return decode(encode(msg), msg.__msgtype__, 2**24)


@pytest.mark.parametrize(
    ("count", "model", "said"),
    [(0, "pinhole", "plumb_bob"), (4, "pinhole", "plumb_bob"), (5, "pinhole", "plumb_bob"), (8, "pinhole", "rational_polynomial"),
     (14, "pinhole", "rational_polynomial"), (4, "fisheye", "equidistant")],
)  # fmt: skip
def test_a_camera_comes_back_and_projects_alike(count, model, said):
    sent = Camera(
        name="cam", size_wh=(640, 480), K=K, cam_from_world=POSE, distortion=np.linspace(0.01, 0.02, count), model=model
    )
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
    good = cm.info_from_camera(Camera(name="cam", size_wh=(640, 480), K=K, cam_from_world=POSE), 5)
    refusal(MessageError, "CameraInfo of cam", cm.camera_from_info, "cam", dataclasses.replace(good, **change), POSE)


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


@pytest.mark.parametrize(("encoding", "order"), [("yuv422", (1, 0)), ("yuv422_yuy2", (0, 1))])
def test_yuv_with_neutral_chroma_is_grey(encoding, order):
    luma = np.full((6, 10), 130, np.uint8)
    pair = np.stack([luma, np.full_like(luma, 128)], axis=-1)[..., list(order)]
    image = cm.image_from_message(raw(encoding, pair, 20))
    assert np.ptp(image) == 0
    assert 100 < image[0, 0, 0] < 180


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
    intake = Intake(cm.COMPRESSED_TYPE, cm.image_from_message)
    header = cm.header(1, "cam")
    assert (
        intake.take(encode(message(cm.COMPRESSED_TYPE, header=header, format="jpeg", data=np.frombuffer(data, np.uint8)))) is None
    )
    assert intake.counts.refused == 1
    assert "CompressedImage" in intake.counts.last_refusal


# --- joint centres on the network: a table comes back, nonsense is refused


FULL = read_joint_centres(read_card("blazepose_full").joint_centres_file)
BEGIN_NS = 1_700_000_000_000_000_000


def centres(cameras: tuple[str, ...], table: JointCentres | None) -> LiveJointCentres:
    return LiveJointCentres(t_ns=BEGIN_NS, cameras=cameras, table=table)


@pytest.mark.parametrize("table", [FULL, JointCentres(made_by="x", offsets={"hip": {"up": 0.01}}), None])
def test_a_table_comes_back_from_the_network(table) -> None:
    msg = cm.message_from_joint_centres(centres(("cam00", "cam02"), table))
    assert cm.joint_centres_from_message(over_the_wire(msg)) == centres(("cam00", "cam02"), table)


SMALL = JointCentres(
    made_by="x", offsets={"hip": {"up": 0.01}}, lengths={"thigh": 0.4}, by_length={"hip": {"up": {"thigh": 0.1}}}
)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"joint": ["tail"]}, "no joint 'tail'"),
        ({"direction": ["sideways"]}, "no direction 'sideways'"),
        ({"segment": ["tail"]}, "no segment 'tail'"),
        ({"slope_segment": ["shank"]}, "no segment 'shank'"),
        ({"slope_joint": ["tail"]}, "no joint 'tail'"),
        ({"offset_m": np.array([np.nan])}, "offset_m: nan cannot be"),
        ({"offset_m": np.array([7.0])}, "offset_m: 7 cannot be"),
        ({"length_m": np.array([-0.4])}, "length_m: -0.4 cannot be"),
        ({"slope": np.array([np.inf])}, "slope: inf cannot be"),
        ({"slope": np.array([-2.0])}, "slope: -2 cannot be"),
        ({"offset_m": np.zeros(2)}, "as many names as numbers"),
        ({"direction": []}, "as many names as numbers"),
        ({"slope_joint": []}, "as many names as numbers"),
        ({"joint": 600 * ["hip"], "direction": 600 * ["up"], "offset_m": np.zeros(600)}, "512 at most"),
        ({"joint": 2 * ["hip"], "direction": 2 * ["up"], "offset_m": np.zeros(2)}, "each name once"),
        ({"cameras": []}, "1 to 512 cameras, got 0"),
        ({"cameras": 600 * ["cam00"]}, "1 to 512 cameras, got 600"),
    ],
)
def test_a_table_that_makes_no_sense_is_refused(change, words) -> None:
    msg = cm.message_from_joint_centres(centres(("cam00",), SMALL))
    assert cm.joint_centres_from_message(msg).table == SMALL
    for field, value in change.items():
        setattr(msg, field, value)
    refusal(MessageError, words, cm.joint_centres_from_message, msg)
