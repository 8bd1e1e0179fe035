"""Cameras and images as `sensor_msgs` and back, and what is added to the keypoints in their views."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import Any

import numpy as np

from posefuse.core import SE3, Camera, ConfigError, Frame, JointCentres, LiveJointCentres, MessageError, PosefuseError
from posefuse.core.arrays import Array
from posefuse.core.errors import choices
from posefuse.formats.joint_centres import joint_centres_from_mapping
from posefuse.foundation.parsing import one_line, short

from .messages import STAMPS_NS, header, ns_from_time, optical_frame
from .types import message, sparse_message

CAMERA_INFO_TYPE = "sensor_msgs/msg/CameraInfo"
IMAGE_TYPE = "sensor_msgs/msg/Image"
COMPRESSED_TYPE = "sensor_msgs/msg/CompressedImage"
MAX_IMAGE_PX = 64_000_000
# channels of each 8-bit encoding and the name of OpenCV's conversion to RGB
_ENCODINGS = {
    "rgb8": (3, None),
    "bgr8": (3, "COLOR_BGR2RGB"),
    "rgba8": (4, "COLOR_RGBA2RGB"),
    "bgra8": (4, "COLOR_BGRA2RGB"),
    "mono8": (1, "COLOR_GRAY2RGB"),
    "yuv422": (2, "COLOR_YUV2RGB_UYVY"),
    "uyvy": (2, "COLOR_YUV2RGB_UYVY"),
    "yuv422_yuy2": (2, "COLOR_YUV2RGB_YUY2"),
    "yuyv": (2, "COLOR_YUV2RGB_YUY2"),
    # OpenCV names a Bayer pattern by its second row, ROS by its first
    "bayer_rggb8": (1, "COLOR_BayerBG2RGB"),
    "bayer_bggr8": (1, "COLOR_BayerRG2RGB"),
    "bayer_gbrg8": (1, "COLOR_BayerGR2RGB"),
    "bayer_grbg8": (1, "COLOR_BayerGB2RGB"),
}
JOINT_CENTRES_TYPE = "std_msgs/msg/String"
MAX_CAMERAS = 512
_WHERE = "joint centres message"


def info_from_camera(camera: Camera, t_ns: int) -> Any:
    """`sensor_msgs/CameraInfo` of one camera; its pose travels as tf (`body_messages.transform`)."""
    d = camera.distortion
    if camera.model == "fisheye" and len(d):
        model = "equidistant"
    elif len(d) > 5:
        model = "rational_polynomial"
    else:
        model, d = "plumb_bob", np.concatenate([d, np.zeros(5 - len(d))])
    return sparse_message(
        CAMERA_INFO_TYPE,
        header=header(t_ns, optical_frame(camera.name)),
        height=camera.size_wh[1],
        width=camera.size_wh[0],
        distortion_model=model,
        d=np.asarray(d),
        k=camera.K.ravel(),
        r=np.eye(3).ravel(),
        p=np.hstack([camera.K, np.zeros((3, 1))]).ravel(),
    )


def camera_from_info(name: str, msg: Any, cam_from_world: SE3) -> Camera:
    """The camera a `CameraInfo` describes, at a pose known from elsewhere; raises MessageError when it cannot be one."""
    models = {"plumb_bob": "pinhole", "rational_polynomial": "pinhole", "equidistant": "fisheye", "": "pinhole"}
    where = f"CameraInfo of {name}"
    if msg.distortion_model not in models:
        raise MessageError(f"{where}: distortion_model {msg.distortion_model!r}; known are: {choices(sorted(models)[1:])}")
    roi = msg.roi
    whole = (roi.x_offset, roi.y_offset, roi.width, roi.height) in ((0, 0, 0, 0), (0, 0, msg.width, msg.height))
    if msg.binning_x > 1 or msg.binning_y > 1 or not whole:
        raise MessageError(f"{where}: expected the full image, got binning or a region of interest; publish the full image")
    model = models[msg.distortion_model]
    try:
        return Camera(
            name=name,
            size_wh=(msg.width, msg.height),
            K=np.asarray(msg.k).reshape(3, 3),
            cam_from_world=cam_from_world,
            # ROS has no word for "no distortion" but zeros; those of a fisheye lens bend as any others
            distortion=np.asarray(msg.d) if np.any(msg.d) or model == "fisheye" else np.zeros(0),
            model=model,
        )
    except PosefuseError as error:
        raise MessageError(f"{where}: {error}") from None


def image_from_message(msg: Any) -> Array:
    """(H, W, 3) uint8 RGB of a `sensor_msgs/Image` or `CompressedImage`; raises MessageError for any other or broken one."""
    return _decompressed(msg) if msg.__msgtype__ == COMPRESSED_TYPE else _raw(msg)


def frame_from_message(msg: Any, camera: str, seq: int, received_ns: int) -> Frame:
    """The frame of one image message; its stamp is taken as mid-exposure."""
    return Frame(
        camera=camera, seq=seq, t_ns=ns_from_time(msg.header.stamp), received_ns=received_ns, image=image_from_message(msg)
    )


def _raw(msg: Any) -> Array:
    import cv2

    where = f"Image in {msg.header.frame_id!r}"
    encoding = msg.encoding.lower()
    if encoding not in _ENCODINGS:
        raise MessageError(f"{where}: encoding {msg.encoding!r} is not read; those read are: {choices(sorted(_ENCODINGS))}")
    channels, conversion = _ENCODINGS[encoding]
    h, w, step = int(msg.height), int(msg.width), int(msg.step)
    if not 0 < h * w <= MAX_IMAGE_PX or step < w * channels or len(msg.data) != h * step:
        raise MessageError(f"{where}: {w}x{h} {encoding} with step {step} does not fit {len(msg.data)} bytes")
    packed = np.asarray(msg.data, np.uint8).reshape(h, step)[:, : w * channels]
    pixels = packed.reshape(h, w) if channels == 1 else packed.reshape(h, w, channels)
    if conversion is None:
        return np.ascontiguousarray(pixels)
    if channels == 2 and w % 2:
        raise MessageError(f"{where}: {encoding} needs an even width, got {w}")
    return np.asarray(cv2.cvtColor(np.ascontiguousarray(pixels), getattr(cv2, conversion)))


def _decompressed(msg: Any) -> Array:
    import cv2

    where = f"CompressedImage in {msg.header.frame_id!r}"
    try:
        image = cv2.imdecode(np.asarray(msg.data, np.uint8), cv2.IMREAD_COLOR_RGB)
    except cv2.error as error:
        raise MessageError(f"{where}: cannot be decoded ({one_line(error)})") from None
    if image is None:
        raise MessageError(f"{where}: {len(msg.data)} bytes of format {msg.format!r} cannot be decoded")
    if image.shape[0] * image.shape[1] > MAX_IMAGE_PX:
        raise MessageError(f"{where}: expected at most {MAX_IMAGE_PX} px, got {image.shape[1]}x{image.shape[0]}")
    return np.asarray(image)


def message_from_joint_centres(centres: LiveJointCentres) -> Any:
    """`std_msgs/String` with a JSON object: ``t_ns``, ``cameras`` and ``table``, null where no offsets are known."""
    table = None if centres.table is None else asdict(centres.table)
    return message(JOINT_CENTRES_TYPE, data=json.dumps({"t_ns": centres.t_ns, "cameras": centres.cameras, "table": table}))


def joint_centres_from_message(msg: Any) -> LiveJointCentres:
    """As given to `message_from_joint_centres`; raises MessageError for anything that does not fit."""
    try:
        content = json.loads(msg.data)
        t_ns, cameras, table = (content[name] for name in ("t_ns", "cameras", "table"))
    except (ValueError, TypeError, KeyError, RecursionError):
        raise MessageError(f"{_WHERE}: expected a JSON object with t_ns, cameras and table") from None
    if not isinstance(t_ns, int) or t_ns not in STAMPS_NS:
        raise MessageError(f"{_WHERE}: t_ns: expected nanoseconds since 1970, got {short(t_ns)}")
    if not isinstance(cameras, list) or not 0 < len(cameras) <= MAX_CAMERAS or not all(isinstance(one, str) for one in cameras):
        raise MessageError(f"{_WHERE}: expected the names of 1 to {MAX_CAMERAS} cameras, got {short(cameras)}")
    return LiveJointCentres(t_ns=t_ns, cameras=tuple(cameras), table=None if table is None else _table(table))


def _table(content: Any) -> JointCentres:
    """The table that was sent; raises MessageError for one that no body has."""
    try:
        table = joint_centres_from_mapping(content, _WHERE)
    except ConfigError as error:
        raise MessageError(str(error)) from None
    known = table.usual[np.isfinite(table.usual)]
    for name, values, low, high in (
        ("offsets", table.metres, -0.5, 0.5),
        ("lengths", known, 0.001, 3.0),
        ("by_length", table.slopes, -1.0, 1.0),
    ):
        if ((values < low) | (values > high)).any():
            raise MessageError(f"{_WHERE}: {name}: expected numbers from {low:g} to {high:g}")
    return table
