"""A target in words and millimetres: the file that `posefuse calibrate print` writes, and that every other step takes."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any, get_args

from posefuse.calibration.settings import TargetDescription, TargetKind
from posefuse.core import ConfigError, InputError, PosefuseError
from posefuse.core.errors import choices
from posefuse.foundation.output_file import keep_copy, write_text
from posefuse.foundation.settings import read_mapping, read_settings

from .kinds import Charuco, Chessboard, Markers, Target

_MM = 1e3
_KINDS: Mapping[TargetKind, type[Target]] = {"markers": Markers, "charuco": Charuco, "chessboard": Chessboard}


def described_target(said: TargetDescription, missing: Callable[[list[str]], PosefuseError]) -> Target:
    """The target described.

    Args:
        missing: the error to raise for fields that this kind needs and that are None, by their names.
    """
    kind = _KINDS[said.kind]
    if said.thickness_mm is not None and kind is not Charuco:
        raise ConfigError(f"target: thickness_mm: only a charuco has a back side, this is {said.kind}")
    stated = {field.name: getattr(said, _stated(field.name)) for field in fields(kind)}
    absent = [_stated(field.name) for field in fields(kind) if field.default is MISSING and stated[field.name] is None]
    if absent:
        raise missing(absent)
    return kind(**{name: value / _MM if value is not None and name.endswith("_m") else value for name, value in stated.items()})


def description_of(target: Target) -> TargetDescription:
    """The other way round."""
    kind = next(name for name, one in _KINDS.items() if isinstance(target, one))
    values = {field.name: getattr(target, field.name) for field in fields(target)}
    said: dict[str, Any] = {_stated(name): _mm(value) if name.endswith("_m") else value for name, value in values.items()}
    return TargetDescription(kind=kind, **said)


def _stated(name: str) -> str:
    """The key in the file of a field of a target: lengths are stated in mm."""
    if name == "side_m":
        return "marker_mm"
    return f"{name}m" if name.endswith("_m") else name


def read_target(path: Path) -> Target:
    """The target of a file that `write_target` or a person wrote.

    Raises:
        ConfigError: it cannot be read, has an unknown key, or lacks a size that this kind of target needs.
    """
    if "kind" not in read_mapping(path):
        raise ConfigError(
            f"{path}: not a target file: expected kind = {choices(get_args(TargetKind))}; `calibrate print` writes one"
        )
    said = read_settings(path, TargetDescription)
    return described_target(said, lambda names: ConfigError(f"{path}: {said.kind}: missing {', '.join(names)}"))


def write_target(path: Path, target: Target) -> Path:
    """The file, which is returned; an older one is kept as NAME.replaced-TIME. Raises InputError where it cannot be written."""
    said = description_of(target)
    lines = [
        f"# A calibration target. Give this file to the steps of `posefuse calibrate`: --target {path.name}",
        "# Measure the print: where its sizes differ from these, correct them here.",
    ]
    for field in fields(TargetDescription):
        value = getattr(said, field.name)
        if value is not None and value != () and value is not False:
            lines.append(f"{field.name} = {json.dumps(value)}")
    try:
        keep_copy(path)
        write_text(path, "\n".join(lines) + "\n")
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror})") from None
    return path


def _mm(metres: float | None) -> float | None:
    return None if metres is None else round(metres * _MM, 6)
