"""Rig files: every known format in, TOML out."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

from posefuse.core import CalibrationError, Rig
from posefuse.foundation.output_file import write_text

from . import anipose_toml, caliscope_toml, opencv_storage, parts, qualisys, ros_camera_info
from .document import read_document
from .plausible import doubts, require_placed

# ROS before OpenCV: both call the intrinsics camera_matrix, and ROS has more keys
_READERS: tuple[ModuleType, ...] = (caliscope_toml, anipose_toml, qualisys, ros_camera_info, opencv_storage)
_FOLDER_SUFFIXES = (".yaml", ".yml", ".json")


def read_rig(path: Path | str) -> Rig:
    """The rig in a file, or in a folder of one file per camera; the format is recognised by its content.

    Raises:
        CalibrationError: no such file, a format not known (lists those that are), or a rig that cannot be right: a
            missing key, NaN, a mirrored or non-rotation matrix, millimetres for metres, degrees for radians, intrinsics that
            no camera has, a name twice. One line that names
            file, camera, what was expected and what was there.
    """
    path = Path(path)
    if path.is_dir():
        return _read_folder(path)
    if not path.is_file():
        raise CalibrationError(f"{path}: no such calibration file or folder")
    content = read_document(path)
    for module in _READERS:
        if content is not None and module.matches(path, content):
            rig: Rig = module.rig_from(path, content)
            return rig
    raise CalibrationError(f"{path}: no calibration in a known format; known: {'; '.join(m.HOLDS for m in _READERS)}")


def read_placed_rig(path: Path | str) -> Rig:
    """The rig of a file that must have extrinsics.

    Raises:
        CalibrationError: as `read_rig`; and for cameras at one place (intrinsics only) or poses that mean something else.
    """
    return require_placed(str(path), read_rig(path))


def rig_warnings(path: Path | str, rig: Rig) -> tuple[str, ...]:
    """What to know before a placed rig is used: a calibration that was refused, and poses that are odd; one line each."""
    return (*filter(None, [refusal_note(path, rig)]), *doubts(str(path), rig))


def refusal_note(path: Path | str, rig: Rig) -> str:
    """The warning for each use of a rig whose calibration was refused; empty for others."""
    if not rig.refused:
        return ""
    return f"{path}: this calibration was refused ({rig.refused}) and kept all the same: do not trust positions"


def write_rig(path: Path | str, rig: Rig) -> None:
    """Write a rig as TOML so that `read_rig` gives the same again; the file appears whole or not at all.

    Raises:
        CalibrationError: the name does not end in .toml, by which `read_rig` recognises it.
    """
    path = Path(path)
    if path.suffix != ".toml":
        raise CalibrationError(f"{path}: a rig file is TOML: expected a name that ends in .toml")
    write_text(path, anipose_toml.text_from(rig))


def _read_folder(folder: Path) -> Rig:
    files = sorted(file for file in folder.iterdir() if file.suffix in _FOLDER_SUFFIXES and file.is_file())
    if not files:
        raise CalibrationError(f"{folder}: expected one calibration file per camera ({', '.join(_FOLDER_SUFFIXES)}), got none")
    return parts.rig(folder, [camera for file in files for camera in read_rig(file)], {})
