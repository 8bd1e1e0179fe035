"""OpenCV FileStorage (YAML or JSON): one file per camera in a folder, or one file of several cameras.

``x_cam = R x_world + t``, metres. Keys as OpenCV's calibration sample writes them; the names others use are read too.
A file of several cameras is a mapping of camera name to such keys. Fisheye is the sample's ``fisheye_model: 1``.
Keys of posefuse: ``name``, ``readout_s``, ``world_set_by``, ``residual_px``.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from posefuse.core import Camera, Rig
from posefuse.core.arrays import Array

from . import parts

NAME = "opencv"
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
    return parts.rig(path, cameras, content)


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


def yaml_text(rig: Rig) -> str:
    """The YAML file of a rig, cameras by name."""
    lines = ["%YAML:1.0", "---"]
    for key, value in parts.about_rig(rig).items():
        lines.append(f"{key}: {_scalar(value)}")
    for key, camera in zip(parts.plain_keys(rig), rig, strict=True):
        lines.append(f"{key}:")
        lines += [f"   {line}" for line in _yaml_lines(camera)]
    return "\n".join(lines) + "\n"


def yaml_texts(rig: Rig) -> dict[str, str]:
    """File name -> YAML text, one file per camera."""
    about = [f"{key}: {_scalar(value)}" for key, value in parts.about_rig(rig).items()]
    texts = ["\n".join(["%YAML:1.0", "---", *_yaml_lines(camera), *about]) + "\n" for camera in rig]
    return {f"{stem}.yaml": text for stem, text in zip(parts.file_stems(rig), texts, strict=True)}


def json_text(rig: Rig) -> str:
    """The JSON file of a rig, cameras by name."""
    tables = {
        key: {k: _json_matrix(v) if isinstance(v, np.ndarray) else v for k, v in _entries(camera).items()}
        for key, camera in zip(parts.plain_keys(rig), rig, strict=True)
    }
    return json.dumps(parts.about_rig(rig) | tables, indent=2) + "\n"


def _entries(camera: Camera) -> dict[str, Any]:
    d = camera.distortion
    if camera.model == "pinhole":
        d = np.concatenate([d, np.zeros(max(0, 5 - len(d)))])
    entries: dict[str, Any] = {
        "name": camera.name,
        "image_width": camera.size_wh[0],
        "image_height": camera.size_wh[1],
        "fisheye_model": int(camera.model == "fisheye"),
        "camera_matrix": camera.K,
        "distortion_coefficients": d.reshape(-1, 1),
        "R": camera.cam_from_world.matrix(),
        "t": camera.cam_from_world.xyz.reshape(3, 1),
    }
    return entries | ({"readout_s": camera.readout_s} if camera.readout_s else {})


def _yaml_lines(camera: Camera) -> list[str]:
    lines = []
    for key, value in _entries(camera).items():
        if isinstance(value, np.ndarray):
            lines += [f"{key}: !!opencv-matrix", f"   rows: {value.shape[0]}", f"   cols: {value.shape[1]}", "   dt: d"]
            lines.append(f"   data: [ {', '.join(repr(number) for number in parts.rows(value.ravel()))} ]")
        else:
            lines.append(f"{key}: {_scalar(value)}")
    return lines


def _json_matrix(array: Array) -> dict[str, Any]:
    head = {"type_id": "opencv-matrix", "rows": array.shape[0], "cols": array.shape[1], "dt": "d"}
    return head | {"data": parts.rows(array.ravel())}


def _scalar(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False)
