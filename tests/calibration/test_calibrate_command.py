"""`posefuse calibrate` from the outside: exit codes, one-line errors, reports and files."""

import json
import shlex
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from calibrating import marker_page, run
from checks import refusal
from commands import error

from posefuse.api import calibrate
from posefuse.api.calibrate import target_of
from posefuse.api.calibration_results import ClockCalibration, RigCalibration, save_clocks, saved_clocks
from posefuse.calibration.clocks.sync import ClockEstimate
from posefuse.calibration.extrinsics.world import with_floor
from posefuse.calibration.report import CalibrationReport, Check, RefusedCalibration
from posefuse.calibration.targets.detection import TargetDetector
from posefuse.calibration.targets.kinds import Charuco, Chessboard, Markers, Target, read_target, write_target
from posefuse.calibration.targets.printing import Sheet
from posefuse.cli.command_line import WrongCommandLineError, parse
from posefuse.core import CalibrationError, ConfigError, InputError
from posefuse.formats.page import write_page
from posefuse.formats.rig import read_rig, write_rig
from posefuse.foundation.settings import read_settings
from posefuse.pipeline.config import TrackConfig
from posefuse.sources import VideoConfig
from posefuse.sources.video import ticks_ns


def test_a_printed_file_is_replaced_on_request_only(tmp_path: Path) -> None:
    out = tmp_path / "cube.pdf"
    words = ("print", "--cube", "--out", str(out), "--marker-mm")
    assert run(*words, "120")["pages"] == 6
    before = out.read_bytes()
    assert before.startswith(b"%PDF-1.4")
    refusal(InputError, r"cube\.pdf already exists; choose another name, or add `replace=True`", run, *words, "100")
    run(*words, "100", "--force")
    [kept] = tmp_path.glob("cube.pdf.replaced-*")
    assert kept.read_bytes() == before != out.read_bytes()


