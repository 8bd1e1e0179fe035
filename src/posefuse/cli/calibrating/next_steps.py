"""After a check that fails: the command to type next, by what failed."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from posefuse.calibration.report import CalibrationReport


@dataclass(frozen=True, kw_only=True)
class Asked:
    """What the refused command was asked for, as it is typed.

    Attributes:
        step: of `posefuse calibrate`. inputs: recordings. target: its options. intrinsics: rig file with the lenses; None where
            the step has none. out: the file it writes; None where it writes none.
    """

    step: str
    inputs: Sequence[str]
    target: str = ""
    intrinsics: Path | None = None
    out: Path | None = None

    def again(self, *more: str) -> str:
        """The same command, with more options."""
        words = ["posefuse calibrate", self.step, self.target, *more]
        words += [f"--intrinsics {self.intrinsics}"] if self.intrinsics is not None else []
        words += [f"--out {self.out}"] if self.out is not None else []
        return " ".join([*(word for word in words if word), *self.inputs])


# the first entry whose expression is found in the first failed check wins; that is the cause, where it is known
_LENSES, _CLOCKS, _RECORD, _TURN, _CHECK = "lenses", "clocks", "record", "turn", "check"
_RULES = (
    (r"upside down", _TURN),
    (r"clocks? of .* (jumps|drift)|loses frames|stamps of|was moved|same video|stand still|moved between", _RECORD),
    (r"synchronised|clock|ms late", _CLOCKS),
    (r"intrinsics of|focal length|intrinsics fit|distortion of|principal point", _LENSES),
    (r"swapped|plausible size|described|mirrored|dictionary|marker ids|longer in one direction|stretched|bent", _CHECK),
)


def next_after(report: CalibrationReport, asked: Asked) -> tuple[str, str]:
    """The command to type after a refusal, and what it is good for."""
    said = f"{report.failed[0].name}: {report.failed[0].detail}"
    kind = next((kind for expression, kind in _RULES if re.search(expression, said)), _RECORD)
    if kind == _CLOCKS and asked.step in ("extrinsics", "person"):
        mode = "drift" if "drift" in report.failed[0].remedy else "offset"
        return asked.again(f"--clocks {mode}"), "estimates the clock of each camera"
    if kind == _LENSES and asked.step in ("extrinsics", "person"):
        return _intrinsics(asked), "the intrinsics of these cameras again, from a board shown to each of them"
    if kind == _TURN:
        cameras = re.search(r"upside down: ([^;]+)", said)
        names = [] if cameras is None else [f"--upside-down {name.strip()}" for name in cameras.group(1).split(",")]
        return asked.again(*names), "if these cameras hang upside down"
    if kind == _CHECK:
        return asked.again(), "after names, files or sizes are corrected as the line above states"
    return _record(asked), "a new recording, with everything still; then the same command with it"


def _intrinsics(asked: Asked) -> str:
    out = asked.intrinsics or "lenses.toml"
    return f"posefuse calibrate intrinsics --target BOARD.toml --out {out} --force " + " ".join(asked.inputs and ["SESSION"])


def _record(asked: Asked) -> str:
    if asked.step == "extrinsics":
        lenses = f" --intrinsics {asked.intrinsics}" if asked.intrinsics is not None else ""
        return f"posefuse calibrate guide {asked.target}{lenses} --source CAMERA=KIND:WHERE ... --record SESSION"
    return "posefuse record --source CAMERA=KIND:WHERE ... --out SESSION"
