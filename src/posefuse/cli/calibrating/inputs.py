"""What the user wrote on the command line of `posefuse calibrate`, as recordings and clock offsets."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

from posefuse.calibration.targets.recordings import named_recordings
from posefuse.core import InputError, Rig
from posefuse.foundation.output_file import check_output_file
from posefuse.pipeline.config import read_config


def option_words(options: Any, **changed: Any) -> str:
    """Options as they are typed: those that are not at their default.

    Args:
        changed: other values of some options, by the names of their fields.
    """
    words = []
    for field in fields(options):
        value = changed.get(field.name, getattr(options, field.name))
        if value is True:
            words.append(option_name(field.name))
        elif value != field.default:
            words += _valued(option_name(field.name), value)
    return " ".join(words)


def _valued(option: str, value: Any) -> list[str]:
    """A value, several texts each with the option's name, or several values that follow it once."""
    if not isinstance(value, tuple):
        return [option, shlex.quote(str(value))]
    if all(isinstance(one, str) for one in value):
        return [word for one in value for word in (option, shlex.quote(one))]
    return [option, *(shlex.quote(str(one)) for one in value)]


def option_name(name: str) -> str:
    """How an option is typed."""
    return f"--{name.replace('_', '-')}"


def recordings_of(inputs: Sequence[str]) -> dict[str, Path]:
    """``NAME=PATH`` texts as recordings by camera name, which defaults to the file's; a session folder gives all of its videos.

    Raises:
        InputError: one name twice.
    """
    named: dict[str, Path] = {}
    for text in inputs:
        name, equals, path = text.partition("=")
        for camera, file in {name: Path(path)}.items() if equals else named_recordings(Path(text)).items():
            if camera in named:
                raise InputError(f"{text}: camera {camera} has a recording already ({named[camera]}); name them as NAME=PATH")
            named[camera] = file
    return named


def clock_offsets_s(offsets: Sequence[str], rig: Rig) -> dict[str, float]:
    """Clock offsets in s by camera name, from texts ``CAMERA=MS``."""
    found: dict[str, float] = {}
    for text in offsets:
        name, _, value = text.partition("=")
        try:
            found[rig[name].name] = float(value) / 1e3
        except ValueError:
            raise InputError(f"--offset-ms {text}: expected CAMERA=MILLISECONDS") from None
    return found


def clocks_beside(path: Path, rig: Rig) -> dict[str, float]:
    """Clock offsets in s by camera name, from the settings file next to a rig file; empty where there are none.

    Raises:
        InputError: settings with a drift, which holds for their own recording only.
    """
    if not path.is_file():
        return {}
    cameras = {name: one for name, one in read_config(path).cameras.items() if name in rig.names}
    drifting = [name for name, one in cameras.items() if one.drift_ppm]
    if drifting:
        raise InputError(f"{path}: the clock of {', '.join(drifting)} drifts; give today's offsets with --offset-ms CAMERA=MS")
    # settings state what is added to stamps, a clock offset how late they are
    return {name: -one.offset_s for name, one in cameras.items() if one.offset_s}


def check_files(inputs: Sequence[str | Path | None], outputs: Sequence[tuple[str, Path | None]], *, force: bool) -> None:
    """Raise InputError before any work where a file that the step will write cannot be, or exists without --force.

    Args:
        inputs: what is read: ``NAME=PATH`` texts and paths. outputs: option and file.
    """
    texts = [text for text in inputs if isinstance(text, str)]
    read = [*recordings_of(texts).values(), *(path for path in inputs if isinstance(path, Path))]
    for option, path in outputs:
        if path is not None:
            check_output_file(path, option=option, inputs=read, replace=force)
