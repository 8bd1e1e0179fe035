"""Motions read back: those of OpenSim by column, written or in a file, and BVH files."""

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from posefuse.formats.bvh import BvhData
from posefuse.formats.mot import MotTable


def columns_of(motion: MotTable | Path) -> dict[str, np.ndarray]:
    """Values (T,) by name, and the times under ``time``."""
    if isinstance(motion, MotTable):
        return {"time": motion.t_s, **dict(zip(motion.columns, motion.values.T, strict=True))}
    lines = motion.read_text().splitlines()
    begin = lines.index("endheader") + 1
    return dict(zip(lines[begin].split(), np.loadtxt(lines[begin + 1 :], ndmin=2).T, strict=True))


def read_bvh(path: Path) -> BvhData:
    """A whole file, by the rules of the format: each rotation is about the axes already turned by those before it."""
    hierarchy, motion = (part.split() for part in path.read_text().split("MOTION"))
    count = int(motion[1])
    words, columns = iter(hierarchy), iter(np.array(motion[5:], float).reshape(count, -1).T)
    names, parent, offset, open_joints = [], [], [], []
    rotation, position = [], []
    for word in words:
        if word in ("ROOT", "JOINT", "End"):
            name = next(words)
            names.append(f"{names[open_joints[-1]]}_end" if word == "End" else name)
            parent.append(open_joints[-1] if open_joints else -1)
            open_joints.append(len(names) - 1)
        elif word == "OFFSET":
            offset.append([float(next(words)) for _ in "xyz"])
            position.append(np.tile(offset[-1], (count, 1)))
            rotation.append(Rotation.identity(count))
        elif word == "CHANNELS":
            for channel in [next(words) for _ in range(int(next(words)))]:
                if channel.endswith("position"):
                    position[-1][:, "XYZ".index(channel[0])] = next(columns)
                else:
                    rotation[-1] *= Rotation.from_euler(channel[0], next(columns)[:, None], degrees=True)
        elif word == "}":
            open_joints.pop()
    return BvhData(
        names=tuple(names),
        parent=np.array(parent),
        offset=np.array(offset),
        frame_s=float(motion[4]),
        rotation=[one.as_matrix() for one in rotation],
        position=position,
    )


def world_of(data: BvhData) -> tuple[np.ndarray, np.ndarray]:
    """Rotations world_from_joint (T, J, 3, 3) and positions (T, J, 3)."""
    rotation, position = np.stack(data.rotation, axis=1), np.stack(data.position, axis=1)
    for j, p in enumerate(data.parent):
        if p >= 0:
            position[:, j] = position[:, p] + (rotation[:, p] @ data.position[j][..., None])[..., 0]
            rotation[:, j] = rotation[:, p] @ data.rotation[j]
    return rotation, position
