"""caliscope's ``camera_array.toml``: tables ``[cameras.N]``, ``x_cam = R x_world + t``, R as a 3x3 matrix, metres.

caliscope knows cameras by number (``cam_id``, once ``port``) and names their videos ``cam_N``, so the cameras have
these names here. Cameras that are set to be ignored, or that it has not placed, are left out.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from posefuse.core import CalibrationError, Rig

from . import parts
from .anipose_toml import camera_from_table

HOLDS = "caliscope camera_array.toml"


def matches(path: Path, content: Any) -> bool:
    """Whether this is such a file."""
    return path.suffix == ".toml" and isinstance(content.get("cameras"), Mapping)


def rig_from(path: Path, content: Mapping[str, Any]) -> Rig:
    """The rig of a parsed file."""
    cameras = []
    for key, table in content["cameras"].items():
        number = table.get("cam_id", table.get("port", key)) if isinstance(table, Mapping) else key
        name = f"cam_{number}"
        where = f"{path}: camera {name}"
        if not isinstance(table, Mapping):
            raise CalibrationError(f"{where}: expected a table of keys, got {type(table).__name__}")
        placed = "rotation" in table and "translation" in table
        if not table.get("ignore", False) and placed:
            cameras.append(camera_from_table(where, name, table))
    if not cameras:
        raise CalibrationError(
            f"{path}: expected at least 1 camera with rotation and translation, got 0 of {len(content['cameras'])}"
        )
    return parts.rig(path, cameras, {})
