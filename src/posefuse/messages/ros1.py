"""ROS 1: the same messages to a `roscore`, or to a .bag file without any ROS.

Needs Debian's `python3-rospy` in an environment that sees system packages (``python3 -m venv --system-site-packages``).
Bytes come from `rosbags`; rospy only carries them. Types whose ROS 1 form differs (Marker, CameraInfo, Header) are
taken over field by field.
"""

from __future__ import annotations

import io
from functools import cache
from pathlib import Path
from types import TracebackType
from typing import Any

from posefuse.core import DependencyError, InputError, SourceError

from .topics import Topic
from .types import optional_module, ros1_types


def ros1_bytes(msg: Any) -> bytes:
    """ROS 1 serialisation of a ROS 2 message made by `types.message`."""
    return bytes(ros1_types().serialize_ros1(_converted(msg, msg.__msgtype__), msg.__msgtype__))


class Ros1Node:
    """Publishes to the ROS master that the environment names (`topics.Outlet`). One per process, as rospy wants it.

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
        rospy.init_node(name, disable_signals=True)

    def publish(self, topic: Topic, msg: Any, t_ns: int) -> None:
        """Send one message; latched topics keep the last one for who comes late."""
        self._publisher(topic).publish(_carrier(topic.type_name)(ros1_bytes(msg)))

    def wanted(self, topic: Topic) -> bool:
        """Whether any person listens, or will be given the last message on coming."""
        return self._publisher(topic).get_num_connections() > 0 or topic.latched

    def forget(self, name: str) -> None:
        """Withdraw a topic from the master."""
        publisher = self._publishers.pop(name, None)
        if publisher is not None:
            publisher.unregister()

    def _publisher(self, topic: Topic) -> Any:
        if topic.name not in self._publishers:
            made = _carrier(topic.type_name)
            self._publishers[topic.name] = self._rospy.Publisher(topic.name, made, queue_size=topic.depth, latch=topic.latched)
        return self._publishers[topic.name]

    def readers(self, topic: Topic) -> int:
        """How many listen to a topic that was published before."""
        return int(self._publishers[topic.name].get_num_connections())

    def close(self) -> None:
        """Leave the master; safe to call twice."""
        self._rospy.signal_shutdown("posefuse ends")

    def __enter__(self) -> Ros1Node:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()


class BagRecorder:
    """Writes a ROS 1 .bag file (`topics.Outlet`); needs no ROS.

    Raises:
        InputError: the file cannot be made, or already exists.
    """

    def __init__(self, path: Path) -> None:
        rosbag1 = optional_module("rosbags.rosbag1")
        if path.exists():
            raise InputError(f"{path} already exists; choose another name or move it away")
        self._writer = rosbag1.Writer(path)
        self._connections: dict[str, Any] = {}
        try:
            self._writer.open()
        except (OSError, rosbag1.WriterError) as error:
            raise InputError(f"{path}: cannot be written ({error})") from None
        self._open = True

    def publish(self, topic: Topic, msg: Any, t_ns: int) -> None:
        """Record one message of the time step `t_ns`."""
        if topic.name not in self._connections:
            self._connections[topic.name] = self._writer.add_connection(
                topic.name, topic.type_name, typestore=ros1_types(), callerid="/posefuse", latching=int(topic.latched)
            )
        self._writer.write(self._connections[topic.name], t_ns, ros1_bytes(msg))

    def wanted(self, topic: Topic) -> bool:
        """A file takes everything."""
        return True

    def forget(self, name: str) -> None:
        """Nothing to do: a file keeps its connections."""

    def close(self) -> None:
        """Finish the file; safe to call twice."""
        if self._open:
            self._open = False
            self._writer.close()

    def __enter__(self) -> BagRecorder:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()


@cache
def _fields(type_name: str) -> tuple[tuple[str, str, str | None], ...]:
    """ROS 1 field, the ROS 2 field it comes from, and the type of the messages inside (None: plain values)."""
    from rosbags.interfaces import Nodetype

    found = []
    fields: Any = ros1_types().fielddefs[type_name][1]  # nested pairs, whose second part depends on the first
    for name, (kind, detail) in fields:
        while kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            kind, detail = detail[0]
        # CameraInfo: D, K, R, P in ROS 1, d, k, r, p in ROS 2
        found.append((name, name.lower(), detail if kind == Nodetype.NAME else None))
    return tuple(found)


def _converted(msg: Any, type_name: str) -> Any:
    store = ros1_types()
    values = {}
    for name, source, inner in _fields(type_name):
        if name == "seq" and type_name == "std_msgs/msg/Header":
            values[name] = 0
            continue
        value = getattr(msg, source)
        if inner is not None:
            value = [_converted(v, inner) for v in value] if isinstance(value, list) else _converted(value, inner)
        values[name] = value
    return store.types[type_name](**values)


@cache
def _carrier(type_name: str) -> Any:
    """A rospy message class that carries ready-made bytes under the real type's name, checksum and definition."""
    import genpy

    text, checksum = ros1_types().generate_msgdef(type_name, ros_version=1)

    class Carrier(genpy.Message):  # type: ignore[misc]
        _type = type_name.replace("/msg/", "/")
        _md5sum = checksum
        _full_text = text
        _has_header = False
        __slots__ = ("raw",)
        _slot_types = ("uint8[]",)

        def __init__(self, raw: bytes) -> None:
            self.raw = raw

        def serialize(self, buff: io.BytesIO) -> None:
            buff.write(self.raw)

    return Carrier
