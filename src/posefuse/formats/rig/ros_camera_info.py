"""ROS ``camera_info`` YAML (as camera_calibration and camera_info_manager write it): a folder of one file per camera.

The format has no place for a pose, so it is a separate key ``tf``, as the `geometry_msgs/TransformStamped` that ROS
would publish: the pose of the optical frame in the world (world_from_cam), metres, quaternion x y z w::

    tf:
      header: {frame_id: world}
      child_frame_id: cam01_optical_frame
      transform:
        translation: {x: 0.0, y: 0.0, z: 1.0}
        rotation: {x: 0.0, y: 0.0, z: 0.0, w: 1.0}

Own keys: ``readout_s``, ``world_set_by``, ``residual_px``. Distortion models: plumb_bob, rational_polynomial, equidistant.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from posefuse.core import SE3, CalibrationError, Camera, Rig
from posefuse.core.arrays import Array
from posefuse.core.errors import choices
from posefuse.foundation.parsing import short

from . import parts

NAME = "ros"
HOLDS = "ROS camera_info *.yaml with its pose under tf (one camera, or a folder of them)"
_MODELS = ("plumb_bob", "rational_polynomial", "equidistant", "fisheye", "")


def matches(path: Path, content: Any) -> bool:
    """Whether this is such a file."""
    return isinstance(content, Mapping) and "camera_matrix" in content and "distortion_model" in content


def rig_from(path: Path, content: Mapping[str, Any]) -> Rig:
    """The rig (of one camera) of a parsed file."""
    name = str(content.get("camera_name") or path.stem)
    where = f"{path}: camera {name}"
    model = content["distortion_model"]
    if model not in _MODELS:
        raise CalibrationError(f"{where}: distortion_model: expected one of {choices(filter(None, _MODELS))}, got {short(model)}")
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
    return parts.rig(path, [camera], content)


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


def texts(rig: Rig) -> dict[str, str]:
    """File name -> YAML text, one file per camera."""
    about = parts.about_rig(rig)
    stems = parts.file_stems(rig)
    return {f"{stem}.yaml": yaml.safe_dump(_content(c) | about, sort_keys=False) for stem, c in zip(stems, rig, strict=True)}


def _content(camera: Camera) -> dict[str, Any]:
    model, distortion = _ros_distortion(camera)
    world_from_cam = camera.cam_from_world.inverse()
    w, x, y, z = parts.rows(world_from_cam.wxyz)
    content: dict[str, Any] = {
        "image_width": camera.size_wh[0],
        "image_height": camera.size_wh[1],
        "camera_name": camera.name,
        "camera_matrix": _matrix(camera.K),
        "distortion_model": model,
        "distortion_coefficients": _matrix(distortion.reshape(1, -1)),
        "rectification_matrix": _matrix(np.eye(3)),
        "projection_matrix": _matrix(np.hstack([camera.K, np.zeros((3, 1))])),
        "tf": {
            "header": {"frame_id": "world"},
            "child_frame_id": f"{camera.name}_optical_frame",
            "transform": {
                "translation": dict(zip("xyz", parts.rows(world_from_cam.xyz), strict=True)),
                "rotation": {"x": x, "y": y, "z": z, "w": w},
            },
        },
    }
    return content | ({"readout_s": camera.readout_s} if camera.readout_s else {})


def _ros_distortion(camera: Camera) -> tuple[str, Array]:
    d = camera.distortion
    if camera.model == "fisheye":
        return "equidistant", d
    if len(d) > 5:
        return "rational_polynomial", d
    return "plumb_bob", np.concatenate([d, np.zeros(5 - len(d))])


def _matrix(array: Array) -> dict[str, Any]:
    return {"rows": array.shape[0], "cols": array.shape[1], "data": parts.rows(array.ravel())}
