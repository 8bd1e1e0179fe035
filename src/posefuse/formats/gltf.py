"""glTF 2.0 animation of a skeleton, in one .glb: a node per joint, its bones drawn as lines. Write only.

glTF is metres, Y up, quaternions xyzw; the motion given must already be in these axes.
"""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from posefuse.core import InputError
from posefuse.core.arrays import Array
from posefuse.foundation.atomic import atomic_file

from .bvh import BvhData

_FLOAT, _LINES = 5126, 1
_MAGIC, _JSON, _BIN = 0x46546C67, 0x4E4F534A, 0x004E4942


def write_gltf(path: Path | str, data: BvhData, metres_per_unit: float = 1.0) -> None:
    """Write a .glb of the motion; raises InputError for missing values, another ending, or a place that cannot be written to."""
    path = Path(path)
    if path.suffix != ".glb":
        raise InputError(f"{path}: expected a file ending in .glb, got {path.suffix or 'no ending'!r}")
    if not (np.isfinite(data.rotation).all() and np.isfinite(data.position).all()):
        raise InputError(f"{path}: glTF cannot hold missing values: fill or cut the gaps first")
    buffer = _Buffer()
    time = buffer.add((np.arange(len(data)) * data.frame_s)[:, None], "SCALAR")
    offset, position = data.offset * metres_per_unit, data.position * metres_per_unit
    nodes: list[dict[str, Any]] = []
    meshes: list[dict[str, Any]] = []
    samplers: list[dict[str, Any]] = []
    channels: list[dict[str, Any]] = []
    for j, name in enumerate(data.names):
        children = [int(c) for c in np.flatnonzero(np.asarray(data.parent) == j)]
        node: dict[str, Any] = {"name": name, "translation": [float(v) for v in offset[j]]}
        if children:
            lines = np.stack([np.zeros((len(children), 3)), offset[children]], axis=1).reshape(-1, 3)
            primitive = {"attributes": {"POSITION": buffer.add(lines, "VEC3")}, "mode": _LINES}
            node |= {"children": children, "mesh": len(meshes)}
            meshes.append({"name": name, "primitives": [primitive]})
            _animate(channels, samplers, j, "rotation", time, buffer.add(_quaternions(data.rotation[:, j]), "VEC4"))
        if data.parent[j] < 0:
            _animate(channels, samplers, j, "translation", time, buffer.add(position[:, j], "VEC3"))
        nodes.append(node)
    content = {
        "asset": {"version": "2.0", "generator": "posefuse"},
        "scene": 0,
        "scenes": [{"nodes": [int(j) for j in np.flatnonzero(np.asarray(data.parent) < 0)]}],
        "nodes": nodes,
        "meshes": meshes,
        "animations": [{"name": "motion", "samplers": samplers, "channels": channels}],
        **buffer.described(),
    }
    with atomic_file(path) as staged:
        staged.write_bytes(_glb(content, bytes(buffer.data)))


class _Buffer:
    """Float arrays one after the other, each with its view and accessor."""

    def __init__(self) -> None:
        self.data = bytearray()
        self._views: list[dict[str, Any]] = []
        self._accessors: list[dict[str, Any]] = []

    def add(self, values: Array, kind: str) -> int:
        """Index of the accessor of (n, components) values."""
        stored = np.ascontiguousarray(values, np.float32)
        self._views.append({"buffer": 0, "byteOffset": len(self.data), "byteLength": stored.nbytes})
        self._accessors.append(
            {
                "bufferView": len(self._views) - 1, "componentType": _FLOAT, "count": len(stored), "type": kind,
                "min": stored.min(axis=0).tolist(), "max": stored.max(axis=0).tolist(),
            }
        )  # fmt: skip
        self.data += stored.tobytes()
        return len(self._accessors) - 1

    def described(self) -> dict[str, Any]:
        return {"buffers": [{"byteLength": len(self.data)}], "bufferViews": self._views, "accessors": self._accessors}


def _animate(channels: list[Any], samplers: list[Any], node: int, what: str, time: int, values: int) -> None:
    channels.append({"sampler": len(samplers), "target": {"node": node, "path": what}})
    samplers.append({"input": time, "output": values, "interpolation": "LINEAR"})


def _quaternions(rotation: Array) -> Array:
    """(T, 4) xyzw, neighbours on the same side so that viewers turn the short way."""
    xyzw = Rotation.from_matrix(rotation).as_quat()
    flips = np.cumprod(np.where((xyzw[1:] * xyzw[:-1]).sum(-1) < 0, -1.0, 1.0))
    xyzw[1:] *= flips[:, None]
    return np.asarray(xyzw)


def _glb(content: dict[str, Any], data: bytes) -> bytes:
    text = json.dumps(content, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    data += b"\0" * (-len(data) % 4)
    chunks = struct.pack("<II", len(text), _JSON) + text + struct.pack("<II", len(data), _BIN) + data
    return struct.pack("<III", _MAGIC, 2, 12 + len(chunks)) + chunks
