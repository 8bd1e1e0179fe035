"""ROS 1: the same messages to a `roscore`, or to a .bag file without any ROS; their bytes are made by `rosbags`."""

from __future__ import annotations

import io
import struct
import time
from functools import cache
from typing import Any

from posefuse.core import Closing, DependencyError, MessageError, SourceError

from .dds import KeptSamples
from .topics import Topic
from .types import encode, optional_module, ros1_types, ros2_types

# what rosbags keeps of the types it has met, in each direction
_ROS1_DEFAULTS: dict[str, object] = {}
_ROS2_DEFAULTS: dict[str, object] = {}
# nodes of this process
_OPEN: list[Any] = []


def ros1_bytes(msg: Any) -> bytes:
    """ROS 1 serialisation of a ROS 2 message made by `types.message`."""
    from rosbags.convert.converter import migrate_message

    there = migrate_message(ros2_types(), ros1_types(), msg.__msgtype__, msg.__msgtype__, _ROS1_DEFAULTS, msg)
    return bytes(ros1_types().serialize_ros1(there, msg.__msgtype__))


def ros2_message(raw: bytes, type_name: str) -> Any:
    """The message in ROS 1 bytes as `types.message` makes it; raises MessageError when malformed.

    Only of types whose ROS 2 form has no more fields.
    """
    from rosbags.convert.converter import migrate_message
    from rosbags.serde import SerdeError

    try:
        msg = ros1_types().deserialize_ros1(raw, type_name)
        return migrate_message(ros1_types(), ros2_types(), type_name, type_name, _ROS2_DEFAULTS, msg)
    except (SerdeError, AssertionError, IndexError, ValueError, OverflowError, MemoryError, struct.error) as error:
        raise MessageError(f"{type_name}: malformed ROS 1 message ({error})") from None


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

        def deserialize(self, raw: bytes) -> Carrier:
            self.raw = bytes(raw)
            return self

    return Carrier


class Ros1Reader(KeptSamples):
    """The messages of one topic, newest `depth` kept, as CDR bytes like those of `dds.Reader`. Made by `Ros1Node.reader`.

    ROS 1 has no send time: `sent_ns` is the time of arrival.
    """

    def __init__(self, rospy: Any, topic: Topic) -> None:
        super().__init__(topic)
        self._subscriber = rospy.Subscriber(topic.name, carrier_of(topic.type_name), self._keep, queue_size=topic.depth)

    def close(self) -> None:
        """Subscribe no more."""
        self._subscriber.unregister()

    def _keep(self, carrier: Any) -> None:
        try:
            raw = encode(ros2_message(carrier.raw, self.topic.type_name))
        except MessageError:
            return
        self.put(raw, time.time_ns(), carrier._connection_header.get("callerid", ""))


class Ros1Node(Closing):
    """Publishes to the ROS master that the environment names (`topics.Outlet`), and subscribes there.

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
        self._readers: dict[str, Ros1Reader] = {}
        if not _OPEN:
            rospy.init_node(name, disable_signals=True)
        _OPEN.append(self)

    def reader(self, topic: Topic) -> Ros1Reader:
        """The reader of `topic`, made on first use; a publisher of another type is not connected."""
        if topic.name not in self._readers:
            self._readers[topic.name] = Ros1Reader(self._rospy, topic)
        return self._readers[topic.name]

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

    def readers(self, topic: Topic) -> int:
        """How many listen to a topic that was published before."""
        return int(self._publishers[topic.name].get_num_connections())

    def topics(self) -> dict[str, set[str]]:
        """Topics that are published, our own ones too, with their types (``pkg/Type``)."""
        return {name: {kind} for name, kind in self._rospy.get_published_topics()}

    def close(self) -> None:
        """Leave the master; safe to call twice."""
        if self not in _OPEN:
            return
        _OPEN.remove(self)
        for publisher in self._publishers.values():
            publisher.unregister()
        for reader in self._readers.values():
            reader.close()
        self._publishers, self._readers = {}, {}
        if not _OPEN:
            self._rospy.signal_shutdown("posefuse ends")
