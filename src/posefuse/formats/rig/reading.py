"""Rig files: every known format in, TOML out."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from pathlib import Path

from posefuse.core import CalibrationError, Rig
from posefuse.foundation.output_file import write_text
from posefuse.foundation.parsing import one_line, parse_toml, read_text

from . import camera_toml, qualisys
from .plausible import doubts, require_placed


def read_rig(path: Path | str) -> Rig:
    """The rig in a file, or in the ``rig.toml`` of a folder.

    Raises:
        CalibrationError: no such file, a format not known (lists those that are), or a rig that cannot be right: a
            missing key, NaN, a mirrored or non-rotation matrix, millimetres for metres, degrees for radians, intrinsics that
            no camera has, a name twice. One line that names
            file, camera, what was expected and what was there.
    """
    path = Path(path)
    if path.is_dir():
        path = path / "rig.toml"
    if not path.is_file():
        raise CalibrationError(f"{path}: no such calibration file")
    text = read_text(path, CalibrationError)
    if path.suffix == ".toml":
        return camera_toml.rig_from(path, parse_toml(str(path), text, CalibrationError))
    element = _xml(path, text) if text.lstrip().startswith("<") else None
    if element is not None and element.tag == "calibration":
        return qualisys.rig_from(path, element)
    raise CalibrationError(
        f"{path}: no calibration in a known format; known: {camera_toml.HOLDS}; {qualisys.HOLDS}; "
        "write other cameras as TOML with posefuse.Rig(cameras).save(FILE), or by hand as docs/reference/files.md shows"
    )


def _xml(path: Path, text: str) -> ET.Element:
    if "<!ENTITY" in text or "<!DOCTYPE" in text:
        raise CalibrationError(f"{path}: XML with a DOCTYPE is not read")
    # the declared encoding no longer holds for decoded text
    try:
        return ET.fromstring(re.sub(r"\A\s*<\?xml.*?\?>", "", text))
    except (ET.ParseError, ValueError) as error:
        raise CalibrationError(f"{path}: cannot be parsed as XML ({one_line(error)})") from None


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
