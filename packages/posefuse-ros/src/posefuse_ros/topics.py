"""Topics: where messages of one type go, and how."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Protocol

from posefuse.foundation.parsing import ros_name

from . import camera_messages, messages
from .bodies import PARTS
from .messages import NAMES_TYPE


@dataclass(frozen=True)
class Topic:
    """A ROS topic.

    Attributes:
        name: with its leading slash, e.g. ``/humans/bodies/tracked``.
        type_name: ``pkg/msg/Type``.
        depth: how many of the newest messages a writer or reader keeps.
        reliable: lost messages are sent again on request.
        latched: late subscribers still get the last message (ROS 2: transient local).
    """

    name: str
    type_name: str
    depth: int = 10
    reliable: bool = True
    latched: bool = False


class Outlet(Protocol):
    """Anything messages can be given to: a ROS 2 node, a ROS 1 node, a recording."""

    def publish(self, topic: Topic, msg: Any, t_ns: int) -> None:
        """Send `msg`, which belongs to the time step `t_ns` (Unix epoch)."""
        ...

    def wanted(self, topic: Topic) -> bool:
        """Whether a message on `topic` has a receiver now; making a message costs more than asking."""
        ...

    def forget(self, name: str) -> None:
        """Nothing more will come on topic `name`, e.g. of a body that has left: released what it holds."""
        ...


# depth: on a topic without keys all cameras share one history at the reader
DETECTIONS = Topic("/posefuse/detections", messages.DETECTIONS_TYPE, depth=64)
# of the detections, each camera machine its own
JOINT_CENTRES = Topic("/posefuse/joint_centres", camera_messages.JOINT_CENTRES_TYPE, depth=1, latched=True)
# of people, given while the session runs
NAMES = Topic("/posefuse/names", NAMES_TYPE, depth=1, latched=True)
POSE = Topic("/posefuse/pose", messages.POSE_TYPE, depth=4)
# for camera nodes: people who are tracked, sure enough to be a pose or not
EXPECTED = Topic("/posefuse/expected", messages.POSE_TYPE, depth=1, reliable=False)
TF = Topic("/tf", "tf2_msgs/msg/TFMessage", depth=20)
TF_STATIC = Topic("/tf_static", "tf2_msgs/msg/TFMessage", depth=1, latched=True)
MARKERS = Topic("/posefuse/markers", "visualization_msgs/msg/MarkerArray", depth=2)
DIAGNOSTICS = Topic("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray")
# of a simulator
CLOCK = Topic("/clock", "rosgraph_msgs/msg/Clock", reliable=False)
TRACKED = Topic("/humans/bodies/tracked", "hri_msgs/msg/IdsList", depth=1, latched=True)


def camera_info(camera: str) -> Topic:
    """Intrinsics of one camera."""
    return Topic(f"/posefuse/{ros_name(camera)}/camera_info", camera_messages.CAMERA_INFO_TYPE, depth=1, latched=True)


def node_camera_info(camera: str) -> Topic:
    """Intrinsics that the node of a camera works with, for the fusion node."""
    return Topic(f"/posefuse/{ros_name(camera)}/node/camera_info", camera_messages.CAMERA_INFO_TYPE, depth=1, latched=True)


def preview(camera: str) -> Topic:
    """Small JPEG images of one camera; a writer without readers need not send."""
    name = f"/posefuse/{ros_name(camera)}/preview/image/compressed"
    return Topic(name, camera_messages.COMPRESSED_TYPE, depth=1, reliable=False)


def preview_info(camera: str) -> Topic:
    """Intrinsics of the small images, where `image_transport` looks for them: next to the image, one per image."""
    return Topic(f"/posefuse/{ros_name(camera)}/preview/camera_info", camera_messages.CAMERA_INFO_TYPE, depth=1, reliable=False)


# of head, wrists and hands
PART_TOPICS = {
    "pose": "geometry_msgs/msg/PoseStamped",
    "pose_with_covariance": "geometry_msgs/msg/PoseWithCovarianceStamped",
}
# those of all parts
OF_PARTS = {f"{part}/{name}": type_name for part in PARTS for name, type_name in PART_TOPICS.items()}
# what each body has a topic of
BODY_PARTS = {
    "joint_states": "sensor_msgs/msg/JointState",
    "joint_angles": messages.JOINT_ANGLES_TYPE,
    **OF_PARTS,
}


@lru_cache(maxsize=1024)
def body(body_id: str, part: str) -> Topic:
    """A topic of one body; `part` is one of `BODY_PARTS`."""
    return Topic(f"/humans/bodies/{body_id}/{part}", BODY_PARTS[part], depth=4)
