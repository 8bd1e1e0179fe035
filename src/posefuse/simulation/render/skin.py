"""A body as MuJoCo skins: one per colour, since a skin has one colour; blended by MuJoCo itself."""

from __future__ import annotations

import struct
from typing import Protocol

import numpy as np

from posefuse.core.arrays import Array
from posefuse.core.se3 import wxyz_from_matrix

_LEAST_WEIGHT = 1e-4
_NAME_BYTES = 40
# how often the cloth pattern repeats per metre
_CLOTH_PER_M = 2.5


class SkinnedBody(Protocol):
    """What rendering needs of a body: a mesh at rest and the bones it is attached to."""

    @property
    def bone_names(self) -> tuple[str, ...]:
        """B names."""
        ...

    @property
    def vertices_rest(self) -> Array:
        """(V, 3) metres."""
        ...

    @property
    def faces(self) -> Array:
        """(F, 3) vertices."""
        ...

    @property
    def bone_index(self) -> Array:
        """(V, W) bones that a vertex is attached to."""
        ...

    @property
    def bone_weight(self) -> Array:
        """(V, W) how much, by bone."""
        ...

    @property
    def world_from_bone_rest(self) -> Array:
        """(B, 4, 4) at rest."""
        ...


def skin_file(body: SkinnedBody, faces: Array, bone_prefix: str) -> bytes:
    """MuJoCo's binary .skn of a part of the mesh (faces (F, 3)), bound to the bodies ``<bone_prefix><bone number>``."""
    used, local = np.unique(faces, return_inverse=True)
    vertices = body.vertices_rest[used]
    index, weight = body.bone_index[used], body.bone_weight[used]
    bones = []
    for bone in range(len(body.bone_names)):
        rows, columns = np.nonzero((index == bone) & (weight > _LEAST_WEIGHT))
        if len(rows):
            bones.append(_bone(f"{bone_prefix}{bone}", body.world_from_bone_rest[bone], rows, weight[rows, columns]))
    header = struct.pack("<4i", len(used), len(used), len(faces), len(bones))
    parts = [vertices.astype("<f4"), _cloth_uv(vertices).astype("<f4"), local.reshape(-1, 3).astype("<i4")]
    return header + b"".join(np.ascontiguousarray(part).tobytes() for part in parts) + b"".join(bones)


def _bone(name: str, rest: Array, rows: Array, weight: Array) -> bytes:
    pose = np.concatenate([rest[:3, 3], wxyz_from_matrix(rest[:3, :3])]).astype("<f4")
    head = name.encode().ljust(_NAME_BYTES, b"\0") + pose.tobytes() + struct.pack("<i", len(rows))
    return head + rows.astype("<i4").tobytes() + weight.astype("<f4").tobytes()


def _cloth_uv(vertices: Array) -> Array:
    """(V, 2) cloth coordinates: around the vertical and along it, without a seam."""
    return np.stack([vertices[:, 0] + vertices[:, 1], vertices[:, 2]], axis=-1) * _CLOTH_PER_M
