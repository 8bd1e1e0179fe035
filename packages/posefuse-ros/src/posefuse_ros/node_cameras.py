"""Intrinsics that camera nodes on other machines work with: compared with the rig, or taken for it."""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import replace

from posefuse.core import Camera, MessageError, Rig, SourceError
from posefuse.realtime.news import Say

from . import topics
from .camera_info import AGREE_PX, apart_px
from .camera_messages import CAMERA_INFO_TYPE, camera_from_info, info_from_camera
from .dds import RosNode
from .dds_domain import Network
from .types import decode

_MOST_BYTES = 10_000
_WAIT_S, _SAY_EVERY_S = 0.2, 10.0


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
