"""Calibration TOML: of Anipose and Pose2Sim, the form that posefuse writes, and caliscope's ``camera_array.toml``.

``x_cam = R x_world + t`` in OpenCV axes, metres. Anipose has one table per camera, R as a rotation vector (Rodrigues). Keys both
tools ignore carry what they do not know: ``readout_s`` and ``cropped`` (images are a part of the sensor) per camera,
``world_set_by`` and ``residual_px`` in ``[metadata]``.

caliscope has tables ``[cameras.N]``, R as a 3x3 matrix. It knows cameras by number (``cam_id``, once ``port``) and names their
videos ``cam_N``, so the cameras have these names here. Those that it has not placed are left out. Its earlier versions have
tables as Anipose has them. Cameras that are set to be ignored are left out of both.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from posefuse.core import CalibrationError, Camera, Rig

from . import parts
from .plausible import centre_problem

HOLDS = "caliscope camera_array.toml; Anipose / Pose2Sim *.toml"


def rig_from(path: Path, content: Mapping[str, Any]) -> Rig:
    """The rig of a parsed file."""
    tables = content.get("cameras")
    return _rig_of_caliscope(path, tables) if isinstance(tables, Mapping) else _rig_of_anipose(path, content)


def _rig_of_anipose(path: Path, content: Mapping[str, Any]) -> Rig:
    tables = {key: value for key, value in content.items() if key not in parts.NOT_CAMERAS and isinstance(value, Mapping)}
    used = {key: table for key, table in tables.items() if not table.get("ignore", False)}
    cameras = [_camera(f"{path}: camera {t.get('name', key)}", str(t.get("name", key)), t) for key, t in used.items()]
    about = content.get("metadata", {})
    return parts.rig(path, cameras, about if isinstance(about, Mapping) else {})


def _rig_of_caliscope(path: Path, tables: Mapping[str, Any]) -> Rig:
    cameras = []
    for key, table in tables.items():
        number = table.get("cam_id", table.get("port", key)) if isinstance(table, Mapping) else key
        name = f"cam_{number}"
        where = f"{path}: camera {name}"
        if not isinstance(table, Mapping):
            raise CalibrationError(f"{where}: expected a table of keys, got {type(table).__name__}")
        placed = "rotation" in table and "translation" in table
        if not table.get("ignore", False) and placed:
            cameras.append(_camera(where, name, table))
    if not cameras:
        raise CalibrationError(f"{path}: expected at least 1 camera with rotation and translation, got 0 of {len(tables)}")
    return parts.rig(path, cameras, {})


def _camera(where: str, name: str, table: Mapping[str, Any]) -> Camera:
    """One camera; both formats have the same keys."""
    return parts.camera(
        where,
        name=name,
        size=parts.entry(where, table, "size"),
        matrix=parts.entry(where, table, "matrix"),
        distortion=parts.entry(where, table, "distortions"),
        rotation=parts.entry(where, table, "rotation"),
        translation=parts.entry(where, table, "translation"),
        fisheye=table.get("fisheye", False),
        readout_s=table.get("readout_s", 0.0),
        cropped=table.get("cropped", False),
    )


def _table_from_camera(camera: Camera) -> dict[str, Any]:
    """The keys of one camera."""
    table: dict[str, Any] = {
        "name": camera.name,
        "size": list(camera.size_wh),
        "matrix": parts.rows(camera.K),
        "distortions": parts.rows(camera.distortion),
        "rotation": parts.rows(camera.cam_from_world.rotvec()),
        "translation": parts.rows(camera.cam_from_world.xyz),
        "fisheye": camera.model == "fisheye",
    }
    table |= {"cropped": True} if centre_problem(camera) else {}
    return table | ({"readout_s": camera.readout_s} if camera.readout_s else {})


def text_from(rig: Rig) -> str:
    """The file of a rig."""
    tables = {key: _table_from_camera(camera) for key, camera in zip(parts.plain_keys(rig), rig, strict=True)}
    about = parts.about_rig(rig)
    tables["metadata"] = {"adjusted": False, "error": about.get("residual_px", 0.0), **about}
    return "\n".join(_table_text(name, content) for name, content in tables.items())


def _table_text(name: str, content: Mapping[str, Any]) -> str:
    """A table of strings, booleans, finite numbers and nested lists, whose text in TOML is that in JSON.

    But for one control character, which JSON leaves bare.
    """
    values = {key: json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f") for key, value in content.items()}
    return "".join([f"[{name}]\n", *(f"{key} = {text}\n" for key, text in values.items())])
