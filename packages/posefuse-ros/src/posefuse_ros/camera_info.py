"""`sensor_msgs/CameraInfo` of image topics and of camera nodes: compared with the cameras of a rig."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import cv2
import numpy as np

from posefuse.core import Camera, MessageError, Rig, SourceError
from posefuse.core.arrays import Array
from posefuse.core.ideal_image import drawn_camera, has_lens, optics_of
from posefuse.realtime.capture import LiveInput
from posefuse.realtime.notices import Say

from . import topics
from .camera_messages import CAMERA_INFO_TYPE, camera_from_info, info_from_camera
from .dds import RosNode
from .dds_domain import Network
from .topics import Topic
from .types import Intake, decode

# a simulator counts pixels from the edge of the image, not from the first one's centre: cx and cy half a pixel more
_CENTRE_PX, _FOCAL = 0.6, 1e-3
_GRID = 9
_WITHIN_S = 2.0
# a lens that was calibrated twice agrees with itself to about this, anywhere in the image
AGREE_PX = 3.0


class RigLens:
    """What turns the images of `drawn_camera(camera)` into those of `camera`.

    Raises:
        ConfigError: the lens sees further aside than an ideal image can show.
    """

    def __init__(self, camera: Camera) -> None:
        self.camera = camera
        self.ideal_wh = drawn_camera(camera).size_wh
        map_px = optics_of(camera).map_px
        # outside what the lens shows the map is NaN, which is drawn black
        self._map_px = None if map_px is None else np.nan_to_num(map_px, nan=-10.0)

    def __call__(self, image: Array) -> Array:
        """The camera's image (H, W, 3) of an ideal one; one that has the camera's size already is the camera's.

        Raises:
            SourceError: it has neither size.
        """
        size = (image.shape[1], image.shape[0])
        if size == self.camera.size_wh:
            return image
        if size != self.ideal_wh or self._map_px is None:
            ideal = "" if self._map_px is None else f", or {_size(self.ideal_wh)} of an ideal camera"
            name, own = self.camera.name, _size(self.camera.size_wh)
            raise SourceError(f"camera {name}: expected images of {own} px{ideal}, got {_size(size)}")
        return np.asarray(cv2.remap(image, self._map_px[..., 0], self._map_px[..., 1], cv2.INTER_LINEAR))


def is_ideal_image_of(camera: Camera, other: Camera) -> bool:
    """Whether `other`, as a simulator states it, draws the ideal image of `camera`."""
    drawn = drawn_camera(camera)
    if other.size_wh != drawn.size_wh or other.distortion.any():
        return False
    focal_agrees = np.allclose(other.K[[0, 1], [0, 1]], drawn.K[[0, 1], [0, 1]], rtol=_FOCAL)
    return bool(focal_agrees and np.abs(other.K[:2, 2] - drawn.K[:2, 2]).max() < _CENTRE_PX)


def _size(size_wh: tuple[int, int]) -> str:
    return "{}x{}".format(*size_wh)


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

    A simulator that draws the ideal image of the rig's camera confirms it: intake applies the lens (`RigLens`).

    Raises:
        MessageError: it cannot be a camera, or images are of another size than the rig's.
    """
    if not np.any(np.asarray(msg.k)):
        return None
    found = camera_from_info(camera.name, msg, camera.cam_from_world)
    if found.size_wh != camera.size_wh:
        if has_lens(camera) and is_ideal_image_of(camera, found):
            return camera
        got, want = _size(found.size_wh), _size(camera.size_wh)
        raise MessageError(f"CameraInfo of {camera.name}: images are {got} px, the rig was calibrated at {want}")
    return found


def apart_px(one: Camera, other: Camera) -> float:
    """Largest distance in raw px between what two lenses make of the same rays, over the image of `one`."""
    w, h = one.size_wh
    x, y = np.meshgrid(np.linspace(0, w - 1, _GRID), np.linspace(0, h - 1, _GRID))
    pixels: Array = np.stack([x.ravel(), y.ravel()], axis=-1)
    apart = np.linalg.norm(other.px_from_norm(one.norm_from_px(pixels)) - pixels, axis=1)
    return float(np.nanmax(apart)) if np.isfinite(apart).any() else float("inf")


def compare_camera_infos(rig: Rig, inputs: Sequence[LiveInput], say: Say) -> None:
    """Report each camera whose `CameraInfo` does not confirm the rig's intrinsics; `inputs`: with a ROS topic."""
    topics_of = {entry.camera: entry.config.topic for entry in inputs}
    infos = read_camera_infos([*topics_of.values()], inputs[0].config.network, _WITHIN_S)
    for name, topic in topics_of.items():
        if problem := _problem(rig[name], infos.get(topic)):
            say(f"camera {name}: {info_topic(topic)}: {problem}")


def _problem(ours: Camera, msg: Any) -> str:
    """What keeps a `CameraInfo`, None where none came, from confirming the rig's intrinsics; empty when it does."""
    if msg is None:
        return f"nothing came within {_WITHIN_S:g} s; the rig's intrinsics are not checked"
    try:
        theirs = camera_of_info(ours, msg)
    except MessageError as error:
        return f"{error}; the rig's intrinsics are not checked"
    if theirs is None:
        return "it holds no calibration (K is 0); the rig's intrinsics are not checked"
    apart = apart_px(ours, theirs)
    if apart <= AGREE_PX:
        return ""
    return (
        f"it differs from the rig by up to {apart:.1f} px (focal length {theirs.K[0, 0]:.1f} px, rig {ours.K[0, 0]:.1f} px); "
        "the rig's is used, by which its poses were calibrated"
    )


_MOST_BYTES = 10_000


def publish_intrinsics(node: RosNode, rig: Rig, cameras: Iterable[str], t_ns: int) -> None:
    """Publish the intrinsics that this node uses; the last message is kept for nodes that start later."""
    for name in cameras:
        node.publish(topics.node_camera_info(name), info_from_camera(rig[name], t_ns), t_ns)


class NodeIntrinsics:
    """What camera nodes publish about the cameras of a rig.

    Attributes:
        problems: one line per camera whose intrinsics cannot be read, or differ from the rig's, that was not taken yet.
    """

    def __init__(self, node: RosNode, rig: Rig) -> None:
        self.problems: list[str] = []
        self._rig = rig
        self._readers = {name: node.reader(topics.node_camera_info(name)) for name in rig.names}

    def receive(self) -> None:
        """Take in what has come; never waits."""
        for name, reader in self._readers.items():
            for sample in reader.take():
                try:
                    self._take(self._rig[name], sample.raw)
                except MessageError as error:
                    self.problems.append(f"camera {name}: intrinsics of its node: {error}; not compared")

    def _take(self, ours: Camera, raw: bytes) -> None:
        theirs = camera_from_info(ours.name, decode(raw, CAMERA_INFO_TYPE, _MOST_BYTES), ours.cam_from_world)
        if theirs.size_wh != ours.size_wh:
            raise MessageError(f"expected images of {ours.size_wh} px as in the rig, got {theirs.size_wh}")
        apart = apart_px(ours, theirs)
        if apart > AGREE_PX:
            self.problems.append(
                f"camera {ours.name}: its node works with other intrinsics than the rig here (up to {apart:.1f} px apart); "
                "give all machines the same rig file"
            )
