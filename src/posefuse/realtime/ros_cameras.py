"""Intrinsics of cameras that come from ROS, drivers' or other machines': compared with the rig, or taken for it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

from posefuse.core import Camera, MessageError, Rig, SourceError
from posefuse.messages import topics
from posefuse.messages.camera_messages import CAMERA_INFO_TYPE, camera_from_info, info_from_camera
from posefuse.messages.dds import RosNode
from posefuse.messages.dds_domain import Network
from posefuse.messages.types import decode

from .capture import LiveInput
from .config import CameraInfoUse
from .news import Say

_WITHIN_S = 2.0
# a lens that was calibrated twice agrees with itself to about this, anywhere in the image
AGREE_PX = 3.0
_MOST_BYTES = 10_000
_WAIT_S, _SAY_EVERY_S = 0.2, 10.0


def rig_with_camera_infos(rig: Rig, inputs: Sequence[LiveInput], use: CameraInfoUse, say: Callable[[str], None]) -> Rig:
    """The rig to work with: with intrinsics of `CameraInfo` where `use` is ``use``, else unchanged, and differences are reported.

    Cameras without a ROS topic stay as they are.

    Raises:
        SourceError: images of another size than the rig's, or ``use`` where no calibration comes.
    """
    from posefuse.sources.ros import RosConfig
    from posefuse.sources.ros_camera_info import camera_of_info, info_topic, read_camera_infos

    configs = {entry.camera: entry.config for entry in inputs if isinstance(entry.config, RosConfig)}
    if not configs or use == "ignore":
        return rig
    first = next(iter(configs.values()))
    infos = read_camera_infos([config.topic for config in configs.values()], first.network, _WITHIN_S)
    found: dict[str, Camera] = {}
    for name, config in configs.items():
        topic, msg = info_topic(config.topic), infos.get(config.topic)
        try:
            camera = camera_of_info(rig[name], msg) if msg is not None else None
        except MessageError as error:
            raise SourceError(f"{topic}: {error}; `camera_info=ignore` continues without it") from None
        problem = _problem(rig[name], camera, silent=msg is None)
        if use == "use" and camera is None:
            raise SourceError(f"camera {name}: its intrinsics are wanted from {topic}, but {problem}")
        if use == "check" and problem:
            say(f"camera {name}: {topic}: {problem}")
        if camera is not None:
            found[name] = camera
    if use == "check":
        return rig
    say(f"intrinsics of {', '.join(found)} are those of their CameraInfo")
    return replace(rig, cameras=tuple(found.get(camera.name, camera) for camera in rig))


def _problem(ours: Camera, theirs: Camera | None, *, silent: bool) -> str:
    """What keeps a `CameraInfo` from confirming the rig's intrinsics; empty when it does."""
    from posefuse.sources.ros_camera_info import apart_px

    if silent:
        return f"nothing came within {_WITHIN_S:g} s; the rig's intrinsics are not checked"
    if theirs is None:
        return "it holds no calibration (K is 0); the rig's intrinsics are not checked"
    apart = apart_px(ours, theirs)
    if apart <= AGREE_PX:
        return ""
    return (
        f"it differs from the rig by up to {apart:.1f} px (focal length {theirs.K[0, 0]:.1f} px, rig {ours.K[0, 0]:.1f} px); "
        "the rig's is used, `camera_info=use` takes this one"
    )


def publish_intrinsics(node: RosNode, rig: Rig, cameras: Iterable[str], t_ns: int) -> None:
    """Publish the intrinsics that this node uses; the last message is kept for nodes that start later."""
    for name in cameras:
        node.publish(topics.node_camera_info(name), info_from_camera(rig[name], t_ns), t_ns)


class NodeIntrinsics:
    """What camera nodes publish about the cameras of a rig.

    Attributes:
        cameras: those received so far, with the poses of the rig.
        problems: one line per camera whose intrinsics cannot be used, or differ from the rig's, that was not taken yet.
    """

    def __init__(self, node: RosNode, rig: Rig) -> None:
        self.cameras: dict[str, Camera] = {}
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
                    self.problems.append(f"camera {name}: intrinsics of its node: {error}; not used")

    def _take(self, ours: Camera, raw: bytes) -> None:
        from posefuse.sources.ros_camera_info import apart_px

        theirs = camera_from_info(ours.name, decode(raw, CAMERA_INFO_TYPE, _MOST_BYTES), ours.cam_from_world)
        if theirs.size_wh != ours.size_wh:
            raise MessageError(f"expected images of {ours.size_wh} px as in the rig, got {theirs.size_wh}")
        self.cameras[ours.name] = theirs
        apart = apart_px(ours, theirs)
        if apart > AGREE_PX:
            self.problems.append(
                f"camera {ours.name}: its node works with other intrinsics than the rig here (up to {apart:.1f} px apart); "
                "`camera_info=use` takes those of the nodes"
            )


def rig_of_nodes(rig: Rig, network: Network, say: Say, duration_s: float | None = None) -> Rig:
    """The rig with the intrinsics that the camera nodes use; waits until those of every camera of the rig are received.

    Raises:
        SourceError: `duration_s` is over before that.
    """
    begun_s = said_s = time.monotonic()
    with RosNode("posefuse_fusion_intrinsics", network) as node:
        intrinsics = NodeIntrinsics(node, rig)
        while missing := [name for name in rig.names if name not in intrinsics.cameras]:
            now_s = time.monotonic()
            if duration_s is not None and now_s - begun_s > duration_s:
                raise SourceError(
                    f"intrinsics of {', '.join(missing)} were not received from any camera node within {duration_s:g} s"
                )
            if now_s - said_s > _SAY_EVERY_S:
                said_s = now_s
                say(f"waiting for the intrinsics of {', '.join(missing)}")
            node.wait(_WAIT_S)
            intrinsics.receive()
    say(f"intrinsics of {', '.join(rig.names)} are those that their nodes work with")
    return replace(rig, cameras=tuple(intrinsics.cameras[name] for name in rig.names))
