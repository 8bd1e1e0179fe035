"""BVH: a skeleton with its rest offsets and joint rotations over time (Biovision hierarchy). Everything stays in the file's own
axes and length unit, which the format does not name; angles of the file are degrees."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from posefuse.core import InputError
from posefuse.core.arrays import Array
from posefuse.core.errors import choices
from posefuse.foundation.output_file import write_lines
from posefuse.foundation.parsing import one_line, short

# frames that are written together
_PART_FRAMES = 1000
_CHANNELS = tuple(axis + kind for kind in ("position", "rotation") for axis in "XYZ")


@dataclass(frozen=True, eq=False, kw_only=True)
class BvhData:
    """A motion.

    Attributes:
        names: J joints, a parent always before its children; an end site is called after its joint with ``_end``.
        parent: (J,) index, -1 at the root.
        offset: (J, 3) from the parent joint, in the parent's axes.
        frame_s: time between frames.
        rotation: J of (T, 3, 3) parent_from_joint; identity without rotation channels.
        position: J of (T, 3) joint from the parent, in the parent's axes: the offset, or the position channels where present.
    """

    names: tuple[str, ...]
    parent: Array
    offset: Array
    frame_s: float
    rotation: Sequence[Array]
    position: Sequence[Array]

    def __len__(self) -> int:
        return len(self.rotation[0])

    def rest_positions(self) -> Array:
        """(J, 3) joints with all rotations zero and the root at the origin."""
        out = np.zeros_like(self.offset)
        for j, p in enumerate(self.parent):
            out[j] = out[p] + self.offset[j] if p >= 0 else 0.0
        return out

    def world(self) -> tuple[Array, Array]:
        """Rotations world_from_joint (T, J, 3, 3) and positions (T, J, 3)."""
        rotation, position = np.stack(self.rotation, axis=1), np.stack(self.position, axis=1)
        for j, p in enumerate(self.parent):
            if p >= 0:
                position[:, j] = position[:, p] + (rotation[:, p] @ self.position[j][..., None])[..., 0]
                rotation[:, j] = rotation[:, p] @ self.rotation[j]
        return rotation, position


def read_bvh(path: Path | str) -> BvhData:
    """Read a BVH file; raises InputError naming file, line, what was expected and what is there."""
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read as text ({error})") from None
    tokens = _Tokens(path, text)
    tokens.expect("HIERARCHY")
    joints = _Joints()
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
    rows = _rows(tokens, path, frames, sum(len(c) for c in joints.channels))
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


class _Joints:
    def __init__(self) -> None:
        self.names: list[str] = []
        self.parents: list[int] = []
        self.offsets: list[list[float]] = []
        self.channels: list[list[str]] = []


def _joint(tokens: _Tokens, joints: _Joints, name: str, parent: int) -> None:
    """Read one joint's block and its children's; `name` has been read."""
    if name in joints.names:
        raise InputError(f"{tokens.path}: joint {short(name)} appears twice in the hierarchy")
    here = len(joints.names)
    tokens.expect("{")
    tokens.expect("OFFSET")
    joints.names.append(name)
    joints.parents.append(parent)
    joints.offsets.append([tokens.number(f"3 numbers after OFFSET of {name}") for _ in range(3)])
    joints.channels.append([])
    while (word := tokens.word(f"CHANNELS, JOINT, End or '}}' of joint {name}")) != "}":
        if word == "CHANNELS":
            joints.channels[here] = _channels(tokens, name)
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


def _data(joints: _Joints, frame_s: float, rows: Array) -> BvhData:
    offset = np.array(joints.offsets)
    position = [np.tile(one, (len(rows), 1)) for one in offset]
    rotation = [np.tile(np.eye(3), (len(rows), 1, 1)) for _ in offset]
    column = 0
    for j, channels in enumerate(joints.channels):
        for channel in channels:
            value, axis = rows[:, column], channel[0]
            if channel.endswith("position"):
                position[j][:, "XYZ".index(axis)] = value
            else:
                turns = Rotation.from_rotvec(np.deg2rad(value)[:, None] * np.eye(3)["XYZ".index(axis)])
                rotation[j] = rotation[j] @ turns.as_matrix()
            column += 1
    return BvhData(
        names=tuple(joints.names),
        parent=np.array(joints.parents),
        offset=offset,
        frame_s=frame_s,
        rotation=rotation,
        position=position,
    )


def write_bvh(path: Path | str, data: BvhData, metres_per_unit: float = 1.0) -> None:
    """Write a BVH file that Blender opens: the root with position and rotation channels, other joints with rotations.

    Rotations are written as Z, X, Y, each about the axes already turned. A joint without children is an end site.

    Args:
        metres_per_unit: length unit of the file, e.g. 0.01 for centimetres, of a motion in metres.

    Raises:
        InputError: a joint other than the root moves against its parent, a value is missing, or the place cannot be written to.
    """
    path = Path(path)
    children: dict[int, list[int]] = {j: [] for j in range(-1, len(data.names))}
    for j, p in enumerate(data.parent):
        children[int(p)].append(j)
    _check_writable(path, data, children[-1])
    order: list[int] = []
    scaled = replace(data, offset=data.offset / metres_per_unit)
    lines = ["HIERARCHY", *_block(scaled, children, children[-1][0], 0, order)]
    lines += ["MOTION", f"Frames: {len(data)}", f"Frame Time: {data.frame_s:.8f}"]
    write_lines(path, itertools.chain(lines, _motion_lines(data, order, metres_per_unit)))


def _motion_lines(data: BvhData, order: list[int], metres_per_unit: float) -> Iterator[str]:
    for start in range(0, len(data), _PART_FRAMES):
        part = slice(start, start + _PART_FRAMES)
        turns = [Rotation.from_matrix(data.rotation[j][part]).as_euler("ZXY", degrees=True) for j in order]
        for row in np.concatenate([data.position[order[0]][part] / metres_per_unit, *turns], axis=1):
            yield " ".join(f"{number:.6f}" for number in row)


def _check_writable(path: Path, data: BvhData, roots: list[int]) -> None:
    if len(roots) != 1:
        raise InputError(f"{path}: BVH: expected one root, got {len(roots)}")
    if not all(np.isfinite(one).all() for one in (*data.rotation, *data.position)):
        raise InputError(f"{path}: BVH cannot hold missing values: fill or cut the gaps first")
    moving = [
        name for j, name in enumerate(data.names) if j != roots[0] and np.ptp(data.position[j], axis=0).max(initial=0) > 1e-6
    ]
    if moving:
        raise InputError(f"{path}: BVH: joints must keep their offset; these move: {choices(moving)}")


def _block(data: BvhData, children: dict[int, list[int]], j: int, depth: int, order: list[int]) -> list[str]:
    """Lines of a joint and those below it; joints with channels are added to `order`."""
    pad = "\t" * depth
    offset = " ".join(f"{number:.6f}" for number in data.offset[j])
    if not children[j]:
        return [f"{pad}End Site", f"{pad}{{", f"{pad}\tOFFSET {offset}", f"{pad}}}"]
    order.append(j)
    kind, channels = ("ROOT", "6 Xposition Yposition Zposition") if depth == 0 else ("JOINT", "3")
    lines = [f"{pad}{kind} {data.names[j]}", f"{pad}{{", f"{pad}\tOFFSET {offset}"]
    lines.append(f"{pad}\tCHANNELS {channels} Zrotation Xrotation Yrotation")
    for child in children[j]:
        lines += _block(data, children, child, depth + 1, order)
    return [*lines, f"{pad}}}"]
