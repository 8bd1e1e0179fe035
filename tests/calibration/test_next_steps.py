"""After a refusal: the command that is printed can be typed, and fits what failed."""

import shlex
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, get_args

import numpy as np
import pytest
from calibrating import marker_page, run
from checks import refusal

import posefuse as pf
from posefuse.api.calibration_results import save_clocks, saved_clocks
from posefuse.calibration.clocks.sync import ClockEstimate
from posefuse.calibration.report import CalibrationReport, Check, CheckKind, RefusedCalibration
from posefuse.calibration.targets.kinds import Charuco, Markers, write_target
from posefuse.cli.asked import Asked, next_after
from posefuse.cli.command_line import parse
from posefuse.cli.terminal import Terminal
from posefuse.core import InputError, Rig
from posefuse.core.frames import Pixels
from posefuse.formats.kept_video import KeptVideo
from posefuse.formats.rig import write_rig

STEPS = {
    "intrinsics": "--target {f}/board.toml --every 3 --out {f}/new.toml",
    "extrinsics": "--target {f}/cube.toml --intrinsics {f}/lenses.toml --floor-marker 40 --floor-side-mm 150 --refine-lenses 0.5"
    " --every 2 --upside-down b --any-size --out {f}/new.toml",
    "person": "--intrinsics {f}/lenses.toml --apart a b 3.42 --most-s 5 --upside-down b --networks blazepose_lite"
    " --out {f}/new.toml",
    "clocks": "--rig {f}/rig.toml --seconds 20 --most-s 3",
    "verify": "--target {f}/board.toml --rig {f}/rig.toml --offset-ms a=5 --every 4",
}
# what is printed after each kind of refusal, where it is not a new recording
PRINTED = {
    ("extrinsics", "clocks"): "--clocks offset",
    ("person", "clocks"): "--clocks offset",
    ("extrinsics", "drift"): "--clocks drift",
    ("person", "drift"): "--clocks drift",
    ("clocks", "drift"): "--clocks drift",
    ("extrinsics", "lenses"): "calibrate intrinsics SESSION --target BOARD.toml --out",
    ("person", "lenses"): "calibrate intrinsics SESSION --target BOARD.toml --out",
    ("extrinsics", "upside down"): "--upside-down b --upside-down a",
    ("person", "upside down"): "--upside-down b --upside-down a",
    ("extrinsics", "record"): "calibrate guide --target",
    ("verify", "rig"): "calibrate guide --target CUBE.toml --intrinsics",
}


class ArrivedError(Exception):
    """The command was understood, its files were opened, and the calculation began."""


@dataclass
class Room:
    """A folder with all that the commands take; calculations refuse for what is set, or tell that they were reached."""

    folder: Path
    refusal: Check | None = None
    asked: list[dict[str, Any]] = field(default_factory=list)

    def calculate(self, *given: Any, **options: Any) -> Any:
        self.asked.append({name: value for name, value in options.items() if name not in ("progress", "coverage", "intrinsics")})
        if self.refusal is None:
            raise ArrivedError
        report = CalibrationReport("test", (self.refusal,))
        if "clock_offset_s" in options:
            return SimpleNamespace(report=report, save=lambda path, replace: path.write_text("refused"))
        raise RefusedCalibration(report)

    def printed_after(self, step: str, kind: CheckKind) -> str:
        """The next command, as it is typed."""
        self.refusal = Check("one", False, "is wrong", kind=kind, cameras=("a",) if kind == "upside down" else ())
        (self.folder / "report.html").unlink(missing_ok=True)
        options = STEPS[step].format(f=self.folder).split()
        with pytest.raises(RefusedCalibration) as refused:
            run(step, str(self.folder), *options, "--report", str(self.folder / "report.html"))
        command, _, _ = refused.value.__notes__[-1].removeprefix("next: ").rpartition("  (")
        return command

    def typed(self, command: str) -> list[str]:
        """The command with the placeholders as a user replaces them."""
        sources = " ".join(f"--source {name}=video:{self.folder}/videos/{name}.mp4" for name in "ab")
        command = command.replace("--source CAMERA=KIND:WHERE ...", sources)
        for out in ("--out SESSION", "--record SESSION"):
            command = command.replace(out, f"{out.split()[0]} {self.folder}/recorded-{len(list(self.folder.iterdir()))}")
        for name, path in (("SESSION", ""), ("BOARD.toml", "board.toml"), ("CUBE.toml", "cube.toml")):
            command = command.replace(f" {name}", f" {self.folder}/{path}")
        return shlex.split(command)[1:]


