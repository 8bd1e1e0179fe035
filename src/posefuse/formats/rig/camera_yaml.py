"""Calibration YAML and JSON: one file per camera in a folder, of OpenCV or ROS, or one file of several cameras, of OpenCV.

OpenCV FileStorage: ``x_cam = R x_world + t``, metres. Keys as OpenCV's calibration sample writes them; the names others use are
read too. A file of several cameras is a mapping of camera name to such keys. Fisheye is the sample's ``fisheye_model: 1``. Keys
of posefuse: ``name``, ``readout_s``.

ROS ``camera_info`` (as camera_calibration and camera_info_manager write it) has no place for a pose, so it is a separate key
``tf``, as the `geometry_msgs/TransformStamped` that ROS would publish: the pose of the optical frame in the world
(world_from_cam), metres, quaternion x y z w::

    tf:
      header: {frame_id: world}
      child_frame_id: cam01_optical_frame
      transform:
        translation: {x: 0.0, y: 0.0, z: 1.0}
        rotation: {x: 0.0, y: 0.0, z: 0.0, w: 1.0}

Own key: ``readout_s``. Distortion models: plumb_bob, rational_polynomial, equidistant.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from posefuse.core import SE3, CalibrationError, Camera, Rig
from posefuse.core.errors import choices
from posefuse.foundation.parsing import short

from . import parts

HOLDS = (
    "ROS camera_info *.yaml with its pose under tf (one camera, or a folder of them); "
    "OpenCV FileStorage *.yaml, *.yml, *.json (one file, or a folder of one file per camera)"
)
_MATRIX = ("camera_matrix", "K", "cameraMatrix", "intrinsic_matrix", "mtx", "matrix")
_DISTORTION = ("distortion_coefficients", "dist_coeffs", "distCoeffs", "D", "dist", "distortions")
_ROTATION = ("R", "rvec", "rotation_matrix", "rotation_vector", "rotation")
_TRANSLATION = ("t", "T", "tvec", "translation", "translation_vector")
_SIZE = ("image_size", "size")
_ROS_MODELS = ("plumb_bob", "rational_polynomial", "equidistant", "fisheye", "")


def matches(path: Path, content: Any) -> bool:
    """Whether this is such a file, of one camera or of several."""
    return isinstance(content, Mapping) and bool(_is_of_ros(content) or _is_camera(content) or _camera_tables(content))


def rig_from(path: Path, content: Mapping[str, Any]) -> Rig:
    """The rig of a parsed file; a camera without a name is called like its file."""
    # both call the intrinsics camera_matrix, and ROS has more keys
    return _rig_of_ros(path, content) if _is_of_ros(content) else _rig_of_opencv(path, content)


def _rig_of_opencv(path: Path, content: Mapping[str, Any]) -> Rig:
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


def _is_of_ros(content: Mapping[str, Any]) -> bool:
    return "camera_matrix" in content and "distortion_model" in content


def _rig_of_ros(path: Path, content: Mapping[str, Any]) -> Rig:
    name = str(content.get("camera_name") or path.stem)
    where = f"{path}: camera {name}"
    model = content["distortion_model"]
    if model not in _ROS_MODELS:
        raise CalibrationError(
            f"{where}: distortion_model: expected one of {choices(filter(None, _ROS_MODELS))}, got {short(model)}"
        )
    if "tf" not in content:
        raise CalibrationError(f"{where}: has no pose; add it next to the intrinsics: tf, a geometry_msgs/TransformStamped")
    cam_from_world = _pose(where, content["tf"]).inverse()
    camera = parts.camera(
        where,
        name=name,
        size=(parts.entry(where, content, "image_width"), parts.entry(where, content, "image_height")),
        matrix=content["camera_matrix"],
        distortion=parts.entry(where, content, "distortion_coefficients"),
        rotation=cam_from_world.matrix(),
        translation=cam_from_world.xyz,
        fisheye=model in ("equidistant", "fisheye"),
        readout_s=content.get("readout_s", 0.0),
    )
    return parts.rig(path, [camera], {})


def _pose(where: str, tf: Any) -> SE3:
    try:
        transform = tf["transform"]
        quaternion = [transform["rotation"][part] for part in "wxyz"]
        xyz = [transform["translation"][part] for part in "xyz"]
    except (KeyError, TypeError):
        raise CalibrationError(
            f"{where}: tf: expected transform with translation {{x, y, z}} and rotation {{x, y, z, w}}"
        ) from None
    wxyz = parts.numbers(f"{where}: tf: rotation", quaternion, (4,))
    if abs(np.linalg.norm(wxyz) - 1) > parts.ROTATION_TOLERANCE:
        raise CalibrationError(f"{where}: tf: rotation: expected a unit quaternion, got length {np.linalg.norm(wxyz):.4g}")
    return SE3(wxyz, parts.numbers(f"{where}: tf: translation", xyz, (3,)))
