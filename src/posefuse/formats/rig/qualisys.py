"""Qualisys Track Manager calibration (``.qca.txt``, XML).

What its numbers mean, found by comparing such a file with the same rig in OpenCV's terms and with photographs of a board
through the same lenses:

- ``transform``: the camera's centre x, y, z in millimetres; r11..r33 row by row turn world axes into camera axes whose y
  points up and z backwards, so ``R_opencv = diag(1, -1, -1) r``.
- ``intrinsic``: focal lengths, principal point and sensor limits in 64ths of a pixel, skew too.
- ``radialDistortion1..3`` and ``tangentalDistortion1..2`` are OpenCV's k1 k2 k3 p1 p2 as they are. They act on x/z, y/z and
  have no unit; converters that divide them by 64 as well flatten the lens.
- ``fov_video``: first and last column and row of the image; the intrinsics count from the sensor's first pixel.
- ``viewrotation``: by how much QTM turns the view of a camera, in degrees. All else is of the sensor as it is; whether the
  videos next to the file are turned cannot be known from it, so that only 0 is read.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np

from posefuse.core import CalibrationError, Camera, Rig
from posefuse.core.arrays import Array
from posefuse.core.errors import choices

from . import parts

HOLDS = "Qualisys *.qca.txt"
SUBPIXELS = 64.0
_MM = 1000.0
_OPENCV_FROM_QUALISYS = np.diag([1.0, -1.0, -1.0])
_RADIAL = ("radialDistortion1", "radialDistortion2", "radialDistortion3")
_TANGENTIAL = ("tangentalDistortion1", "tangentalDistortion2")


def rig_from(path: Path, content: ET.Element) -> Rig:
    """The rig of a parsed file; cameras that are switched off (``active="0"``) are left out."""
    elements = [element for element in content.iter("camera") if element.get("active", "1") != "0"]
    return parts.rig(path, [_camera(path, element) for element in elements], {"world_set_by": "Qualisys"})


def _camera(path: Path, element: ET.Element) -> Camera:
    name = element.get("serial", "")
    where = f"{path}: camera {name}"
    _check_not_turned(where, element)
    transform, intrinsic, view = (_child(where, element, tag) for tag in ("transform", "intrinsic", "fov_video"))
    r = np.array([[_number(where, transform, f"r{row}{column}") for column in (1, 2, 3)] for row in (1, 2, 3)])
    rotation = _OPENCV_FROM_QUALISYS @ parts.rotation_matrix(where, r)
    centre_m = np.array([_number(where, transform, axis) for axis in "xyz"]) / _MM
    left, right, top, bottom = (_number(where, view, side) for side in ("left", "right", "top", "bottom"))
    matrix = np.eye(3)
    matrix[0, 0], matrix[1, 1] = (_number(where, intrinsic, f"focalLength{axis}") / SUBPIXELS for axis in "UV")
    matrix[0, 1] = _number(where, intrinsic, "skew") / SUBPIXELS
    matrix[0, 2] = _number(where, intrinsic, "centerPointU") / SUBPIXELS - left
    matrix[1, 2] = _number(where, intrinsic, "centerPointV") / SUBPIXELS - top
    return parts.camera(
        where,
        name=name,
        size=(right - left + 1, bottom - top + 1),
        matrix=matrix,
        distortion=_distortion(where, intrinsic),
        rotation=rotation,
        translation=-rotation @ centre_m,
        cropped=left > 0 or top > 0,
    )


def _check_not_turned(where: str, element: ET.Element) -> None:
    turned_deg = float(parts.numbers(f"{where}: viewrotation", element.get("viewrotation", "0"), ()))
    if turned_deg:
        raise CalibrationError(
            f"{where}: viewrotation: expected 0, got {turned_deg:g}: whether its video is turned is not known; set the rotation "
            "of its view to 0 in QTM, and export calibration and video again"
        )


def _distortion(where: str, intrinsic: ET.Element) -> Array:
    """k1 k2 p1 p2 k3, as short as OpenCV's order allows."""
    k1, k2, k3 = (_number(where, intrinsic, key) for key in _RADIAL)
    p1, p2 = (_number(where, intrinsic, key) for key in _TANGENTIAL)
    coefficients = np.array([k1, k2, p1, p2, k3])
    return coefficients if k3 else coefficients[:4]


def _child(where: str, element: ET.Element, tag: str) -> ET.Element:
    child = element.find(tag)
    if child is None:
        raise CalibrationError(f"{where}: <{tag}> is missing; there are: {choices(part.tag for part in element)}")
    return child


def _number(where: str, element: ET.Element, key: str) -> float:
    text = parts.entry(f"{where}: <{element.tag}>", element.attrib, key)
    return float(parts.numbers(f"{where}: {key}", text, ()))