@pytest.fixture
def room(tmp_path: Path, ring_rig: Any, monkeypatch: pytest.MonkeyPatch) -> Room:
    (tmp_path / "videos").mkdir()
    for name in "ab":
        with KeptVideo(tmp_path / "videos" / f"{name}.mp4") as video:
            for i in range(12):
                video.write(Pixels(np.roll(marker_page(), 2 * i, axis=1)), i * 50_000_000)
    rig = Rig(tuple(replace(camera, name=name) for camera, name in zip(ring_rig(2), "ab", strict=True)))
    write_rig(tmp_path / "rig.toml", rig)
    write_rig(tmp_path / "lenses.toml", rig)
    write_target(tmp_path / "cube.toml", Markers(0.1, ids=(1, 2, 3)))
    write_target(tmp_path / "board.toml", Charuco(columns=5, rows=7, square_m=0.1, marker_m=0.075))
    made = Room(tmp_path)
    for step in ("intrinsics", "extrinsics", "person", "clocks"):
        monkeypatch.setattr(pf, f"calibrate_{step}", made.calculate)
    monkeypatch.setattr(pf, "verify", made.calculate)
    return made


@pytest.mark.realtime
@pytest.mark.parametrize("step", STEPS)
def test_every_printed_command_runs_as_printed_and_keeps_what_was_asked_for(room: Room, step: str) -> None:
    """A new recording is made for each step once: every kind of refusal prints the same command for it."""
    ran = set()
    for kind in get_args(CheckKind):
        command = room.printed_after(step, kind)
        assert PRINTED.get((step, kind), "") in command
        typed = room.typed(command)
        room.refusal = None
        if typed[0] == "record" or typed[1] == "guide":
            if command not in ran:
                assert parse(typed).run(Terminal(as_json=True))["exit_code"] == 0
                ran.add(command)
            continue
        with pytest.raises(ArrivedError):
            run(*typed[1:])
        if typed[1] == step:
            changed = {"clocks", "drift", "upside_down"}
            first, second = ({name: one[name] for name in one.keys() - changed} for one in room.asked[-2:])
            assert first == second
            others = [name for name in changed & room.asked[-1].keys() if room.asked[-2][name] != room.asked[-1][name]]
            assert len(others) == (kind not in ("input", "record"))


def test_clocks_that_were_estimated_already_are_not_advised_again() -> None:
    line = "calibrate person walk --intrinsics l.toml --clocks offset --height-m 1.8 --out r.toml"
    parsed = parse(line.split())
    asked = Asked(step="person", inputs=("walk",), options=parsed.bound.arguments["options"])
    for kind, words in (("clocks", "posefuse record"), ("drift", "--height-m 1.8 --clocks drift")):
        report = CalibrationReport("person", (Check("clocks", False, "differ", kind=kind),))
        assert words in next_after(report, asked)[0]


def test_verification_reads_the_clocks_that_a_calibration_wrote(lab: Any, tmp_path: Path) -> None:
    path = tmp_path / "posefuse.toml"
    assert saved_clocks(path, lab.rig) == {}
    late = np.array([0.0, 0.12, -0.05, 0.0])
    save_clocks(path, lab.rig.names, ClockEstimate.known(late, 0.0))
    assert saved_clocks(path, lab.rig) == {"cam01": 0.12, "cam02": -0.05}
    path.write_text("[cameras.cam01]\noffset_s = 0.1\ndrift_ppm = 20.0\n")
    refusal(InputError, "the clock of cam01 drifts", saved_clocks, path, lab.rig)
    # `verify` left them out without a word, and found the clock of cam01 wrong; `track` refuses them
    path.write_text("[cameras.cam_01]\noffset_s = -0.1\n")
    refusal(InputError, "no camera cam_01 in the rig; there are: cam00, cam01", saved_clocks, path, lab.rig)
