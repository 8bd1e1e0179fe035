"""`sensor_msgs/CameraInfo` of image topics: read once, and compared with the cameras of a rig."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from posefuse.core import Camera, MessageError
from posefuse.core.arrays import Array
from posefuse.core.ideal_image import has_lens
from posefuse.messages.camera_messages import CAMERA_INFO_TYPE, camera_from_info
from posefuse.messages.dds import RosNode
from posefuse.messages.dds_domain import Network
from posefuse.messages.intake import Intake
from posefuse.messages.topics import Topic

from .rig_lens import is_ideal_image_of

_GRID = 9


def info_topic(image_topic: str) -> str:
    """Where drivers publish the `CameraInfo` of an image topic: ``camera_info`` next to it."""
    return image_topic.removesuffix("/compressed").rpartition("/")[0] + "/camera_info"


def read_camera_infos(image_topics: Sequence[str], network: Network, wait_s: float) -> Mapping[str, Any]:
    """The first `CameraInfo` of each image topic that comes within `wait_s`, by image topic; others are left out."""
    found: dict[str, Any] = {}
    with RosNode("posefuse/camera_info", network) as node:
        intake: Intake[Any] = Intake(CAMERA_INFO_TYPE, lambda msg: msg)
        readers = {topic: node.reader(Topic(info_topic(topic), CAMERA_INFO_TYPE, depth=1)) for topic in image_topics}
        end_s = time.monotonic() + wait_s
        while len(found) < len(readers) and (left_s := end_s - time.monotonic()) > 0:
            node.wait(left_s)
            for topic, reader in readers.items():
                for sample in reader.take():
                    if (msg := intake.take(sample.raw)) is not None:
                        found.setdefault(topic, msg)
    return found


def camera_of_info(camera: Camera, msg: Any) -> Camera | None:
    """The rig's camera with the intrinsics of a `CameraInfo`; None where it holds no calibration (K is 0).

    A simulator that draws the ideal image of the rig's camera confirms it: intake applies the lens (`rig_lens`).

    Raises:
        MessageError: it cannot be a camera, or images are of another size than the rig's.
    """
    if not np.any(np.asarray(msg.k)):
        return None
    found = camera_from_info(camera.name, msg, camera.cam_from_world)
    if found.size_wh != camera.size_wh:
        if has_lens(camera) and is_ideal_image_of(camera, found):
            return camera
        raise MessageError(
            f"CameraInfo of {camera.name}: images are {_size(found)} px, the rig was calibrated at {_size(camera)}"
        )
    return found


def apart_px(one: Camera, other: Camera) -> float:
    """Largest distance in raw px between what two lenses make of the same rays, over the image of `one`."""
    w, h = one.size_wh
    x, y = np.meshgrid(np.linspace(0, w - 1, _GRID), np.linspace(0, h - 1, _GRID))
    pixels: Array = np.stack([x.ravel(), y.ravel()], axis=-1)
    apart = np.linalg.norm(other.px_from_norm(one.norm_from_px(pixels)) - pixels, axis=1)
    return float(np.nanmax(apart)) if np.isfinite(apart).any() else float("inf")


def _size(camera: Camera) -> str:
    return "{}x{}".format(*camera.size_wh)
