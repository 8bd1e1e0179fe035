"""After a refusal: the command that is printed can be typed, and fits what failed."""

import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from posefuse.calibration.clocks.sync import ClockEstimate
from posefuse.calibration.report import CalibrationReport, Check, RefusedCalibration
from posefuse.cli.calibrating.inputs import clocks_beside, recordings_of
from posefuse.cli.calibrating.next_steps import Asked, next_after
from posefuse.cli.calibrating.showing import reported, write_clocks
from posefuse.cli.command_line import parse
from posefuse.cli.terminal import Terminal
from posefuse.core import InputError

ASKED = Asked(
    step="extrinsics", inputs=("cam01=a.mp4", "b.mp4"), target="--target cube.toml", intrinsics=Path("l.toml"), out=Path("r.toml")
)
FAILURES = {
    "cause: the intrinsics of cam01 are wrong: focal length would rather be -2.8%": "calibrate intrinsics",
    "cause: the clock of cam02 is off by +100 ms": "--clocks offset",
    "cause: the clock of cam02 jumps by +250 ms at 14 s": "--record SESSION",
    "cause: cam02 was moved at 15 s by 30 mm and 1.00 deg": "--record SESSION",
    "images are upright: upside down: cam01, b": "--upside-down cam01 --upside-down b",
    "rig has a plausible size: is --marker-mm 27 in mm?": "calibrate extrinsics --target cube.toml",
    "cameras are linked: b cannot be linked to cam01": "calibrate guide --target cube.toml --intrinsics l.toml",
}


@pytest.mark.parametrize(("failure", "words"), FAILURES.items())
def test_the_next_command_fits_the_failure_and_can_be_typed(failure: str, words: str) -> None:
    name, _, detail = failure.partition(": ")
    other = Check("corners fit", False, "spread of a corner coordinate 2 px", "blur, or clocks = offset")
    command, _ = next_after(CalibrationReport("extrinsics", (Check(name, False, detail), other)), ASKED)
    assert words in command
    assert parse([word for word in shlex.split(command)[1:] if word != "..."]) is not None


def test_a_clock_of_another_rate_is_followed_by_the_drift_that_the_line_names() -> None:
    line = Check("parts agree", False, "phone2 runs +12.4 ms later after 20 s than before", "another rate: try `drift=True`")
    command, _ = next_after(CalibrationReport("person", (line,)), replace(ASKED, step="person"))
    assert "--clocks drift" in command


def test_a_refusal_carries_its_next_command() -> None:
    report = CalibrationReport("extrinsics", (Check("cause", False, "cam02 was moved at 15 s"),))
    with pytest.raises(RefusedCalibration) as refused, reported(None, ASKED):
        report.require()
    assert refused.value.__notes__[0].startswith("next: posefuse calibrate guide")


def test_verification_reads_the_clocks_that_a_calibration_wrote(lab: Any, tmp_path: Path) -> None:
    path = tmp_path / "posefuse.toml"
    assert clocks_beside(path, lab.rig) == {}
    late = np.array([0.0, 0.12, -0.05, 0.0])
    write_clocks(path, lab.rig.names, ClockEstimate.known(late, 0.0), Terminal(as_json=True))
    assert clocks_beside(path, lab.rig) == {"cam01": 0.12, "cam02": -0.05}
    path.write_text("[cameras.cam01]\noffset_s = 0.1\ndrift_ppm = 20.0\n")
    with pytest.raises(InputError, match="the clock of cam01 drifts"):
        clocks_beside(path, lab.rig)


def test_a_session_folder_stands_for_its_videos(tmp_path: Path) -> None:
    (tmp_path / "videos").mkdir()
    with pytest.raises(InputError, match="expected videos"):
        recordings_of([str(tmp_path)])
    for name in ("cam02.mp4", "cam01.mp4", "cam01.json"):
        (tmp_path / "videos" / name).touch()
    found = recordings_of([str(tmp_path), f"other={tmp_path / 'x.mp4'}"])
    assert list(found) == ["cam01", "cam02", "other"]
    assert found["cam02"] == tmp_path / "videos" / "cam02.mp4"
