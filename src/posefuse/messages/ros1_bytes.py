"""ROS 1 bytes of ROS 2 messages, and back, made by `rosbags`, which knows how Marker, CameraInfo and Header differ."""

from __future__ import annotations

import io
import struct
from functools import cache
from typing import Any

from posefuse.core import MessageError

from .types import ros1_types, ros2_types

# what rosbags keeps of the types it has met, in each direction
_ROS1_DEFAULTS: dict[str, object] = {}
_ROS2_DEFAULTS: dict[str, object] = {}


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
