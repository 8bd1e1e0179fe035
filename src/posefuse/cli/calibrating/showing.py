"""What `posefuse calibrate` shows of a result, the files it leaves in any case, and the command to type next."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from posefuse.calibration.clocks.sync import ClockEstimate
from posefuse.calibration.report import CalibrationReport, RefusedCalibration
from posefuse.calibration.result_files import clock_settings, write_calibration_report
from posefuse.cli.terminal import Terminal
from posefuse.foundation.output_file import write_text
from posefuse.pipeline.config import read_config

from .inputs import option_words


@dataclass(frozen=True, kw_only=True)
class Asked:
    """What the refused command was asked for.

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
        return _typed(self.step, *map(shlex.quote, self.inputs), option_words(self.options, **{"force": True, **changed}))


def next_after(report: CalibrationReport, asked: Asked) -> tuple[str, str]:
    """The command to type after a refusal, by the first check that fails, and what it is good for."""
    check, clocks = report.failed[0], asked.option("clocks")
    match check.kind:
        case "clocks" if clocks in ("auto", "together"):
            return asked.again(clocks="offset"), "estimates the clock of each camera"
        case "drift" if clocks in ("auto", "together", "offset"):
            return asked.again(clocks="drift"), "estimates the rate of each clock, too"
        case "lenses" if asked.step in ("extrinsics", "person"):
            out = asked.option("intrinsics") or "lenses.toml"
            command = _typed("intrinsics", "SESSION --target BOARD.toml --out", shlex.quote(str(out)), "--force")
            return command, "the intrinsics of these cameras again, from a board shown to each of them"
        case "upside down" if asked.option("upside_down") is not None:
            named = (*asked.option("upside_down"), *check.cameras)
            return asked.again(upside_down=named), "if these cameras hang upside down"
        case "input":
            return asked.again(), "after names, files or sizes are corrected as the line above states"
        case "rig":
            return _guide("--target CUBE.toml", asked.option("rig")), "a recording for a new calibration of the rig"
    if asked.step == "extrinsics":
        command = _guide(f"--target {shlex.quote(str(asked.options.target))}", asked.option("intrinsics"))
    else:
        command = "posefuse record --source CAMERA=KIND:WHERE ... --out SESSION"
    return command, "a new recording, with everything still; then the same command with it"


def _guide(target: str, lenses: Any) -> str:
    given = "" if lenses is None else f"--intrinsics {shlex.quote(str(lenses))}"
    return _typed("guide", target, given, "--source CAMERA=KIND:WHERE ... --record SESSION")


def _typed(*words: str) -> str:
    return " ".join(["posefuse calibrate", *filter(None, words)])


@contextmanager
def reported(path: Path | None, asked: Asked) -> Iterator[None]:
    """Write the report of a refused calibration, and note the next command, before the error is raised further."""
    try:
        yield
    except RefusedCalibration as refused:
        if path is not None:
            write_calibration_report(path, refused.report, {})
        command, purpose = next_after(refused.report, asked)
        refused.add_note(f"next: {command}  ({purpose})")
        raise


def show_report(report: CalibrationReport, terminal: Terminal) -> None:
    """The checks as a table, and the notes."""
    rows = [("pass" if check.passed else "FAIL", check.name, check.line) for check in report.checks]
    terminal.table(report.subject, ("", "check", "found"), rows)
    for note in report.notes:
        terminal.note(f"note: {note}")


def show_clocks(names: Sequence[str], clocks: ClockEstimate, period_s: Sequence[float], terminal: Terminal) -> None:
    """A table of all cameras, in ms and in frames, which come every period_s (C,) s."""
    rows: list[list[Any]] = []
    for c, name in enumerate(names):
        offset, sigma = clocks.offset_s[c], clocks.offset_sigma_s[c]
        rows.append([name, _both(offset * 1e3, sigma * 1e3, 1), _both(offset / period_s[c], sigma / period_s[c], 2)])
        if clocks.drift_sigma.any():
            rows[-1].append(_both(clocks.drift[c] * 1e6, clocks.drift_sigma[c] * 1e6, 0))
    columns = ("camera", "stamps late by, ms", "in frames", "running fast by, ppm")
    terminal.table(f"clocks, against {names[0]}", columns[: len(rows[0])], rows)


def _both(value: float, sigma: float, digits: int) -> str:
    return f"{value:+.{digits}f} ± {sigma:.{digits}f}"


def write_clocks(path: Path, names: Sequence[str], clocks: ClockEstimate | None, terminal: Terminal) -> Path | None:
    """The clock offsets that were found, as settings that `posefuse track` reads; a rig file cannot carry them.

    Returns None when the cameras were synchronised, or there are settings already.
    """
    text = "" if clocks is None else clock_settings(names, clocks)
    if not text:
        _warn_of_old_clocks(path, names, terminal)
        return None
    if path.exists():
        terminal.warn(f"{path} exists and is left as it is; add the clock offsets found to it:\n{text}")
        return None
    write_text(path, text)
    terminal.note(f"{path}: clock offsets of the cameras, for `posefuse track` of recordings made together with these")
    return path


def _warn_of_old_clocks(path: Path, names: Sequence[str], terminal: Terminal) -> None:
    """Warn where clock offsets of another recording would be applied to cameras that are synchronised."""
    if not path.exists():
        return
    old = read_config(path).cameras
    stale = [name for name in names if name in old and (old[name].offset_s or old[name].drift_ppm)]
    if stale:
        terminal.warn(
            f"{path} holds clock offsets of {', '.join(stale)}, but these cameras are synchronised: `posefuse track` would"
            " shift them; remove offset_s and drift_ppm there, or the file"
        )
