"""The bytes of a C3D file: header, parameters, 3D points. Every count and offset is checked against the file's size first.

Files in the order of Intel processors, with integer or floating-point points. Analog samples are skipped.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

import numpy as np

from posefuse.core import InputError
from posefuse.core.arrays import Array
from posefuse.foundation.parsing import read_bytes

BLOCK_BYTES = 512
# of a floating-point point
POINT_BYTES = 16
# places in the header
_LAST_FRAME, _SCALE, _DATA_BLOCK = 8, 12, 16
_KEY = 0x50
# in an order of their own; writers that state none of these mean Intel's
_OTHER_PROCESSORS = {85: "DEC", 86: "MIPS"}
_TYPES = {-1: "text", 1: "i1", 2: "i2", 4: "f4"}
_MOST_DIMENSIONS = 7
_NUMBER_BYTES = {True: 4, False: 2}
# integer points fill 4 words of 2 bytes, floating-point points 4 of 4: x, y, z, residual with the cameras
_WORDS_PER_POINT = 4
_BYTE = 256
# the header's 16 bits are full: the number of frames is in a parameter
LAST_IN_HEADER = 65535

Group = dict[str, list[Any]]


@dataclass(frozen=True, eq=False)
class C3dBlocks:
    """What is in the file, as it is there.

    Attributes:
        parameters: group name -> parameter name -> values, names in capitals; texts without the blanks at their end.
        xyz: (T, N, 3) in the file's units and axes. residual: (T, N) in the same units; -1 where a point is missing.
        first_frame: number of the first one in what was recorded, from 1 on.
    """

    parameters: Mapping[str, Group]
    xyz: Array
    residual: Array
    first_frame: int


class _Header(NamedTuple):
    points: int
    analog: int
    first: int
    last: int
    data_block: int
    scale: float


def read_blocks(path: Path) -> C3dBlocks:
    """Parse the file: the residual is the low byte of a point's fourth word, the cameras that saw it the high byte.

    Raises:
        InputError: it cannot be read, is not C3D, or states something that its size rules out.
    """
    content = read_bytes(path)
    if len(content) < 2 * BLOCK_BYTES or content[1] != _KEY:
        raise InputError(f"{path}: cannot be read as C3D: expected a header of 512 bytes whose second byte is 80, and parameters")
    numbers = _Numbers(path, content)
    header = _header(numbers)
    parameters = _Parameters(numbers).groups()
    frames = _frame_count(path, header, parameters)
    xyz, residual = _points(numbers, header, frames, _scale(header, parameters))
    return C3dBlocks(parameters, xyz, residual, max(header.first, 1))


def data_start(content: bytes) -> int:
    """Where the points begin."""
    return (int.from_bytes(content[_DATA_BLOCK : _DATA_BLOCK + 2], "little") - 1) * BLOCK_BYTES


def completed_head(path: Path, head: bytes, frames: int, data_bytes: int) -> bytes:
    """Header and parameters, as ezc3d writes them of any recording, of one with so many frames and bytes of points.

    The header's scale becomes that of the parameters: ezc3d writes -1, and some readers refuse a file with two of them.
    """
    places = _Parameters(_Numbers(path, head)).places()
    blocks = len(head) // BLOCK_BYTES + data_bytes // BLOCK_BYTES + 2
    changed, scale = bytearray(head), places["POINT", "SCALE"]
    changed[_SCALE : _SCALE + 4] = head[scale : scale + 4]
    for place, number in (
        (_LAST_FRAME, min(frames, LAST_IN_HEADER)),
        (places["POINT", "FRAMES"], min(frames, LAST_IN_HEADER)),
        (places["ROTATION", "DATA_START"], blocks % (LAST_IN_HEADER + 1)),
    ):
        changed[place : place + 2] = number.to_bytes(2, "little")
    return bytes(changed)


class _Numbers:
    """Numbers at places of the file; a place outside the file is an InputError."""

    def __init__(self, path: Path, content: bytes) -> None:
        self.path, self._content = path, content
        self.parameter_start = (content[0] - 1) * BLOCK_BYTES
        if not 0 < self.parameter_start <= len(content) - BLOCK_BYTES:
            self.fail(f"parameters begin in block {content[0]} of {len(content) // BLOCK_BYTES}")
        other = _OTHER_PROCESSORS.get(content[self.parameter_start + 3])
        if other:
            self.fail(f"numbers of a {other} processor: expected those of Intel's; write it again with Mokka, Visual3D or ezc3d")

    def __len__(self) -> int:
        return len(self._content)

    def fail(self, problem: str) -> NoReturn:
        raise InputError(f"{self.path}: cannot be read as C3D: {problem}")

    def take(self, place: int, size: int, what: str) -> bytes:
        if size < 0 or place < 0 or place + size > len(self._content):
            self.fail(f"{what}: expected {size} bytes at {place}, the file has {len(self._content)}")
        return self._content[place : place + size]

    def array(self, place: int, count: int, kind: str, what: str) -> Array:
        """`count` numbers of kind i1, u2, i2 or f4 as float64 or int64."""
        raw = self.take(place, count * int(kind[1]), what)
        with np.errstate(invalid="ignore"):  # a signalling NaN in damaged bytes becomes a quiet one
            return np.frombuffer(raw, f"<{kind}").astype(np.float64 if kind == "f4" else np.int64)

    def one(self, place: int, kind: str, what: str) -> Any:
        return self.array(place, 1, kind, what)[0].item()


def _header(numbers: _Numbers) -> _Header:
    words = numbers.array(0, 12, "u2", "header")
    points, analog, first, last, data_block = words[[1, 2, 3, 4, 8]].tolist()
    header = _Header(points, analog, first, last, data_block, numbers.one(_SCALE, "f4", "header"))
    if not np.isfinite(header.scale) or header.scale == 0:
        numbers.fail(f"header: expected a scale other than 0, got {header.scale}")
    if not 1 < header.data_block <= len(numbers) // BLOCK_BYTES + 1:
        numbers.fail(f"header: data begin in block {header.data_block} of {len(numbers) // BLOCK_BYTES}")
    return header


class _Parameters:
    """The chain of groups and parameters, each with the distance to the next."""

    def __init__(self, numbers: _Numbers) -> None:
        self._numbers = numbers
        self._names: dict[int, str] = {}
        self._found: list[tuple[int, str, list[Any]]] = []
        self._places: dict[tuple[int, str], int] = {}
        place = numbers.parameter_start + 4
        while place:
            place = self._entry(place)

    def places(self) -> dict[tuple[str, str], int]:
        """Where the only number of a parameter is, by group and name."""
        return {(self._names[number], name): place for (number, name), place in self._places.items()}

    def groups(self) -> dict[str, Group]:
        groups: dict[str, Group] = {name: {} for name in self._names.values()}
        for number, name, values in self._found:
            if number in self._names:
                groups[self._names[number]][name] = values
        return groups

    def _entry(self, place: int) -> int:
        """Read the entry at `place`; the place of the next one, or 0 after the last."""
        length = abs(self._numbers.one(place, "i1", "parameters"))
        if not length:
            return 0
        number = self._numbers.one(place + 1, "i1", "parameters")
        name = self._text(place + 2, length).upper()
        link = place + 2 + length
        step = self._numbers.one(link, "i2", f"parameter {name}")
        if number < 0:
            self._names[-number] = name
        elif number:
            self._found.append((number, name, self._values(link + 2, name)))
            self._places[number, name] = link + 4 + self._numbers.one(link + 3, "i1", f"parameter {name}")
        if step and step < 2:
            self._numbers.fail(f"parameter {name}: expected the next one after it, got a step of {step} bytes")
        return link + step if step else 0

    def _values(self, place: int, name: str) -> list[Any]:
        what = f"parameter {name}"
        kind = _TYPES.get(self._numbers.one(place, "i1", what))
        dimensions = self._numbers.one(place + 1, "i1", what)
        if kind is None or not 0 <= dimensions <= _MOST_DIMENSIONS:
            self._numbers.fail(f"{what}: unknown type or {dimensions} dimensions")
        sizes = list(self._numbers.take(place + 2, dimensions, what))
        start = place + 2 + dimensions
        if kind != "text":
            return list(self._numbers.array(start, int(np.prod(sizes, dtype=object)), kind, what).tolist())
        length, count = (sizes or [1])[0], int(np.prod(sizes[1:], dtype=object))
        self._numbers.take(start, length * count, what)
        return [self._text(start + i * length, length) for i in range(count)]

    def _text(self, place: int, length: int) -> str:
        return self._numbers.take(place, length, "text").decode("utf-8", errors="replace").rstrip(" \0")


def _frame_count(path: Path, header: _Header, parameters: Mapping[str, Group]) -> int:
    """Frames by the header, whose 16 bits long recordings leave to parameters; a sign bit there is part of the number."""
    trial, point = parameters.get("TRIAL", {}), parameters.get("POINT", {})
    counts = [header.last - header.first + 1]
    if {"ACTUAL_START_FIELD", "ACTUAL_END_FIELD"} <= set(trial):
        first, last = (_long(trial[key]) for key in ("ACTUAL_START_FIELD", "ACTUAL_END_FIELD"))
        counts.append(last - first + 1)
    for name in ("LONG_FRAMES", "FRAMES"):
        if point.get(name):
            counts.append(int(point[name][0]) if np.isfinite(point[name][0]) else 0)
    if header.last < LAST_IN_HEADER:
        counts = counts[:1]
    count = max(counts)
    if count < 1:
        raise InputError(f"{path}: cannot be read as C3D: frames {header.first} to {header.last}: expected at least one")
    return count


def _long(words: list[Any]) -> int:
    low, high = ([int(word) % 65536 for word in words] + [0, 0])[:2]
    return low + 65536 * high


def _scale(header: _Header, parameters: Mapping[str, Group]) -> float:
    """The parameter's, which writers keep more exactly than the header's; negative: points are floating point."""
    stated = parameters.get("POINT", {}).get("SCALE", [])
    usable = stated and not isinstance(stated[0], str) and np.isfinite(stated[0]) and stated[0] * header.scale > 0
    return float(stated[0]) if usable else header.scale


def _points(numbers: _Numbers, header: _Header, frames: int, scale: float) -> tuple[Array, Array]:
    floating = scale < 0
    words = _WORDS_PER_POINT * header.points + header.analog
    start = (header.data_block - 1) * BLOCK_BYTES
    size = frames * words * _NUMBER_BYTES[floating]
    if start + size > len(numbers):
        numbers.fail(
            f"{frames} frames of {header.points} points and {header.analog} analog values need {start + size} bytes, "
            f"the file has {len(numbers)}"
        )
    frame_words = numbers.array(start, frames * words, "f4" if floating else "i2", "points").reshape(frames, words)
    table = frame_words[:, : _WORDS_PER_POINT * header.points].reshape(frames, header.points, _WORDS_PER_POINT)
    step = abs(scale)
    with np.errstate(all="ignore"):
        xyz = table[..., :3].astype(np.float64) * (1.0 if floating else step)
        last = np.nan_to_num(np.round(table[..., 3].astype(np.float64)), nan=-1.0, posinf=-1.0, neginf=-1.0)
        residual = np.where(last < 0, -1.0, np.mod(last, _BYTE) * step)
    return xyz, residual
