"""Bytes of messages: those of an independent library, for every type it knows."""

from typing import Any

import numpy as np
import pytest

from posefuse.core import MessageError
from posefuse.messages.cdr import encode
from posefuse.messages.types import message, ros2_types

pytest.importorskip("rosbags", reason="the extra ros is not installed")
_NUMBERS = {"byte": np.int8, "char": np.uint8, "bool": np.bool_}
_TEXTS = ("", "a", "über", "left_shoulder", "four")


def made_up(type_name: str, rng: np.random.Generator) -> Any:
    """A message of random values; lists of zero to four elements, so that everything after them lies anywhere."""
    fields: Any = ros2_types().fielddefs[type_name][1]
    return message(type_name, **{name: _value(desc, rng) for name, desc in fields})


def _value(desc: Any, rng: np.random.Generator) -> Any:
    from rosbags.interfaces import Nodetype

    kind, detail = desc
    if kind == Nodetype.NAME:
        return made_up(detail, rng)
    if kind == Nodetype.BASE:
        return str(rng.choice(_TEXTS)) if detail[0] == "string" else _numbers(detail[0], 1, rng)[0].item()
    of, count = detail[0], detail[1] if kind == Nodetype.ARRAY else int(rng.integers(0, 5))
    if of[0] == Nodetype.NAME or of[1][0] == "string":
        return [_value(of, rng) for _ in range(count)]
    return _numbers(of[1][0], count, rng)


def _numbers(name: str, count: int, rng: np.random.Generator) -> np.ndarray:
    dtype = np.dtype(_NUMBERS.get(name, name))
    return rng.uniform(0, 2, count).astype(dtype) if dtype.kind in "fb" else rng.integers(0, 100, count).astype(dtype)


def reference(msg: Any) -> bytes:
    raw = bytes(ros2_types().serialize_cdr(msg, msg.__msgtype__, little_endian=True))
    return raw + bytes(-len(raw) % 4)


def test_every_type_has_the_bytes_of_another_library() -> None:
    rng = np.random.default_rng(0)
    for type_name in ros2_types().fielddefs:
        for _ in range(5):
            msg = made_up(type_name, rng)
            assert encode(msg) == reference(msg), type_name


@pytest.mark.parametrize(("count", "text"), [(0, "a"), (1, "ab"), (5, "abc")])
def test_messages_of_equal_numbers_may_be_an_array(count: int, text: str) -> None:
    rows = np.random.default_rng(1).normal(size=(count, 4))
    colours = [message("std_msgs/msg/ColorRGBA", r=r, g=g, b=b, a=a) for r, g, b, a in rows.tolist()]
    points = [message("geometry_msgs/msg/Point", x=x, y=y, z=z) for x, y, z in rows[:, :3].tolist()]
    marker = made_up("visualization_msgs/msg/Marker", np.random.default_rng(2))
    marker.ns, marker.points, marker.colors = text, points, colours
    expected = reference(marker)
    marker.points, marker.colors = rows[:, :3], rows
    assert encode(marker) == expected


def test_arrays_that_fit_no_message_are_refused() -> None:
    marker = made_up("visualization_msgs/msg/Marker", np.random.default_rng(2))
    marker.points = np.zeros((2, 4))
    with pytest.raises(MessageError, match="Point"):
        encode(marker)
    with pytest.raises(MessageError, match="shape"):
        encode(message("tf2_msgs/msg/TFMessage", transforms=np.zeros((2, 7))))
    info = made_up("sensor_msgs/msg/CameraInfo", np.random.default_rng(3))
    info.k = np.zeros(8)
    with pytest.raises(MessageError, match="expected 9"):
        encode(info)
    info.k, info.d = np.zeros(9), np.zeros((2, 2))
    with pytest.raises(MessageError, match="list of numbers"):
        encode(info)
