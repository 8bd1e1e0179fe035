"""BVH files of recorded motion, read; `posefuse.formats.bvh` writes them and has the axes and units."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from posefuse.core import InputError
from posefuse.core.arrays import Array
from posefuse.core.errors import choices
from posefuse.formats.bvh import BvhData
from posefuse.foundation.parsing import one_line, read_text, short

_CHANNELS = tuple(axis + kind for kind in ("position", "rotation") for axis in "XYZ")


def read_bvh(path: Path | str) -> BvhData:
    """Read a BVH file; raises InputError naming file, line, what was expected and what is there."""
    path = Path(path)
    tokens = _Tokens(path, read_text(path))
    tokens.expect("HIERARCHY")
    joints: list[_Joint] = []
    tokens.expect("ROOT")
    _joint(tokens, joints, tokens.word("a root name"), -1)
    tokens.expect("MOTION")
    tokens.expect("Frames:")
    frames = int(tokens.number("a number of frames"))
    tokens.expect("Frame")
    tokens.expect("Time:")
    frame_s = tokens.number("a frame time in seconds")
    if frames < 1 or not frame_s > 0:
        raise InputError(f"{path}: expected at least 1 frame and a frame time > 0 s, got {frames} frames of {frame_s} s")
    rows = _rows(tokens, path, frames, sum(len(joint.channels) for joint in joints))
    return _data(joints, frame_s, rows)


class _Tokens:
    """Words of the file with their line numbers."""

    def __init__(self, path: Path, text: str) -> None:
        self.path = path
        self._words: Iterator[tuple[int, str]] = (
            (number, word) for number, line in enumerate(text.splitlines(), 1) for word in line.split()
        )
        self._line = 1

    def word(self, expected: str) -> str:
        try:
            self._line, word = next(self._words)
        except StopIteration:
            raise InputError(f"{self.path}: line {self._line}: expected {expected}, got the end of the file") from None
        return word

    def expect(self, wanted: str) -> None:
        got = self.word(repr(wanted))
        if got != wanted:
            self.fail(repr(wanted), got)

    def number(self, expected: str) -> float:
        word = self.word(expected)
        try:
            value = float(word)
        except ValueError:
            self.fail(expected, word)
        if not np.isfinite(value):
            self.fail(expected, word)
        return value

    def rest(self) -> list[str]:
        return [word for _, word in self._words]

    def fail(self, expected: str, got: str) -> None:
        raise InputError(f"{self.path}: line {self._line}: expected {expected}, got {short(got)}")


@dataclass
class _Joint:
    name: str
    parent: int
    offset: list[float]
    channels: Sequence[str] = ()


def _joint(tokens: _Tokens, joints: list[_Joint], name: str, parent: int) -> None:
    """Read one joint's block and its children's; `name` has been read."""
    if any(joint.name == name for joint in joints):
        raise InputError(f"{tokens.path}: joint {short(name)} appears twice in the hierarchy")
    here = len(joints)
    tokens.expect("{")
    tokens.expect("OFFSET")
    joints.append(_Joint(name, parent, [tokens.number(f"3 numbers after OFFSET of {name}") for _ in range(3)]))
    while (word := tokens.word(f"CHANNELS, JOINT, End or '}}' of joint {name}")) != "}":
        if word == "CHANNELS":
            joints[here].channels = _channels(tokens, name)
        elif word == "JOINT":
            _joint(tokens, joints, tokens.word("a joint name"), here)
        elif word == "End":
            tokens.expect("Site")
            _joint(tokens, joints, f"{name}_end", here)
        else:
            tokens.fail(f"CHANNELS, JOINT, End or '}}' of joint {name}", word)


def _channels(tokens: _Tokens, name: str) -> list[str]:
    count = int(tokens.number(f"a number of channels of {name}"))
    channels = [tokens.word(f"{count} channel names of {name}") for _ in range(count)]
    for channel in channels:
        if channel not in _CHANNELS:
            tokens.fail(f"a channel of {name} out of {choices(_CHANNELS)}", channel)
    return channels


def _rows(tokens: _Tokens, path: Path, frames: int, channels: int) -> Array:
    words = tokens.rest()
    if len(words) != frames * channels:
        raise InputError(
            f"{path}: MOTION: expected {frames} frames of {channels} numbers = {frames * channels}, got {len(words)} numbers"
        )
    try:
        rows = np.array(words, dtype=np.float64).reshape(frames, channels)
    except ValueError as error:
        raise InputError(f"{path}: MOTION: expected numbers only ({one_line(error)})") from None
    if not np.isfinite(rows).all():
        raise InputError(
            f"{path}: MOTION: expected finite numbers, got NaN or infinity in frame {np.argwhere(~np.isfinite(rows))[0][0]}"
        )
    return rows


def _data(joints: list[_Joint], frame_s: float, rows: Array) -> BvhData:
    offset = np.array([joint.offset for joint in joints])
    position = [np.tile(one, (len(rows), 1)) for one in offset]
    rotation = [np.tile(np.eye(3), (len(rows), 1, 1)) for _ in offset]
    column = 0
    for j, joint in enumerate(joints):
        for channel in joint.channels:
            value, axis = rows[:, column], channel[0]
            if channel.endswith("position"):
                position[j][:, "XYZ".index(axis)] = value
            else:
                turns = Rotation.from_rotvec(np.deg2rad(value)[:, None] * np.eye(3)["XYZ".index(axis)])
                rotation[j] = rotation[j] @ turns.as_matrix()
            column += 1
    return BvhData(
        names=tuple(joint.name for joint in joints),
        parent=np.array([joint.parent for joint in joints]),
        offset=offset,
        frame_s=frame_s,
        rotation=rotation,
        position=position,
    )
