"""ROS 1: the same messages to a `roscore`, or to a .bag file without any ROS; their bytes are made by `rosbags`."""

from __future__ import annotations

import io
from functools import cache
from typing import Any

from posefuse.core import Closing, DependencyError, SourceError

from .topics import Topic
from .types import optional_module, ros1_types, ros2_types

# what rosbags keeps of the types it has met
_ROS1_DEFAULTS: dict[str, object] = {}
# nodes of this process
_OPEN: list[Any] = []


def ros1_bytes(msg: Any) -> bytes:
    """ROS 1 serialisation of a ROS 2 message made by `types.message`."""
    from rosbags.convert.converter import migrate_message

    there = migrate_message(ros2_types(), ros1_types(), msg.__msgtype__, msg.__msgtype__, _ROS1_DEFAULTS, msg)
    return bytes(ros1_types().serialize_ros1(there, msg.__msgtype__))


@cache
def carrier_of(type_name: str) -> Any:
    """A rospy message class that carries bytes as they are under the real type's name, checksum and definition."""
    import genpy

    text, checksum = ros1_types().generate_msgdef(type_name, ros_version=1)

    class Carrier(genpy.Message):  # type: ignore[misc]
        _type = type_name.replace("/msg/", "/")
        _md5sum = checksum
        _full_text = text
        _has_header = False
        __slots__ = ("raw",)
        _slot_types = ("uint8[]",)

        def __init__(self, raw: bytes = b"") -> None:
            self.raw = raw

        def serialize(self, buff: io.BytesIO) -> None:
            buff.write(self.raw)

    return Carrier


class Ros1Node(Closing):
    """Publishes to the ROS master that the environment names (`topics.Outlet`).

    A process is one node for rospy: further ones of the process share its name, and the last to close leaves the master.

    Raises:
        DependencyError: rospy is not there.
        SourceError: no master answers.
    """

    def __init__(self, name: str) -> None:
        try:
            import rosgraph
            import rospy
        except ImportError as error:
            raise DependencyError(
                f"rospy: not usable ({error}); install python3-rospy and make the environment with --system-site-packages"
            ) from None
        if not rosgraph.is_master_online():
            raise SourceError(f"ROS 1: no master answers at {rosgraph.get_master_uri()}; start roscore or set ROS_MASTER_URI")
        optional_module("rosbags")
        self._rospy = rospy
        self._publishers: dict[str, Any] = {}
        if not _OPEN:
            rospy.init_node(name, disable_signals=True)
        _OPEN.append(self)

    def publish(self, topic: Topic, msg: Any, t_ns: int) -> None:
        """Send one message; latched topics keep the last one for who comes late."""
        self._publisher(topic).publish(carrier_of(topic.type_name)(ros1_bytes(msg)))

    def wanted(self, topic: Topic) -> bool:
        """Whether there are subscribers, or later ones will get the last message."""
        return self._publisher(topic).get_num_connections() > 0 or topic.latched

    def forget(self, name: str) -> None:
        """Withdraw a topic from the master."""
        publisher = self._publishers.pop(name, None)
        if publisher is not None:
            publisher.unregister()

    def _publisher(self, topic: Topic) -> Any:
        if topic.name not in self._publishers:
            made = carrier_of(topic.type_name)
            self._publishers[topic.name] = self._rospy.Publisher(topic.name, made, queue_size=topic.depth, latch=topic.latched)
        return self._publishers[topic.name]

    def close(self) -> None:
        """Leave the master; safe to call twice."""
        if self not in _OPEN:
            return
        _OPEN.remove(self)
        for publisher in self._publishers.values():
            publisher.unregister()
        self._publishers = {}
        if not _OPEN:
            self._rospy.signal_shutdown("posefuse ends")