@pytest.mark.parametrize("step", ["intrinsics", "extrinsics"])
def test_a_wrong_target_file_is_named_as_such(step: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    target = Charuco(columns=5, rows=7, square_m=0.05, marker_m=0.0375)
    page = np.pad(target.board().generateImage((250, 350)), 40, constant_values=255)
    for name in ("cam00", "cam01"):
        (tmp_path / name).mkdir()
        for i in range(3):
            cv2.imwrite(str(tmp_path / name / f"{i}.png"), np.roll(page, 2 * i, axis=1))
    file = write_target(tmp_path / "board.toml", replace(target, columns=6))
    words = ["calibrate", step, "--target", file, "--out", tmp_path / "rig.toml", "--report", tmp_path / "a.html"]
    shown = error(capsys, *words, tmp_path / "cam00", tmp_path / "cam01")
    assert "not as described: count columns and rows" in shown and "the target file states" not in shown
    assert "not as described" in (tmp_path / "a.html").read_text()


PERSON = "person --intrinsics lenses.toml --out rig.toml"


@pytest.mark.parametrize(
    ("words", "error", "reason"),
    [
        ("print --cube --out face.pdf", InputError, "target markers: missing `marker_mm=MM`"),
        ("print --cube --marker-mm 120 --out none/cube.pdf", InputError, r"out .*: there is no folder .*none"),
        ("print --square-mm 30 --marker-mm 20 --out a.pdf", InputError, "target charuco: missing `columns=N`, `rows=N`"),
        (
            "print --target chessboard --columns 5 --rows 7 --square-mm 30 --out a.pdf",
            WrongCommandLineError,
            'Choose from: "charuco", "markers"',
        ),
        (f"{PERSON} --height-m 1.8 cam00.mp4", InputError, "expected at least 2 cameras, got 1"),
        (f"{PERSON} --height-m 1.8 cam00.mp4 cam01=none.mp4", InputError, r"no such file or folder: .*none\.mp4"),
        (f"{PERSON} cam00.mp4 cam01=cam00.mp4", InputError, "one known length: `height_m=METRES`, or `camera_distance="),
        (f"{PERSON} --height-m -1 cam00.mp4", WrongCommandLineError, "--height-m: expected a number > 0 and <= 3, got -1"),
        (f"{PERSON} --apart cam00 cam01 -1 cam00.mp4 cam01=cam00.mp4", CalibrationError, "expected a length > 0 m, got -1"),
        (f"{PERSON} --apart cam00 cam09 3 cam00.mp4 cam01=cam00.mp4", CalibrationError, "no camera 'cam09'"),
        (f"{PERSON} --height-m 1.8 cam00.mp4 cam01=poses", InputError, "got both"),
        (f"{PERSON} --height-m 1.8 cam01=poses cam02=poses", InputError, "add `rate_hz=HZ`"),
        (f"{PERSON} --height-m 1.8 cam00.mp4 cam01=.", InputError, "lies inside the input"),
        ("intrinsics --target b.toml --out r.toml --report none/file a.mp4", InputError, "--report "),
        ("intrinsics --target board.toml --out r.toml cam=none.mp4", InputError, "no such video or folder of images"),
        ("intrinsics --target board.toml --out lenses.yml cam00.mp4", InputError, "--out lenses.yml: a rig file is TOML"),
        ("extrinsics --target chess.toml --out rig.toml cam00.mp4", CalibrationError, "looks the same from both ends"),
        ("verify --target chess.toml --rig lenses.toml cam00.mp4", CalibrationError, "looks the same from both ends"),
        ("guide --target chess.toml --source cam00=video:cam00.mp4", CalibrationError, "looks the same from both ends"),
    ],
)
def test_what_is_wrong_with_a_command_is_reported_before_any_work(
    lab: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: str, error: type[Exception], reason: str
) -> None:
    write_rig(tmp_path / "lenses.toml", lab.rig)
    write_target(tmp_path / "cube.toml", Markers(0.12))
    write_target(tmp_path / "chess.toml", Chessboard(8, 6, 0.03))
    write_target(tmp_path / "board.toml", Charuco(columns=5, rows=7, square_m=0.05, marker_m=0.0375))
    (tmp_path / "cam00.mp4").touch()
    (tmp_path / "poses").mkdir()
    before = sorted(tmp_path.iterdir())
    monkeypatch.chdir(tmp_path)
    refusal(error, reason, lambda: run(*words.split()))
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.slow
def test_lenses_and_places_from_real_footage(shared_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = shared_data / "caliscope" / "post_optimization"
    videos = [str(folder / "calibration" / "extrinsic" / f"cam_{i}.mp4") for i in range(4)]
    charuco = Charuco(columns=4, rows=5, square_m=0.054, marker_m=0.0405, dictionary="DICT_4X4_1000", inverted=True)
    board = ("--target", str(write_target(tmp_path / "board.toml", charuco)))
    lenses, rig, page = str(folder / "camera_array.toml"), tmp_path / "rig.toml", tmp_path / "report.html"
    figures = run("extrinsics", *board, "--intrinsics", lenses, "--out", str(rig), "--report", str(page), *videos)
    json.dumps(figures)
    assert read_rig(rig).names == ("cam_0", "cam_1", "cam_2", "cam_3")
    text = page.read_text()
    assert "extrinsics: passed" in text
    assert text.count("data:image/jpeg;base64,") == 4
    assert (tmp_path / "posefuse.toml").is_file()
    assert run("verify", *board, "--rig", str(rig), *videos)["length_rms_mm"] < 1.2
    refused = tmp_path / "refused.toml"
    # it ran at 10 Hz and was read at 6 Hz
    with pytest.raises(RefusedCalibration, match="the time stamps of cam_1 are irregular"):
        out = ("--out", str(refused), "--report", str(refused.with_suffix(".html")))
        run("extrinsics", *board, "--intrinsics", lenses, "--clocks", "together", *out, *videos)
    assert not refused.exists()
    assert "extrinsics: refused: cause" in refused.with_suffix(".html").read_text()


def test_clocks_reach_the_settings_of_track_and_never_overwrite_them(lab: Any, tmp_path: Path) -> None:
    late_s, path = np.array([0.0, 0.12, -0.05, 0.031]), tmp_path / "posefuse.toml"
    assert save_clocks(path, lab.rig.names, ClockEstimate.known(0 * late_s, 0.0)) is None and not path.exists()
    found = ClockEstimate.known(late_s, 0.0)
    assert save_clocks(path, lab.rig.names, found) == path
    read = read_settings(path, TrackConfig)
    assert [read.cameras[name].offset_s for name in lab.rig.names] == (-late_s).tolist()
    path.write_text("raw = true\n")
    with pytest.warns(UserWarning, match="offset_s = -0.120000"):
        assert save_clocks(path, lab.rig.names, found) is None
    assert path.read_text() == "raw = true\n"


@pytest.mark.parametrize(
    ("late_s", "kept", "purpose"),
    [
        (0.0, "", "the clocks need no correction"),
        (0.1, "", "uses the clocks found"),
        (0.1, "raw = true\n", "add the offsets to SESSION/posefuse.toml first"),
    ],
)
def test_the_last_line_of_calibrate_clocks_agrees_with_its_table(
    lab: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any, late_s: float, kept: str, purpose: str
) -> None:
    late = ClockEstimate.known(late_s * np.eye(len(lab.rig))[1], 0.0)
    found = ClockCalibration(rig=lab.rig, clocks=late, report=CalibrationReport("clocks", ()))
    monkeypatch.setattr("posefuse.calibrate_clocks", lambda *_, **__: found)
    if kept:
        (tmp_path / "posefuse.toml").write_text(kept)
    run("clocks", str(tmp_path))
    assert purpose.replace("SESSION", str(tmp_path)) in capsys.readouterr().err.splitlines()[-1]


def test_the_next_command_after_clocks_reads_what_the_clocks_were_found_in(
    lab: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    """It had the session only, where the calibration file lies elsewhere, and 2D poses have no frame rate."""
    write_rig(rig_file := tmp_path / "the rig.toml", lab.rig)
    known = ClockEstimate.known(0.1 * np.eye(len(lab.rig))[1], 0.0)
    found = ClockCalibration(rig=lab.rig, clocks=known, report=CalibrationReport("clocks", ()))
    monkeypatch.setattr("posefuse.calibrate_clocks", lambda *_, **__: found)
    given = ["--rig", str(rig_file), "--rate", "50", "--input", "pose2d", "--networks", "blazepose_lite"]
    run("clocks", str(tmp_path), *given, "--seconds", "20", "--clocks", "drift")
    command, _, _ = capsys.readouterr().err.splitlines()[-1].removeprefix("next: posefuse ").rpartition("  (")
    typed = parse(shlex.split(command)).bound.arguments
    assert typed["session"] == tmp_path
    asked = parse(["track", str(tmp_path), *given, "--out", "RESULT"]).bound.arguments
    assert typed["options"].changes == asked["options"].changes


def test_images_of_a_person_are_named_as_what_is_not_read(tmp_path: Path, lab: Any) -> None:
    """They were taken for 2D poses: first a rate was asked for, then no format of 2D poses was recognised."""
    write_rig(tmp_path / "lenses.toml", lab.rig)
    for name in ("cam00", "cam01"):
        (tmp_path / name).mkdir()
        cv2.imwrite(str(tmp_path / name / "1.png"), np.zeros((8, 8), np.uint8))
    given = [f"{name}={tmp_path / name}" for name in ("cam00", "cam01")]
    words = [*given, "--intrinsics", str(tmp_path / "lenses.toml"), "--height-m", "1.8", "--out", str(tmp_path / "r.toml")]
    refusal(InputError, r"expected videos or 2D poses, got images: .*cam00.*; make a video of each", run, "person", *words)


def test_clocks_of_a_person_go_where_the_rig_goes(lab: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    """The last line named the rig file alone, though the clocks lie next to it; and it was not the last line."""
    known = ClockEstimate.known(0.1 * np.eye(len(lab.rig))[1], 0.0)
    found = RigCalibration(rig=lab.rig, report=CalibrationReport("person", ()), clocks=known)
    monkeypatch.setattr("posefuse.calibrate_person", lambda *_, **__: found)
    write_rig(tmp_path / "lenses.toml", lab.rig)
    run("person", "walk", "--intrinsics", str(tmp_path / "lenses.toml"), "--height-m", "1.8", "--out", str(tmp_path / "r.toml"))
    last = capsys.readouterr().err.splitlines()[-1]
    assert last.startswith(f"next: put {tmp_path / 'r.toml'} and {tmp_path / 'posefuse.toml'} into the folder of your videos")


def test_a_drifting_clock_is_set_right_by_the_settings_written(lab: Any, tmp_path: Path) -> None:
    offset, drift, middle = 0.12, -2e-4, 40.0
    second = np.eye(4)[1]
    found = ClockEstimate(offset * second, drift * second, 0 * second, 0 * second, middle)
    path = save_clocks(tmp_path / "posefuse.toml", lab.rig.names, found)
    assert path is not None
    read = read_settings(path, TrackConfig).cameras["cam01"]
    video = VideoConfig(tmp_path / "a.mp4", "cam01", offset_s=read.offset_s, drift_ppm=read.drift_ppm)
    for stamp_s in (2, 77):
        taken_s = stamp_s - offset - drift * (stamp_s - middle)
        assert ticks_ns(video, stamp_s, Fraction(1)) / 1e9 == pytest.approx(taken_s, abs=2e-6)


def test_a_report_shows_remedies_only_for_what_failed(read_page: Any, tmp_path: Path, ring_rig: Any) -> None:
    good, bad = Check("a", True, "fine <1>", "not shown"), Check("b", False, "broken", "do this")
    report, rig = CalibrationReport("thing", (good, bad), ("left out",), {"n": 3.0}), ring_rig(3)
    images = {"heat <b>": np.zeros((8, 8, 3), np.uint8)}
    page = read_page(write_page(tmp_path / "r.html", report.page(images, rig)))
    assert page.headings[0] == "thing: refused: b" and "left out" in page.text
    assert page.tables[0][1:] == [["pass", "a", "fine <1>"], ["FAIL", "b", "broken; do this"]]
    assert page.classes == {"pass": "good", "FAIL": "bad"} and "not shown" not in page.text
    assert page.tables[1][1:] == [["n", "3"]] and len(page.images) == 1
    [cameras] = [one for one in page.plot("Plan of the cameras")["series"] if one["name"] == "cameras"]
    np.testing.assert_allclose(np.stack([cameras["x"], cameras["y"]], axis=1), rig.centres_world()[:, :2], atol=1e-3)
    assert [label.split()[0] for label in cameras["labels"]] == list(rig.names)
    bare = read_page(write_page(tmp_path / "bare.html", CalibrationReport("thing", (good,)).page()))
    assert bare.headings == ["thing: passed", "Checks"]
    refusal(RefusedCalibration, "thing: b: broken; do this", lambda: CalibrationReport("thing", (good, bad)).require())


# --- the target file: what `print` writes is what every step takes, and what is wrong in it is named


TARGETS: tuple[Target, ...] = (
    Markers(0.1205, "DICT_5X5_100", (3, 4, 7), True),
    Charuco(columns=5, rows=7, square_m=0.05, marker_m=0.0375, dictionary="DICT_4X4_100", inverted=True, legacy=True),
    Chessboard(8, 6, 0.031),
)


@pytest.mark.parametrize("target", TARGETS, ids=lambda target: type(target).__name__)
def test_a_target_file_gives_the_same_target_again(target: Target, tmp_path: Path) -> None:
    path = write_target(tmp_path / "target.toml", target)
    assert read_target(path) == target == target_of(str(path)) == target_of(target)


def test_printing_writes_the_file_and_the_other_steps_take_it(tmp_path: Path) -> None:
    out, described = tmp_path / "board.pdf", tmp_path / "board.toml"
    words = ["print", "--columns", "5", "--rows", "7", "--square-mm", "50", "--marker-mm", "37.5", "--page", "a3", "--out"]
    assert run(*words, str(out))["target"] == str(described)
    assert read_target(described) == Charuco(columns=5, rows=7, square_m=0.05, marker_m=0.0375)
    refusal(InputError, r"board\.toml already exists", run, *words, str(tmp_path / "board.ps"))


def test_a_cube_is_printed_with_the_ids_that_its_file_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """For a second cube: its file had the ids asked for, its pages 0 to 5, of which the other steps then saw nothing."""
    printed: list[Sheet] = []
    monkeypatch.setattr("posefuse.api.targets.write_pdf", lambda path, sheets: printed.extend(sheets) or path.touch())
    words = ["print", "--cube", "--marker-mm", "120", "--out"]
    run(*words, str(tmp_path / "second.pdf"), "--ids", "10,11,12,13,14,15")
    captions = " ".join(sheet.caption for sheet in printed)
    assert read_target(tmp_path / "second.toml") == Markers(0.12, ids=tuple(range(10, 16)))
    assert len(printed) == 6 and all(f"marker {one}," in captions for one in range(10, 16))
    refusal(InputError, "a cube has 6 markers, got 1", run, *words, str(tmp_path / "one.pdf"), "--ids", "40")


def test_the_file_of_a_printed_target_names_its_markers(tmp_path: Path) -> None:
    """Without ids, `verify` took a floor marker of another size as part of the cube: lengths were 214 mm off."""
    run("print", "--cube", "--marker-mm", "120", "--out", str(tmp_path / "cube.pdf"))
    assert read_target(tmp_path / "cube.toml") == Markers(0.12, ids=(0, 1, 2, 3, 4, 5))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('kind = "charuco"\ncolumns = 5\nrows = 7\nsquare_mm = 50.0\n', r"target\.toml: charuco: missing marker_mm"),
        ('kind = "markers"\nmarker_cm = 12\n', r"target\.toml: unknown key 'marker_cm'; there are: .*marker_mm"),
        ("[cameras]\n", r"target\.toml: not a target file: expected kind = markers, charuco"),
        (None, r"target\.toml: no such file"),
    ],
)
def test_what_is_wrong_with_a_target_file_is_named(tmp_path: Path, text: str | None, words: str) -> None:
    path = tmp_path / "target.toml"
    if text is not None:
        path.write_text(text)
    refusal(ConfigError, words, read_target, path)


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        ("--cube --marker-mm 120 --ids 48,49,50", "markers 0 to 49, this target needs 48 to 50"),
        ("--cube --marker-mm 120 --ids 3,4,3", "ids: expected each once, got 3, 4, 3"),
        ("--columns 12 --rows 12 --square-mm 50 --marker-mm 37", "this target needs 0 to 71"),
        ("--columns 1 --rows 7 --square-mm 50 --marker-mm 37", "columns: expected at least 2, got 1"),
        ("--columns 5 --rows 7 --square-mm 50 --marker-mm 60", "60 mm: expected less than .* 50 mm"),
    ],
)
def test_a_target_that_cannot_be_is_not_printed(words: str, reason: str, tmp_path: Path) -> None:
    refusal(ConfigError, reason, run, "print", *words.split(), "--page", "a0", "--out", str(tmp_path / "target.pdf"))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("step", ["extrinsics", "intrinsics"])
