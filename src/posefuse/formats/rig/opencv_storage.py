"""OpenCV FileStorage (YAML or JSON): one file per camera in a folder, or one file of several cameras.

``x_cam = R x_world + t``, metres. Keys as OpenCV's calibration sample writes them; the names others use are read too.
A file of several cameras is a mapping of camera name to such keys. Fisheye is the sample's ``fisheye_model: 1``.
Keys of posefuse: ``name``, ``readout_s``.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from posefuse.core import Camera, Rig

from . import parts

HOLDS = "OpenCV FileStorage *.yaml, *.yml, *.json (one file, or a folder of one file per camera)"
_MATRIX = ("camera_matrix", "K", "cameraMatrix", "intrinsic_matrix", "mtx", "matrix")
_DISTORTION = ("distortion_coefficients", "dist_coeffs", "distCoeffs", "D", "dist", "distortions")
_ROTATION = ("R", "rvec", "rotation_matrix", "rotation_vector", "rotation")
_TRANSLATION = ("t", "T", "tvec", "translation", "translation_vector")
_SIZE = ("image_size", "size")


def matches(path: Path, content: Any) -> bool:
    """Whether this is such a file, of one camera or of several."""
    return isinstance(content, Mapping) and bool(_is_camera(content) or _camera_tables(content))


def rig_from(path: Path, content: Mapping[str, Any]) -> Rig:
    """The rig of a parsed file; a camera without a name is called like its file."""
    tables = {path.stem: content} if _is_camera(content) else _camera_tables(content)
    cameras = [_camera(path, str(table.get("name", table.get("camera_name", key))), table) for key, table in tables.items()]
    return parts.rig(path, cameras, {})


def _is_camera(content: Mapping[str, Any]) -> bool:
    return any(name in content for name in _MATRIX)


def _camera_tables(content: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    inner = content.get("cameras", content)
    items = enumerate(inner) if isinstance(inner, list) else inner.items() if isinstance(inner, Mapping) else ()
    return {str(key): table for key, table in items if isinstance(table, Mapping) and _is_camera(table)}


def _camera(path: Path, name: str, table: Mapping[str, Any]) -> Camera:
    where = f"{path}: camera {name}"
    if any(key in table for key in _SIZE):
        size = parts.entry(where, table, *_SIZE)
    else:
        size = (parts.entry(where, table, "image_width", "width"), parts.entry(where, table, "image_height", "height"))
    return parts.camera(
        where,
        name=name,
        size=np.ravel(parts.numbers(f"{where}: size", size)),
        matrix=parts.entry(where, table, *_MATRIX),
        distortion=parts.entry(where, table, *_DISTORTION),
        rotation=parts.entry(where, table, *_ROTATION),
        translation=parts.entry(where, table, *_TRANSLATION),
        fisheye=table.get("fisheye_model", table.get("fisheye", 0)),
        readout_s=table.get("readout_s", 0.0),
    )
