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

# frames that are written together
_PART_FRAMES = 1000


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
