"""The command to type after `posefuse calibrate` has refused, by what mends it; and checks of what its options name."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from posefuse.core import InputError

from .terminal import option_of, quoted

if TYPE_CHECKING:
    from posefuse.calibration.report import CalibrationReport


@dataclass(frozen=True, kw_only=True)
class TypedCommand:
    """A command that was refused.

    Attributes:
        step: of `posefuse calibrate`. inputs: recordings. options: its options.
    """

    step: str
    inputs: Sequence[str]
    options: Any

    def option(self, name: str) -> Any:
        """Its value; None where the step has no such option."""
        return getattr(self.options, name, None)

    def again(self, **changed: Any) -> str:
        """The same command with other values of some options. It replaces the report that the refused one wrote."""
        return _typed(self.step, *map(quoted, self.inputs), option_words(self.options, **{"replace": True, **changed}))


def next_after(report: CalibrationReport, asked: TypedCommand) -> tuple[str, str]:
    """The command to type after a refusal, by the first check that fails, and what it is good for."""
    check, clocks = report.failed[0], asked.option("clocks")
    match check.kind:
        case "clocks" if clocks in ("auto", "together"):
            return asked.again(clocks="offset"), "estimates the clock of each camera"
        case "drift" if clocks in ("auto", "together", "offset"):
            return asked.again(clocks="drift"), "estimates the rate of each clock, too"
        case "lenses" if asked.step in ("extrinsics", "person"):
            out = asked.option("intrinsics") or "lenses.toml"
            command = _typed("intrinsics", "SESSION --target BOARD.toml --out", quoted(out), "--force")
            return command, "the intrinsics of these cameras again, from a board shown to each of them"
        case "upside down" if asked.option("upside_down") is not None:
            named = (*asked.option("upside_down"), *check.cameras)
            return asked.again(upside_down=named), "if these cameras hang upside down"
        case "input":
            return asked.again(), "after names, files or sizes are corrected as the line above states"
        case "rig":
            return _guide("--target CUBE.toml", asked.option("rig")), "a recording for a new calibration of the rig"
    if asked.step == "extrinsics":
        command = _guide(f"--target {quoted(asked.options.target)}", asked.option("intrinsics"))
    else:
        command = "posefuse record --source CAMERA=KIND:WHERE ... --out SESSION"
    return command, "a new recording, with everything still; then the same command with it"


def _guide(target: str, lenses: Any) -> str:
    given = "" if lenses is None else f"--intrinsics {quoted(lenses)}"
    return _typed("guide", target, given, "--source CAMERA=KIND:WHERE ... --record SESSION")


def _typed(*words: str) -> str:
    return " ".join(["posefuse calibrate", *filter(None, words)])


def option_words(options: Any, only: Collection[str] | None = None, **changed: Any) -> str:
    """Options as they are typed: those that are not at their default.

    Args:
        only: names of the fields that may be typed; None: all.
        changed: other values of some options, by the names of their fields.
    """
    words = []
    for field in fields(options):
        if only is not None and field.name not in only:
            continue
        value = changed.get(field.name, getattr(options, field.name))
        if value is True:
            words.append(f"--{option_of(field.name)}")
        elif value != field.default:
            words += _valued(f"--{option_of(field.name)}", value)
    return " ".join(words)


def _valued(option: str, value: Any) -> list[str]:
    """A value, several texts each with the option's name, or several values that follow it once."""
    if not isinstance(value, tuple):
        return [option, quoted(value)]
    if all(isinstance(one, str) for one in value):
        return [word for one in value for word in (option, quoted(one))]
    return [option, *(quoted(one) for one in value)]


def check_files(options: Any, inputs: Sequence[str] = ()) -> list[Path]:
    """Raise InputError before any work where a file that the step will write cannot be, or exists without --force.

    Args:
        options: of the step. inputs: ``NAME=PATH`` texts of recordings.

    Returns:
        What the step reads: the recordings, and the files that its options name.
    """
    from posefuse.calibration.targets.recordings import paths_by_camera
    from posefuse.foundation.output_file import check_output_file

    named = [getattr(options, name, None) for name in ("target", "intrinsics", "rig", "floor_points")]
    read = [*paths_by_camera(inputs).values(), *(path for path in named if path is not None)]
    for name in ("out", "report"):
        if (path := getattr(options, name, None)) is not None:
            check_output_file(path, option=f"--{option_of(name)}", inputs=read, replace=options.replace)
            if name == "out" and path.suffix != ".toml":
                raise InputError(f"--out {path}: a rig file is TOML: expected a name that ends in .toml")
    return read


@contextmanager
def reported(path: Path | None, asked: TypedCommand) -> Iterator[None]:
    """Write the report of a refused calibration, and note the next command, before the error is raised further."""
    from posefuse.calibration.report import RefusedCalibration

    try:
        yield
    except RefusedCalibration as refused:
        if path is not None:
            refused.report.save(path)
        command, purpose = next_after(refused.report, asked)
        refused.add_note(f"next: {command}  ({purpose})")
        raise
