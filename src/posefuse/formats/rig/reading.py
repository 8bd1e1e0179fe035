"""Rig files of every known format in and out."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import ModuleType

from posefuse.core import CalibrationError, Rig
from posefuse.core.errors import choices
from posefuse.foundation.atomic import write_text
from posefuse.foundation.manifest import MANIFEST_FILE
from posefuse.foundation.output_folder import output_folder

from . import anipose_toml, caliscope_toml, opencv_storage, parts, qualisys, ros_camera_info
from .document import read_document
from .plausible import doubts, require_placed

# ROS before OpenCV: both call the intrinsics camera_matrix, and ROS has more keys
_READERS: tuple[ModuleType, ...] = (caliscope_toml, anipose_toml, qualisys, ros_camera_info, opencv_storage)
_FOLDER_SUFFIXES = (".yaml", ".yml", ".json")
_ONE_FILE: dict[str, dict[str, Callable[[Rig], str]]] = {
    anipose_toml.NAME: {".toml": anipose_toml.text_from},
    caliscope_toml.NAME: {".toml": caliscope_toml.text_from},
    qualisys.NAME: {".txt": qualisys.text_from, ".xml": qualisys.text_from},
    opencv_storage.NAME: {
        ".yaml": opencv_storage.yaml_text,
        ".yml": opencv_storage.yaml_text,
        ".json": opencv_storage.json_text,
    },
}
_FOLDER: dict[str, Callable[[Rig], dict[str, str]]] = {
    opencv_storage.NAME: opencv_storage.yaml_texts,
    ros_camera_info.NAME: ros_camera_info.texts,
}
RIG_FORMATS = tuple(module.NAME for module in _READERS)


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


def write_rig(path: Path | str, rig: Rig, format: str = anipose_toml.NAME) -> None:
    """Write a rig so that `read_rig` gives the same again; the file appears whole or not at all.

    Args:
        path: a file, or a folder to make for a format of one file per camera (``ros``, and ``opencv`` without an ending).
        rig: what to write.
        format: one of `RIG_FORMATS`.

    Raises:
        CalibrationError: unknown format, an ending that does not fit it, or a rig it cannot hold.
    """
    path = Path(path)
    if format not in RIG_FORMATS:
        raise CalibrationError(f"{path}: no rig format {format!r}; there are: {choices(RIG_FORMATS)}")
    if format in _FOLDER and not path.suffix:
        texts = _FOLDER[format](rig)
        with output_folder(path, command="calibrate", replace=True) as out:
            for name, text in texts.items():
                (out.folder / name).write_text(text, encoding="utf-8")
        return
    endings = _ONE_FILE.get(format, {})
    if path.suffix not in endings:
        allowed = [*endings, *(["a folder (no ending)"] if format in _FOLDER else [])]
        raise CalibrationError(f"{path}: format {format} is written to: {choices(allowed)}")
    text = endings[path.suffix](rig)
    write_text(path, text)


def _read_folder(folder: Path) -> Rig:
    files = sorted(
        file for file in folder.iterdir() if file.suffix in _FOLDER_SUFFIXES and file.is_file() and file.name != MANIFEST_FILE
    )
    if not files:
        raise CalibrationError(f"{folder}: expected one calibration file per camera ({', '.join(_FOLDER_SUFFIXES)}), got none")
    rigs = [read_rig(file) for file in files]
    cameras = [camera for rig in rigs for camera in rig]
    return parts.rig(folder, cameras, parts.about_rig(rigs[0]))
