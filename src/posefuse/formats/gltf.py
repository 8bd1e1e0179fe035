"""glTF 2.0 animation of a skeleton under a skin, in one .glb: a node per joint, and a mesh. Write only.

glTF is metres, Y up, quaternions xyzw; the motion given must already be in these axes.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from posefuse.core import InputError
from posefuse.core.arrays import Array
from posefuse.foundation.output_file import atomic_file

from .bvh import BvhData

_FLOAT, _UINT8, _UINT16, _TRIANGLES = 5126, 5121, 5123, 4
_SKIN_RGBA = [0.72, 0.74, 0.78, 1.0]
_MAGIC, _JSON, _BIN = 0x46546C67, 0x4E4F534A, 0x004E4942


@dataclass(frozen=True, eq=False, kw_only=True)
class Skin:
    """A mesh bound to a skeleton of J joints.

    Attributes:
        vertices: (V, 3) metres, as the mesh was bound. faces: (F, 3), counter-clockwise from outside.
        joint, weight: (V, 4), (V, 4) which joints move each vertex, and how much; rows of weight sum to 1.
        joint_from_mesh: (J, 4, 4) place of the bound mesh in the axes of each joint.
    """

    vertices: Array
    faces: Array
    joint: Array
    weight: Array
    joint_from_mesh: Array


def write_gltf(path: Path | str, data: BvhData, skin: Skin) -> None:
    """Write a .glb of the motion and of the mesh that moves with it.

    Raises:
        InputError: missing values, another ending, or a place that cannot be written to.
    """
    path = Path(path)
    if path.suffix != ".glb":
        raise InputError(f"{path}: expected a file ending in .glb, got {path.suffix or 'no ending'!r}")
    if not all(np.isfinite(one).all() for one in (*data.rotation, *data.position)):
        raise InputError(f"{path}: glTF cannot hold missing values: fill or cut the gaps first")
    buffer = _Buffer()
    time = buffer.add((np.arange(len(data)) * data.frame_s)[:, None], "SCALAR")
    nodes: list[dict[str, Any]] = []
    samplers: list[dict[str, Any]] = []
    channels: list[dict[str, Any]] = []
    for j, name in enumerate(data.names):
        children = [int(c) for c in np.flatnonzero(np.asarray(data.parent) == j)]
        node: dict[str, Any] = {"name": name, "translation": [float(v) for v in data.offset[j]]}
        if children:
            _animate(channels, samplers, j, "rotation", time, buffer.add(smooth_quaternions(data.rotation[j]), "VEC4"))
            node["children"] = children
        if data.parent[j] < 0:
            _animate(channels, samplers, j, "translation", time, buffer.add(data.position[j], "VEC3"))
        nodes.append(node)
    roots = [int(j) for j in np.flatnonzero(np.asarray(data.parent) < 0)]
    body = _skinned(buffer, skin, len(nodes))
    content = {
        "asset": {"version": "2.0", "generator": "posefuse"},
        "scene": 0,
        "scenes": [{"nodes": [*roots, len(nodes)]}],
        "nodes": [*nodes, {"name": "body", "mesh": 0, "skin": 0}],
        "meshes": body.pop("meshes"),
        "animations": [{"name": "motion", "samplers": samplers, "channels": channels}],
        **body,
        **buffer.described(),
    }
    with atomic_file(path) as staged, staged.open("wb") as out:
        out.writelines(_glb(content, buffer.data))


class _Buffer:
    """Float arrays one after the other, each with its view and accessor."""

    def __init__(self) -> None:
        self.data = bytearray()
        self._views: list[dict[str, Any]] = []
        self._accessors: list[dict[str, Any]] = []

    def add(self, values: Array, kind: str, component: int = _FLOAT) -> int:
        """Index of the accessor of (n, components) values; each view begins at a multiple of four bytes."""
        stored = np.ascontiguousarray(values, {_FLOAT: np.float32, _UINT8: np.uint8, _UINT16: np.uint16}[component])
        self.data += b"\0" * (-len(self.data) % 4)
        self._views.append({"buffer": 0, "byteOffset": len(self.data), "byteLength": stored.nbytes})
        self._accessors.append(
            {
                "bufferView": len(self._views) - 1, "componentType": component, "count": len(stored), "type": kind,
                "min": stored.min(axis=0).tolist(), "max": stored.max(axis=0).tolist(),
            }
        )  # fmt: skip
        self.data += stored.tobytes()
        return len(self._accessors) - 1

    def described(self) -> dict[str, Any]:
        return {"buffers": [{"byteLength": len(self.data)}], "bufferViews": self._views, "accessors": self._accessors}


def _skinned(buffer: _Buffer, skin: Skin, joints: int) -> dict[str, Any]:
    """Mesh, skin and material; matrices are stored column by column."""
    primitive = {
        "attributes": {
            "POSITION": buffer.add(skin.vertices, "VEC3"),
            "NORMAL": buffer.add(vertex_normals(skin.vertices, skin.faces), "VEC3"),
            "JOINTS_0": buffer.add(skin.joint, "VEC4", _UINT8),
            "WEIGHTS_0": buffer.add(skin.weight, "VEC4"),
        },
        "indices": buffer.add(skin.faces.reshape(-1, 1), "SCALAR", _UINT16),
        "mode": _TRIANGLES,
        "material": 0,
    }
    matrices = buffer.add(np.swapaxes(skin.joint_from_mesh, -1, -2).reshape(joints, 16), "MAT4")
    surface = {"baseColorFactor": _SKIN_RGBA, "metallicFactor": 0.0, "roughnessFactor": 0.8}
    return {
        "meshes": [{"name": "body", "primitives": [primitive]}],
        "skins": [{"joints": list(range(joints)), "inverseBindMatrices": matrices}],
        "materials": [{"name": "body", "pbrMetallicRoughness": surface}],
    }


def vertex_normals(vertices: Array, faces: Array) -> Array:
    """(V, 3) unit normals of vertices (V, 3), of the faces (F, 3) around each by their area."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    # as long as twice the triangle's area: large triangles count for more
    flat = np.cross(b - a, c - a)
    out = np.zeros_like(vertices)
    for i in range(3):
        np.add.at(out, faces[:, i], flat)
    return np.asarray(out / np.maximum(np.linalg.norm(out, axis=-1, keepdims=True), 1e-12))


def _animate(channels: list[Any], samplers: list[Any], node: int, what: str, time: int, values: int) -> None:
    channels.append({"sampler": len(samplers), "target": {"node": node, "path": what}})
    samplers.append({"input": time, "output": values, "interpolation": "LINEAR"})


def smooth_quaternions(rotation: Array) -> Array:
    """(T, 4) xyzw of rotations (T, 3, 3), neighbours on the same side so that viewers turn the short way."""
    xyzw = Rotation.from_matrix(rotation).as_quat()
    flips = np.cumprod(np.where((xyzw[1:] * xyzw[:-1]).sum(-1) < 0, -1.0, 1.0))
    xyzw[1:] *= flips[:, None]
    return np.asarray(xyzw)


def _glb(content: dict[str, Any], data: bytearray) -> Iterator[bytes | bytearray]:
    text = json.dumps(content, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    data += b"\0" * (-len(data) % 4)
    yield struct.pack("<III", _MAGIC, 2, 28 + len(text) + len(data))
    yield from (struct.pack("<II", len(text), _JSON), text, struct.pack("<II", len(data), _BIN), data)
