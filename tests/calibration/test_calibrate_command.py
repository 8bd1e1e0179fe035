"""`posefuse calibrate` from the outside: exit codes, one-line errors, reports and files."""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from calibrating import run

from posefuse.api.calibration_results import ClockCalibration, save_clocks
from posefuse.calibration.clocks.sync import ClockEstimate
from posefuse.calibration.extrinsics.world import read_floor_points
from posefuse.calibration.report import CalibrationReport, Check, RefusedCalibration
from posefuse.calibration.result_files import calibration_page
from posefuse.calibration.targets.coverage import coverage, coverage_sheet
from posefuse.calibration.targets.kinds import Charuco, Markers, write_target
from posefuse.cli.command_line import WrongCommandLineError
from posefuse.core import CalibrationError, ConfigError, InputError
from posefuse.formats.page import write_page
from posefuse.formats.rig import read_rig, write_rig
from posefuse.foundation.settings import read_settings
from posefuse.pipeline.config import TrackConfig
from posefuse.sources import ImagesConfig


def test_printing_without_sizes_names_the_missing_ones(tmp_path: Path) -> None:
    out = str(tmp_path / "cube.pdf")
    with pytest.raises(InputError, match="target markers: missing `marker_mm=MM`"):
        run("print", "--cube", "--out", out)
    assert run("print", "--cube", "--marker-mm", "120", "--out", out)["pages"] == 6
    assert (tmp_path / "cube.pdf").read_bytes().startswith(b"%PDF-1.4")
    with pytest.raises(InputError, match=r"cube\.pdf already exists; choose another name, or add `replace=True`"):
        run("print", "--cube", "--marker-mm", "100", "--out", out)
    before = (tmp_path / "cube.pdf").read_bytes()
    run("print", "--cube", "--marker-mm", "100", "--out", out, "--force")
    [kept] = tmp_path.glob("cube.pdf.replaced-*")
    assert kept.read_bytes() == before != (tmp_path / "cube.pdf").read_bytes()
    with pytest.raises(InputError, match="a plain chessboard is not offered"):
        run("print", "--target", "chessboard", "--columns", "5", "--rows", "7", "--square-mm", "30", "--out", f"{out}.pdf")


def test_three_marked_points_are_read_and_a_wrong_key_is_named(tmp_path: Path) -> None:
    path = tmp_path / "floor.toml"
    marked = "[cameras.a]\norigin = [10, 20]\nx = [30.5, 20]\ny = [12, 5]\n[cameras.b]\nx = [7, 8]\n"
    marked += "[cameras.c]\norigin = [3, 4]\ny = [5, 6]\n"
    path.write_text(f"origin_to_x_m = 1.5\n{marked}")
    rule = read_floor_points(path)
    assert rule.origin_to_x_m == 1.5
    np.testing.assert_array_equal(rule.xy_img["a"], [[10, 20], [30.5, 20], [12, 5]])
    assert np.isnan(rule.xy_img["b"]).tolist() == [[True, True], [False, False], [True, True]]
    path.write_text(marked.replace("y = [5, 6]", ""))
    with pytest.raises(ConfigError, match=r"floor\.toml: y: expected to be marked in 2 cameras or more, got 1"):
        read_floor_points(path)
    path.write_text("[cameras.a]\norigo = [10, 20]\n")
    with pytest.raises(ConfigError, match=r"floor\.toml.*origo"):
        read_floor_points(path)


