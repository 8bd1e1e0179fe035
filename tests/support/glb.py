"""A binary glTF file, read by the specification alone."""

import json
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np

_TYPES = {5126: np.float32, 5121: np.uint8, 5123: np.uint16}
_WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}


def read_glb(path: Path) -> tuple[dict, Callable[[int], np.ndarray]]:
    """Its content, and what gives the (count, N) values of an accessor by its number."""
    raw = path.read_bytes()
    magic, version, total, size, kind = struct.unpack("<IIIII", raw[:20])
    assert (magic, version, total, kind) == (0x46546C67, 2, len(raw), 0x4E4F534A)
    content, data = json.loads(raw[20 : 20 + size]), raw[28 + size :]

    def values(accessor: int) -> np.ndarray:
        one = content["accessors"][accessor]
        view = content["bufferViews"][one["bufferView"]]
        assert view["byteOffset"] % 4 == 0
        flat = np.frombuffer(data[view["byteOffset"] :][: view["byteLength"]], _TYPES[one["componentType"]])
        return flat.reshape(one["count"], _WIDTHS[one["type"]])

    return content, values
