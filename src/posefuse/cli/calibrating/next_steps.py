"""After a check that fails: the command to type next, by what mends it."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from posefuse.calibration.report import CalibrationReport

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