def test_a_person_needs_one_length_and_one_kind_of_input(tmp_path: Path, lab: Any) -> None:
    lenses, film = tmp_path / "lenses.toml", tmp_path / "cam00.mp4"
    write_rig(lenses, lab.rig)
    film.touch()
    person, both = ("person", "--intrinsics", str(lenses), "--out", str(tmp_path / "rig.toml")), (str(film), f"cam01={film}")
    with pytest.raises(InputError, match="expected at least 2 cameras, got 1"):
        run(*person, "--height-m", "1.8", str(film))
    with pytest.raises(InputError, match=r"no such file or folder: .*none\.mp4"):
        run(*person, "--height-m", "1.8", str(film), "cam01=none.mp4")
    with pytest.raises(InputError, match="one known length: `height_m=METRES`, or `camera_distance="):
        run(*person, *both)
    with pytest.raises(WrongCommandLineError, match=r'--apart: unable to convert "far" into float'):
        run(*person, "--apart", "cam00", "cam01", "far", *both)
    with pytest.raises(WrongCommandLineError, match="--height-m: expected a number > 0 and <= 3, got -1"):
        run(*person, "--height-m", "-1", *both)
    with pytest.raises(CalibrationError, match="expected a length > 0 m, got -1"):
        run(*person, "--apart", "cam00", "cam01", "-1", *both)
    with pytest.raises(CalibrationError, match="no camera 'cam09'"):
        run(*person, "--apart", "cam00", "cam09", "3", *both)
    poses = tmp_path / "poses"
    poses.mkdir()
    with pytest.raises(InputError, match="got both"):
        run(*person, "--height-m", "1.8", str(film), f"cam01={poses}")
    with pytest.raises(InputError, match="add `rate_hz=HZ`"):
        run(*person, "--height-m", "1.8", f"cam01={poses}", f"cam02={poses}")
    with pytest.raises(InputError, match="lies inside the input"):
        run(*person, "--height-m", "1.8", str(film), f"cam01={tmp_path}")


def test_a_folder_that_is_not_there_is_named_before_any_work(tmp_path: Path) -> None:
    nowhere = tmp_path / "none" / "file"
    with pytest.raises(InputError, match=r"out .*: there is no folder .*none"):
        run("print", "--cube", "--marker-mm", "120", "--out", str(nowhere))
    with pytest.raises(InputError, match="--report "):
        run("intrinsics", "--target", "b.toml", "--out", str(tmp_path / "r.toml"), "--report", str(nowhere), "a.mp4")


def test_what_is_wrong_with_the_floor_is_reported_before_any_look(tmp_path: Path, lab: Any) -> None:
    lenses = tmp_path / "lenses.toml"
    write_rig(lenses, lab.rig)
    target = str(write_target(tmp_path / "cube.toml", Markers(0.12)))
    extrinsics = ("extrinsics", "--target", target, "--intrinsics", str(lenses), "--out", str(tmp_path / "rig.toml"))
    with pytest.raises(ConfigError, match=r"none\.toml: no such file"):
        run(*extrinsics, "--floor-points", str(tmp_path / "none.toml"), "cam00=none.mp4")
    with pytest.raises(InputError, match="one of the two sets the world"):
        run(*extrinsics, "--floor-points", "a.toml", "--floor-marker", "7", "cam00=none.mp4")


def test_inputs_that_are_not_there_are_named(tmp_path: Path) -> None:
    board = ("--target", str(write_target(tmp_path / "b.toml", Charuco(columns=5, rows=7, square_m=0.05, marker_m=0.0375))))
    with pytest.raises(InputError, match="no such video or folder of images"):
        run("intrinsics", *board, "--out", str(tmp_path / "r.toml"), f"cam={tmp_path / 'none.mp4'}")


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
    assert text.count("data:image/png;base64,") == 4
    offsets = [f"--offset-ms=cam_{i}={figures[f'cam_{i}_offset_ms']}" for i in range(4)]
    assert run("verify", *board, "--rig", str(rig), *offsets, *videos)["length_rms_mm"] < 1.2
    refused = tmp_path / "refused.toml"
    with pytest.raises(RefusedCalibration, match=r"the clock of cam_1 is off by \+1\d\d ms"):
        run(
            "extrinsics",
            *board,
            "--intrinsics",
            lenses,
            "--clocks",
            "together",
            "--out",
            str(refused),
            "--report",
            str(refused.with_suffix(".html")),
            *videos,
        )
    assert not refused.exists()
    assert "extrinsics: refused: cause" in refused.with_suffix(".html").read_text()


