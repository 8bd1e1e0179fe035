"""ROS ``camera_info`` YAML (as camera_calibration and camera_info_manager write it): a folder of one file per camera.

The format has no place for a pose, so it is a separate key ``tf``, as the `geometry_msgs/TransformStamped` that ROS
would publish: the pose of the optical frame in the world (world_from_cam), metres, quaternion x y z w::

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

from posefuse.core import SE3, CalibrationError, Rig
from posefuse.core.errors import choices
from posefuse.foundation.parsing import short

from . import parts

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