def test_a_target_file_is_not_replaced_by_the_result(tmp_path: Path, step: str) -> None:
    target = write_target(tmp_path / "cube.toml", Markers(0.12))
    before = target.read_bytes()
    words = (step, "--target", str(target), "--force", "--out", str(target), f"cam={tmp_path / 'none.mp4'}")
    refusal(InputError, r"cube\.toml", run, *words)
    assert target.read_bytes() == before


def test_a_floor_marker_is_looked_for_with_the_ids_of_a_target(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    looked_for: list[Target] = []

    def stop(sources: object, target: Target, *_: object) -> None:
        looked_for.append(target)
        raise KeyboardInterrupt

    monkeypatch.setattr(calibrate, "observe_sources", stop)
    monkeypatch.setattr(calibrate, "open_sources", lambda inputs: [])
    target = Markers(0.12, ids=(3, 4, 7))
    with pytest.raises(KeyboardInterrupt):
        calibrate.calibrate_extrinsics([], target=target, floor_marker=40)
    with pytest.raises(KeyboardInterrupt):
        described = str(write_target(tmp_path / "cube.toml", target))
        run("extrinsics", "--target", described, "--floor-marker", "40", "--out", str(tmp_path / "rig.toml"), "a.mp4")
    assert [one.ids for one in looked_for if isinstance(one, Markers)] == [(3, 4, 7, 40)] * 2
    page = marker_page(40)[..., 0]
    assert set(TargetDetector(with_floor(target, 40)).detect(page).patch) == {40}
    words = "markers 0 to 49, this target needs 60"
    refusal(ConfigError, words, calibrate.calibrate_extrinsics, [], target=Markers(0.12), floor_marker=60)


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
