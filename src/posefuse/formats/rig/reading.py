"""Rig files: every known format in, TOML out."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from pathlib import Path
from types import ModuleType
from typing import Any

import yaml

from posefuse.core import CalibrationError, Rig
from posefuse.foundation.output_file import write_text
from posefuse.foundation.parsing import one_line, parse_json, parse_toml, parse_yaml, read_text

from . import camera_toml, camera_yaml, parts, qualisys
from .plausible import doubts, require_placed

# TOML, XML, YAML and JSON files parsed to plain values, OpenCV's and ROS's matrices included.

# Newer versions of OpenCV write what numpy has in one dimension with the second
_MATRIX_TAGS = ("tag:yaml.org,2002:opencv-matrix", "tag:yaml.org,2002:opencv-nd-matrix")


class _Loader(yaml.SafeLoader):
    """YAML 1.1 plus OpenCV's matrix tag, and numbers like 1e-5 or 1.e-05, which YAML 1.1 takes for text."""


def _matrix(loader: yaml.SafeLoader, node: yaml.MappingNode) -> dict[Any, Any]:
    return loader.construct_mapping(node, deep=True)


for _tag in _MATRIX_TAGS:
    _Loader.add_constructor(_tag, _matrix)
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)[eE][-+]?[0-9]+\Z"),
    list("-+0123456789."),
)


def read_document(path: Path) -> Any:
    """The content of a file: a mapping (.toml, .yaml, .yml, .json) or an XML element; None for anything else.

    Matrices written as rows, cols, data become nested lists.

    Raises:
        CalibrationError: it cannot be read, or does not match its name.
    """
    where, text = str(path), read_text(path, CalibrationError)
    if path.suffix == ".toml":
        return parse_toml(where, text, CalibrationError)
    if text.lstrip().startswith("<"):
        return _xml(path, text)
    if path.suffix == ".json":
        return _matrices(where, parse_json(where, text, CalibrationError))
    if path.suffix in (".yaml", ".yml"):
        # OpenCV's header is not the one the YAML standard has
        return _matrices(where, parse_yaml(where, re.sub(r"\A%YAML:.*\n", "", text), CalibrationError, _Loader))
    return None


def _xml(path: Path, text: str) -> ET.Element:
    if "<!ENTITY" in text or "<!DOCTYPE" in text:
        raise CalibrationError(f"{path}: XML with a DOCTYPE is not read")
    # the declared encoding no longer holds for decoded text
    try:
        return ET.fromstring(re.sub(r"\A\s*<\?xml.*?\?>", "", text))
    except (ET.ParseError, ValueError) as error:
        raise CalibrationError(f"{path}: cannot be parsed as XML ({one_line(error)})") from None


def _matrices(where: str, value: Any) -> Any:
    if isinstance(value, list):
        return [_matrices(where, part) for part in value]
    if not isinstance(value, dict):
        return value
    if {"sizes", "data"} <= set(value) and isinstance(value["sizes"], list) and len(value["sizes"]) == 1:
        value = {**value, "rows": value["sizes"][0], "cols": 1}
    if {"rows", "cols", "data"} <= set(value):
        rows, cols, data = value["rows"], value["cols"], value["data"]
        if not (isinstance(rows, int) and isinstance(cols, int) and isinstance(data, list) and len(data) == rows * cols):
            raise CalibrationError(f"{where}: matrix: expected rows x cols = {rows} x {cols} numbers in data, got {_count(data)}")
        return [data[i * cols : (i + 1) * cols] for i in range(rows)] if rows > 1 and cols > 1 else data
    return {key: _matrices(where, part) for key, part in value.items()}


def _count(data: Any) -> str:
    return str(len(data)) if isinstance(data, list) else type(data).__name__


_READERS: tuple[ModuleType, ...] = (camera_toml, qualisys, camera_yaml)
_FOLDER_SUFFIXES = (".yaml", ".yml", ".json")


def read_rig(path: Path | str) -> Rig:
    """The rig in a file, a folder with a ``rig.toml``, or one of a file per camera; the format is recognised by its content.

    Raises:
        CalibrationError: no such file, a format not known (lists those that are), or a rig that cannot be right: a
            missing key, NaN, a mirrored or non-rotation matrix, millimetres for metres, degrees for radians, intrinsics that
            no camera has, a name twice. One line that names
            file, camera, what was expected and what was there.
    """
    path = Path(path)
    if path.is_dir():
        if not (path / "rig.toml").is_file():
            return _read_folder(path)
        path = path / "rig.toml"
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
    write_text(path, camera_toml.text_from(rig))


def _read_folder(folder: Path) -> Rig:
    files = sorted(file for file in folder.iterdir() if file.suffix in _FOLDER_SUFFIXES and file.is_file())
    if not files:
        raise CalibrationError(f"{folder}: expected one calibration file per camera ({', '.join(_FOLDER_SUFFIXES)}), got none")
    return parts.rig(folder, [camera for file in files for camera in read_rig(file)], {})
