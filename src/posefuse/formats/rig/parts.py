"""From the numbers of a file to a checked `Camera`: what every rig format shares."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from posefuse.core import SE3, CalibrationError, Camera, Rig, ShapeError
from posefuse.core.arrays import Array
from posefuse.core.errors import choices
from posefuse.foundation.parsing import short

from .plausible import require_plausible

# what rounding to a few digits does to a rotation is mended; anything more is not a rotation
_ROTATION_TOLERANCE = 1e-3
# no recording room is larger, and cameras in millimetres are always farther apart; where the origin lies is free (a robot's map)
FARTHEST_M = 200.0
# no pixel, metre or coefficient is larger; squares of damaged numbers overflow
_LARGEST = 1e12
# tables next to the cameras in a file
NOT_CAMERAS = ("metadata", "capture_volume", "charuco", "checkerboard")


def numbers(where: str, value: Any, shape: tuple[int, ...] | None = None) -> Array:
    """`value` as finite float64; raises CalibrationError otherwise, or when its shape is not `shape`."""
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise CalibrationError(f"{where}: expected numbers, got {short(value)}") from None
    if shape is not None and array.shape != shape:
        raise CalibrationError(f"{where}: expected {'x'.join(map(str, shape))} numbers, got shape {array.shape}")
    if not np.isfinite(array).all():
        raise CalibrationError(f"{where}: expected finite numbers, got NaN or infinity")
    if np.abs(array).max(initial=0) > _LARGEST:
        raise CalibrationError(f"{where}: expected numbers up to {_LARGEST:g}, got {np.abs(array).max():.3g}")
    return array


def entry(where: str, content: Mapping[str, Any], name: str) -> Any:
    """The value under `name`; raises CalibrationError when there is none."""
    if name not in content:
        raise CalibrationError(f"{where}: {name} is missing; there are: {choices(map(str, content))}")
    return content[name]


def image_size(where: str, value: Any) -> tuple[int, int]:
    """(width, height) in whole px."""
    width, height = numbers(f"{where}: size", value, (2,))
    if width != int(width) or height != int(height):
        raise CalibrationError(f"{where}: size: expected whole px, got {width} x {height}")
    return int(width), int(height)


def rotation_matrix(where: str, value: Any) -> Array:
    """(3, 3) proper rotation from a matrix or a rotation vector (Rodrigues, radians).

    Raises:
        CalibrationError: a mirror image, or not orthonormal within `_ROTATION_TOLERANCE`.
    """
    given = numbers(f"{where}: rotation", value)
    if given.shape in ((3,), (3, 1), (1, 3)):
        turn = float(np.linalg.norm(given))
        if turn > 2 * np.pi + _ROTATION_TOLERANCE:
            raise CalibrationError(
                f"{where}: rotation: expected a rotation vector in radians, at most 2 pi long, got {turn:.1f}; is it in degrees?"
            )
        return np.asarray(SE3.from_rotvec(given.reshape(3), np.zeros(3)).matrix())
    if given.shape != (3, 3):
        raise CalibrationError(f"{where}: rotation: expected a 3x3 matrix or 3 numbers (Rodrigues), got shape {given.shape}")
    off = float(np.abs(given @ given.T - np.eye(3)).max())
    if off > _ROTATION_TOLERANCE:
        raise CalibrationError(f"{where}: rotation: not a rotation matrix (R R^T is off the identity by {off:.2g})")
    if np.linalg.det(given) < 0:
        raise CalibrationError(f"{where}: rotation: mirrored (determinant -1); two axes are swapped or one is flipped")
    u, _, vt = np.linalg.svd(given)
    return np.asarray(u @ vt)


def camera_pose(where: str, rotation: Any, translation: Any) -> SE3:
    """cam_from_world of x_cam = R x_world + t, in metres."""
    matrix = rotation_matrix(where, rotation)
    xyz = numbers(f"{where}: translation", np.ravel(numbers(f"{where}: translation", translation)), (3,))
    return SE3.from_matrix(matrix, xyz)


def camera(
    where: str,
    *,
    name: Any,
    size: Any,
    matrix: Any,
    distortion: Any,
    rotation: Any,
    translation: Any,
    fisheye: Any = False,
    readout_s: Any = 0.0,
    cropped: Any = False,
) -> Camera:
    """One camera of a file, every number checked; `where` names file and camera in errors."""
    if not isinstance(fisheye, bool | int) or fisheye not in (0, 1):
        raise CalibrationError(f"{where}: fisheye: expected true or false, got {short(fisheye)}")
    try:
        made = Camera(
            name=str(name),
            size_wh=image_size(where, size),
            K=numbers(f"{where}: matrix", matrix, (3, 3)),
            cam_from_world=camera_pose(where, rotation, translation),
            distortion=np.ravel(numbers(f"{where}: distortion", distortion)),
            model="fisheye" if fisheye else "pinhole",
            readout_s=float(numbers(f"{where}: readout_s", readout_s, ())),
        )
        return require_plausible(where, made, bool(cropped))
    except ShapeError as error:
        raise CalibrationError(f"{where}: {error}") from None
    except CalibrationError as error:
        raise CalibrationError(_named_once(where, str(error))) from None


def rig(path: Path, cameras: list[Camera], about: Mapping[str, Any]) -> Rig:
    """The rig of these cameras; `about` may hold world_set_by and residual_px."""
    if not cameras:
        raise CalibrationError(f"{path}: expected at least 1 camera, got 0")
    residual = about.get("residual_px")
    residual_px = math.nan if residual is None else float(numbers(f"{path}: residual_px", residual, ()))
    try:
        made = Rig(tuple(cameras), str(about.get("world_set_by", "unknown")), residual_px, str(about.get("refused", "")))
    except CalibrationError as error:
        raise CalibrationError(f"{path}: {error}") from None
    centres = made.centres_world()
    far_m = np.linalg.norm(centres - np.median(centres, axis=0), axis=-1)
    if far_m.max() > FARTHEST_M:
        raise CalibrationError(
            f"{path}: camera {made.names[int(far_m.argmax())]}: translation: expected metres, got a camera {far_m.max():.0f} m"
            " from the middle of the others; this looks like millimetres: divide the translations by 1000"
        )
    return made


def about_rig(rig: Rig) -> dict[str, Any]:
    """What a format may carry in addition to the cameras; an unknown residual is left out."""
    about: dict[str, Any] = {"world_set_by": rig.world_set_by}
    if math.isfinite(rig.residual_px):
        about["residual_px"] = rig.residual_px
    return about | ({"refused": rig.refused} if rig.refused else {})


def plain_keys(rig: Rig) -> list[str]:
    """A different key per camera that other readers of TOML take: a letter, then letters, digits, _ and -."""
    keys = ["".join(ch if ch.isascii() and (ch.isalnum() or ch in "_-") else "_" for ch in name) for name in rig.names]
    keys = [key if key[0].isalpha() else f"cam_{key}" for key in keys]
    clear = len(set(keys)) == len(keys) and not set(keys) & set(NOT_CAMERAS)
    return keys if clear else [f"{key}_{i}" for i, key in enumerate(keys)]


def rows(array: Array) -> list[Any]:
    """Nested lists of plain floats, without negative zeros."""
    return list((np.asarray(array, np.float64) + 0.0).tolist())


def _named_once(where: str, message: str) -> str:
    """`where` ends in "camera NAME", with which messages of `core.Camera` begin."""
    camera = "camera " + where.rpartition("camera ")[2]
    return message if message.startswith(where) else f"{where}: {message.removeprefix(f'{camera}: ')}"
