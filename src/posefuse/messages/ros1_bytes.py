"""ROS 1 bytes of ROS 2 messages, and back, made by `rosbags`; field by field, as Marker, CameraInfo and Header differ."""

from __future__ import annotations

import io
import struct
from functools import cache
from typing import Any

import numpy as np

from posefuse.core import MessageError

from .types import message, ros1_types


def ros1_bytes(msg: Any) -> bytes:
    """ROS 1 serialisation of a ROS 2 message made by `types.message`."""
    return bytes(ros1_types().serialize_ros1(_converted(msg, msg.__msgtype__), msg.__msgtype__))


def ros2_message(raw: bytes, type_name: str) -> Any:
    """The message in ROS 1 bytes as `types.message` makes it; raises MessageError when malformed.

    Only of types whose ROS 2 form has no more fields.
    """
    from rosbags.serde import SerdeError

    try:
        return _converted_back(ros1_types().deserialize_ros1(raw, type_name), type_name)
    except (SerdeError, AssertionError, IndexError, ValueError, OverflowError, MemoryError, struct.error) as error:
        raise MessageError(f"{type_name}: malformed ROS 1 message ({error})") from None


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
            value = _converted_list(value, inner) if isinstance(value, (list, np.ndarray)) else _converted(value, inner)
        values[name] = value
    return store.types[type_name](**values)


def _converted_list(values: Any, inner: str) -> list[Any]:
    """Of messages, or of the rows of an array, see `cdr.encode`."""
    if isinstance(values, np.ndarray):
        kind = ros1_types().types[inner]
        return [kind(*row) for row in values.tolist()]
    return [_converted(value, inner) for value in values]


def _converted_back(msg: Any, type_name: str) -> Any:
    """A ROS 1 message as a ROS 2 one."""
    values = {}
    for name, target, inner in _fields(type_name):
        if name == "seq" and type_name == "std_msgs/msg/Header":
            continue
        value = getattr(msg, name)
        if inner is not None:
            value = [_converted_back(v, inner) for v in value] if isinstance(value, list) else _converted_back(value, inner)
        values[target] = value
    return message(type_name, **values)


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
