"""CDR bytes of ROS 2 messages: the layout of each type is worked out once, so that a message costs a few calls.

A message is written in steps: numbers that follow one another as one `struct`, texts from a table, arrays as they lie in memory.
Same bytes as those of `rosbags`, which goes through every field of every part (`tests/messages/test_cdr.py`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from operator import attrgetter
from struct import Struct
from typing import Any

import numpy as np

from posefuse.core import MessageError

from .types import optional_module, ros2_types

Step = Callable[[bytearray, Any], None]
# CDR, little endian
_HEADER = b"\0\1\0\0"
_PADDING = tuple(bytes(n) for n in range(8))
_COUNT = Struct("<I").pack
# of each kind of number, for `struct` and for arrays
_FORMATS = {
    "bool": "?", "byte": "b", "char": "B", "int8": "b", "uint8": "B", "int16": "h", "uint16": "H", "int32": "i", "uint32": "I",
    "int64": "q", "uint64": "Q", "float32": "f", "float64": "d",
}  # fmt: skip


@dataclass(frozen=True)
class _Field:
    """A field that is no message: where it is, e.g. ``header.stamp.sec``, and its type as `rosbags` describes it."""

    path: str
    kind: Any
    detail: Any


def encode(msg: Any) -> bytes:
    """CDR bytes (little endian, with encapsulation header) of a ROS 2 message; padded to 4 bytes as DDS wants.

    A list of messages that are made of equal numbers (points, colours) may also be an array (n, numbers of each).

    Raises:
        MessageError: an array whose length differs from its type.
    """
    body = bytearray()
    for step in _steps(msg.__msgtype__):
        step(body, msg)
    return b"".join((_HEADER, body, _PADDING[-len(body) % 4]))


@cache
def _steps(type_name: str) -> tuple[Step, ...]:
    """What writes a message of a type; it may begin anywhere."""
    nodes = optional_module("rosbags.interfaces").Nodetype
    steps: list[Step] = []
    run = _Run()
    for field in _fields(type_name, ""):
        if field.kind == nodes.BASE and field.detail[0] != "string":
            if not run.takes(field):
                steps.append(run.step())
                run = _Run()
            run.add(field)
            continue
        if run.fields:
            steps.append(run.step())
        # after a text or a list nothing is known of where the next one begins
        run = _Run()
        if field.kind == nodes.BASE:
            steps.append(_text_step(field.path))
        else:
            steps.append(_list_step(field, None if field.kind == nodes.SEQUENCE else field.detail[1]))
    return (*steps, run.step()) if run.fields else tuple(steps)


def _fields(type_name: str, prefix: str) -> Iterator[_Field]:
    """Fields in the order of the bytes, those of messages inside in their place."""
    nodes = optional_module("rosbags.interfaces").Nodetype
    fields: Any = ros2_types().fielddefs[type_name][1]
    for name, (kind, detail) in fields:
        if kind == nodes.NAME:
            yield from _fields(detail, f"{prefix}{name}.")
        else:
            yield _Field(f"{prefix}{name}", kind, detail)


class _Run:
    """Consecutive numbers, with padding that aligns each to its size."""

    def __init__(self) -> None:
        self.fields: list[_Field] = []
        self._format, self._size, self._aligned = "<", 0, 1

    def takes(self, field: _Field) -> bool:
        """Whether it is known from where the run begins how to align the field."""
        return not self.fields or _size(field.detail[0]) <= self._aligned

    def add(self, field: _Field) -> None:
        """Append it."""
        size = _size(field.detail[0])
        self._aligned = self._aligned if self.fields else size
        between = -self._size % size
        self._format += f"{between}x{_FORMATS[field.detail[0]]}"
        self._size += between + size
        self.fields.append(field)

    def step(self) -> Step:
        """Writes all of them."""
        pack, aligned, get = Struct(self._format).pack, self._aligned, attrgetter(*(field.path for field in self.fields))
        if len(self.fields) == 1:

            def one(body: bytearray, msg: Any) -> None:
                body += _PADDING[-len(body) % aligned]
                body += pack(get(msg))

            return one

        def several(body: bytearray, msg: Any) -> None:
            body += _PADDING[-len(body) % aligned]
            body += pack(*get(msg))

        return several


def _text_step(path: str) -> Step:
    get = attrgetter(path)

    def step(body: bytearray, msg: Any) -> None:
        body += _PADDING[-len(body) % 4]
        body += _text(get(msg))

    return step


def _list_step(field: _Field, length: int | None) -> Step:
    """A list of `length`, or of any: texts, numbers or messages."""
    nodes = optional_module("rosbags.interfaces").Nodetype
    get, (kind, detail) = attrgetter(field.path), field.detail[0]
    if kind == nodes.NAME:
        write = _writes_messages(detail)
    else:
        write = _write_texts if detail[0] == "string" else _writes_numbers(_FORMATS[detail[0]])

    def step(body: bytearray, msg: Any) -> None:
        values = get(msg)
        if length is None:
            body += _PADDING[-len(body) % 4]
            body += _COUNT(len(values))
        elif len(values) != length:
            raise MessageError(f"{msg.__msgtype__}.{field.path}: expected {length} values, got {len(values)}")
        if len(values):
            write(body, values)

    return step


def _writes_messages(type_name: str) -> Step:
    steps, fields = _steps(type_name), list(_fields(type_name, ""))
    kinds = {field.detail for field in fields}
    equal = _writes_numbers(_FORMATS[fields[0].detail[0]]) if len(kinds) == 1 and fields[0].detail[0] in _FORMATS else None

    def write(body: bytearray, values: Any) -> None:
        if isinstance(values, np.ndarray):
            if equal is None or values.shape[1:] != (len(fields),):
                raise MessageError(f"{type_name}: cannot be made of an array of shape {values.shape}")
            equal(body, values.ravel())
            return
        for value in values:
            for step in steps:
                step(body, value)

    return write


def _writes_numbers(form: str) -> Step:
    dtype = np.dtype(f"<{form}")

    def write(body: bytearray, values: Any) -> None:
        array = np.asarray(values, dtype)
        if array.ndim != 1:
            raise MessageError(f"message: expected a list of numbers, got an array of shape {array.shape}")
        body += _PADDING[-len(body) % dtype.itemsize]
        body += array.tobytes()

    return write


def _write_texts(body: bytearray, values: Sequence[str]) -> None:
    body += _PADDING[-len(body) % 4]
    body += _texts(tuple(values))


@lru_cache(maxsize=256)
def _texts(values: tuple[str, ...]) -> bytes:
    """One after the other; the first begins at a multiple of 4."""
    body = bytearray()
    for value in values:
        body += _PADDING[-len(body) % 4]
        body += _text(value)
    return bytes(body)


@lru_cache(maxsize=1024)
def _text(value: str) -> bytes:
    raw = value.encode()
    return _COUNT(len(raw) + 1) + raw + b"\0"


def _size(number: str) -> int:
    return np.dtype(_FORMATS[number]).itemsize