@pytest.mark.parametrize(("late_s", "settings"), [((0.0, 0.0, 0.0, 0.0), False), ((0.0, 0.12, -0.05, 0.031), True)])
def test_clocks_reach_the_settings_of_track_and_never_overwrite_them(
    lab: Any, tmp_path: Path, late_s: tuple[float, ...], settings: bool
) -> None:
    found, settings_file = ClockEstimate.known(np.array(late_s), 0.0), tmp_path / "posefuse.toml"
    path = save_clocks(settings_file, lab.rig.names, found)
    assert (path is not None) == settings
    if path is None:
        return
    read = read_settings(path, TrackConfig)
    assert [read.cameras[name].offset_s for name in lab.rig.names] == [-s for s in late_s]
    path.write_text("raw = true\n")
    with pytest.warns(UserWarning, match="offset_s = -0.120000"):
        assert save_clocks(settings_file, lab.rig.names, found) is None
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
    lab: Any,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    late_s: float,
    kept: str,
    purpose: str,
) -> None:
    late = ClockEstimate.known(late_s * np.eye(len(lab.rig))[1], 0.0)
    report = CalibrationReport("clocks", ())
    found = ClockCalibration(rig=lab.rig, clocks=late, report=report, frame_period_s=(0.04,) * len(lab.rig))
    monkeypatch.setattr("posefuse.calibrate_clocks", lambda *_, **__: found)
    if kept:
        (tmp_path / "posefuse.toml").write_text(kept)
    run("clocks", str(tmp_path))
    assert purpose.replace("SESSION", str(tmp_path)) in capsys.readouterr().err.splitlines()[-1]


def test_a_drifting_clock_is_set_right_by_the_settings_written(lab: Any, tmp_path: Path) -> None:
    offset, drift, middle = 0.12, -2e-4, 40.0
    second = np.eye(4)[1]
    found = ClockEstimate(offset * second, drift * second, 0 * second, 0 * second, middle)
    path = save_clocks(tmp_path / "posefuse.toml", lab.rig.names, found)
    assert path is not None
    read = read_settings(path, TrackConfig).cameras["cam01"]
    images = tmp_path / "images"
    images.mkdir()
    stamps = (2.0, 77.0)
    for i in range(2):
        cv2.imwrite(str(images / f"{i}.png"), np.zeros((16, 16, 3), np.uint8))
    (images / "timestamps.csv").write_text("file,t_s\n" + "".join(f"{i}.png,{t}\n" for i, t in enumerate(stamps)))
    source = ImagesConfig(images, "cam01", offset_s=read.offset_s, drift_ppm=read.drift_ppm).build()
    taken_s = [s - offset - drift * (s - middle) for s in stamps]
    np.testing.assert_allclose(source.times_ns() / 1e9, taken_s, atol=2e-6)
    assert [frame.t_ns for frame in source.frames()] == source.times_ns().tolist()


def test_the_coverage_sheet_shows_which_camera_saw_nothing(lab: Any) -> None:
    seen = lab.watch()
    blind = coverage(seen.rows(seen.camera != 2))
    sheet = coverage_sheet(blind, [camera.size_wh for camera in lab.rig], 160)
    width, height = lab.rig.cameras[0].size_wh
    tall = round(160 * height / width)
    assert sheet.shape == (2 * tall, 320, 3)
    green = sheet[..., 1].astype(int) - sheet[..., 0]
    parts = [green[r : r + tall, c : c + 160].max() for r in (0, tall) for c in (0, 160)]
    assert [part > 0 for part in parts] == [True, True, False, True]


def test_a_report_shows_remedies_only_for_what_failed(read_page: Any, tmp_path: Path, ring_rig: Any) -> None:
    good, bad = Check("a", True, "fine <1>", "not shown"), Check("b", False, "broken", "do this")
    report, rig = CalibrationReport("thing", (good, bad), ("left out",), {"n": 3.0}), ring_rig(3)
    images = {"heat <b>": np.zeros((8, 8, 3), np.uint8)}
    page = read_page(write_page(tmp_path / "r.html", calibration_page(report, images, rig)))
    assert page.headings[0] == "thing: refused: b" and "left out" in page.text
    assert page.tables[0][1:] == [["pass", "a", "fine <1>"], ["FAIL", "b", "broken; do this"]]
    assert page.classes == {"pass": "good", "FAIL": "bad"} and "not shown" not in page.text
    assert page.tables[1][1:] == [["n", "3"]] and len(page.images) == 1
    [cameras] = [one for one in page.plot("Plan of the cameras")["series"] if one["name"] == "cameras"]
    np.testing.assert_allclose(np.stack([cameras["x"], cameras["y"]], axis=1), rig.centres_world()[:, :2], atol=1e-3)
    assert [label.split()[0] for label in cameras["labels"]] == list(rig.names)
    bare = read_page(write_page(tmp_path / "bare.html", calibration_page(CalibrationReport("thing", (good,)))))
    assert bare.headings == ["thing: passed", "Checks"]
    with pytest.raises(RefusedCalibration, match="thing: b: broken; do this"):
        CalibrationReport("thing", (good, bad)).require()
