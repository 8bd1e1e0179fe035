"""Calibration from Python: the same figures as from the command line, typed results, files, refusals with their report."""

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from checks import refusal

from posefuse.api.calibrate import calibrate_extrinsics, calibrate_person, verify
from posefuse.api.calibration_results import ClockCalibration, RigCalibration, clock_blocks
from posefuse.api.rig_and_detector import rig_of
from posefuse.api.targets import print_target
from posefuse.calibration.clocks.sync import ClockEstimate
from posefuse.calibration.extrinsics import target as moving_target
from posefuse.calibration.extrinsics.own_intrinsics import starting_cameras
from posefuse.calibration.report import CalibrationReport, Check, RefusedCalibration
from posefuse.calibration.targets.kinds import Charuco, Markers, in_a_plane
from posefuse.calibration.targets.recordings import paths_by_camera
from posefuse.core import SE3, CalibrationError, ConfigError, InputError
from posefuse.core.frames import Pixels
from posefuse.formats.kept_video import KeptVideo
from posefuse.formats.rig import read_rig
from posefuse.foundation.summary import Table, column_texts

BOARD = Charuco(columns=5, rows=7, square_m=0.04, marker_m=0.03)
REPORT = CalibrationReport("extrinsics", (Check("halves agree", True, "fine"),), numbers={"rms_px": 0.3})


def test_a_session_folder_holds_videos_or_folders_of_images_as_track_and_the_simulator_have_them(tmp_path: Path) -> None:
    videos = tmp_path / "videos"
    videos.mkdir()
    (videos / "cam01.json").touch()
    refusal(InputError, "expected videos", paths_by_camera, [str(tmp_path)])
    for name in ("cam00", "cam01"):
        (videos / name).mkdir(parents=True)
        (videos / name / "000.jpg").touch()
    (videos / "notes").mkdir()
    assert paths_by_camera(tmp_path) == {"cam00": videos / "cam00", "cam01": videos / "cam01"}
    (videos / "cam02.mp4").touch()
    found = paths_by_camera([str(tmp_path), "other=x.mp4"])
    assert list(found) == ["cam00", "cam01", "cam02", "other"] and found["cam02"] == videos / "cam02.mp4"
    (videos / "cam00.mp4").touch()
    refusal(InputError, "two recordings are named cam00", paths_by_camera, tmp_path)


def test_a_folder_of_videos_stands_for_all_of_them_as_track_takes_it(tmp_path: Path) -> None:
    for name in ("cam00.mp4", "cam01.MOV", "rig_coverage.png", "rig.toml"):
        (tmp_path / name).touch()
    assert paths_by_camera(tmp_path) == {"cam00": tmp_path / "cam00.mp4", "cam01": tmp_path / "cam01.MOV"}
    (images := tmp_path / "frames").mkdir()
    (images / "000.jpg").touch()
    assert paths_by_camera(images) == {"frames": images}


def test_a_text_names_a_recording_unless_a_file_has_that_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("speed=3.mp4").touch()
    assert paths_by_camera(["speed=3.mp4", "left=a=b.mp4"]) == {"speed=3": Path("speed=3.mp4"), "left": Path("a=b.mp4")}
    assert paths_by_camera([Path("right=c.mp4")]) == {"right=c": Path("right=c.mp4")}
    assert paths_by_camera({"cam": "a.mp4"}) == {"cam": Path("a.mp4")}
    with pytest.raises(InputError, match="two recordings are named left; give each camera its own name, as NAME=PATH"):
        paths_by_camera(["left=a.mp4", "videos/left.mp4"])


def test_what_is_wrong_is_reported_before_any_work(lab: Any, tmp_path: Path) -> None:
    extrinsics = partial(calibrate_extrinsics, ["none.mp4"], intrinsics=lab.rig)
    person = partial(calibrate_person, dict.fromkeys(lab.rig.names[:2], tmp_path), intrinsics=lab.rig, height_m=1.8)
    no_camera = "upside_down=cam1`: no such camera; there are: "
    refusal(InputError, "needs a target of markers", extrinsics, target=BOARD, floor_marker=7)
    refusal(InputError, f"{no_camera}none", extrinsics, target=Markers(0.1), upside_down=["cam1"])
    refusal(InputError, f"{no_camera}cam00, cam01", person, upside_down=["cam1"])
    refusal(InputError, r"none\.mp4: no such video", extrinsics, target=Markers(0.1))
    refusal(InputError, "do not state their frame rate", person)


def test_numbers_of_a_board_are_checked_where_it_is_printed(tmp_path: Path) -> None:
    board = {"kind": "charuco", "columns": 4.0, "rows": 3, "square_mm": 36, "marker_mm": 27}
    assert print_target(tmp_path / "board.pdf", board).target.is_file()
    refusal(ConfigError, r"target: columns: .* got 4\.5", print_target, tmp_path / "other.pdf", {**board, "columns": 4.5})
    plain = {"kind": "chessboard", "columns": 5, "rows": 7, "square_mm": 30}
    refusal(InputError, "chessboard is not offered", print_target, tmp_path / "other.pdf", plain)


@pytest.mark.slow
def test_the_prop_of_the_laboratory_is_calibrated_saved_and_verified(lab: Any, tmp_path: Path) -> None:
    seen = lab.watch()
    found = calibrate_extrinsics(seen, intrinsics=lab.rig, target=lab.target)
    assert found.rig.names == lab.rig.names and not found.report.failed
    assert found.clocks is None and found.clock_settings == ""
    path = found.save(tmp_path / "rig.toml", report=tmp_path / "rig.html")
    assert read_rig(path).names == lab.rig.names
    assert (tmp_path / "rig.html").read_text(encoding="utf-8").count("data:image/jpeg") == len(lab.rig)
    refusal(InputError, r"rig\.toml", found.save, path)
    found.save(path, replace=True)
    assert list(tmp_path.glob("rig.toml.replaced-*"))
    checked = verify(found.rig, seen, target=lab.target)
    assert checked.passed == (not checked.report.failed)


def test_intrinsics_and_rigs_of_twice_the_size_are_rescaled_and_it_is_said(lab: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    double = replace(lab.rig, cameras=tuple(camera.scaled((1280, 960)) for camera in lab.rig))
    seen, used = lab.watch(motion=replace(lab.motion, seconds=4.0)), []

    def solve(observations: object, cameras: object, *_: object) -> None:
        used.extend(cameras)
        raise RefusedCalibration(CalibrationReport("test", (Check("one", False, "is wrong"),)))

    monkeypatch.setattr(moving_target, "calibrate_extrinsics", solve)
    with pytest.raises(RefusedCalibration) as refused:
        calibrate_extrinsics(seen, intrinsics=double, target=lab.target)
    for camera, true in zip(used, lab.rig, strict=True):
        np.testing.assert_allclose(camera.K, true.K)
    note = "cam00: its calibration of 1280x960 px was rescaled to images of 640x480 px"
    assert refused.value.__notes__[0] == note
    checked = verify(double, seen, target=lab.target)
    assert checked.passed and note in checked.report.notes
    squeezed = replace(lab.rig, cameras=tuple(camera.scaled((640, 360)) for camera in lab.rig))
    words = r"images are 640x480 px, its calibration \(640, 360\), in other proportions"
    refusal(CalibrationError, words, verify, squeezed, seen, target=lab.target)


def test_a_rig_file_is_verified_with_the_clocks_next_to_it(lab: Any, tmp_path: Path) -> None:
    seen, path = lab.watch(motion=replace(lab.motion, seconds=4.0)), rig_of(lab.rig).save(tmp_path / "rig.toml")
    (tmp_path / "posefuse.toml").write_text("[cameras.cam01]\noffset_s = -0.05\n")
    found = verify(path, seen, target=lab.target)
    assert found.report.notes == (f"clock offsets of cam01 from {tmp_path / 'posefuse.toml'}",)
    as_stamped = verify(read_rig(path), seen, target=lab.target)
    late_ms = [one.report.numbers["cam01_late_ms"] for one in (found, as_stamped)]
    assert late_ms == [pytest.approx(-50, abs=5), pytest.approx(0, abs=1)] and as_stamped.report.notes == ()
    here = replace(lab.rig, cameras=tuple(replace(camera, cam_from_world=SE3.identity()) for camera in lab.rig))
    lenses = rig_of(here).save(tmp_path / "lenses.toml")
    words = r"lenses\.toml: all 4 cameras are at one place: these are intrinsics only"
    refusal(CalibrationError, words, verify, lenses, seen, target=lab.target)


def test_a_camera_that_sees_the_marker_on_the_floor_alone_is_named(lab: Any, tmp_path: Path) -> None:
    seen, floor = lab.watch(motion=replace(lab.motion, seconds=4.0)), 43
    with KeptVideo(tmp_path / "cam00.mp4") as video:
        for i in range(3):
            video.write(Pixels(np.full((480, 640, 3), 128, np.uint8)), i * 50_000_000)
    patch, recordings = np.where(seen.camera == 0, floor, seen.patch), (("cam00", tmp_path / "cam00.mp4"),)
    alone, given = replace(seen, patch=patch, recordings=recordings), {"intrinsics": lab.rig, "target": lab.target}
    refusal(
        CalibrationError, "camera cam00: target seen: .* in none of", calibrate_extrinsics, alone, **given, floor_marker=floor
    )


def test_clock_offsets_are_saved_as_settings_and_shown_in_ms(lab: Any, tmp_path: Path) -> None:
    """Which settings these are: `test_clocks_reach_the_settings_of_track_and_never_overwrite_them`."""
    clocks = ClockEstimate.known(np.array([0.0, 0.12, -0.05, 0.031]), 0.0)
    found = ClockCalibration(rig=lab.rig, clocks=clocks, report=REPORT)
    refusal(InputError, r"posefuse\.toml", found.save, found.save(tmp_path / "posefuse.toml"))
    same = replace(found, clocks=ClockEstimate.known(np.zeros(4), 0.0))
    assert same.save(tmp_path / "other.toml") is None and not (tmp_path / "other.toml").exists()
    rig = RigCalibration(rig=lab.rig, report=REPORT, clocks=clocks)
    assert rig.numbers["rms_px"] == 0.3 and rig.numbers[f"{lab.rig.names[1]}_offset_ms"] == pytest.approx(120)


# --- intrinsics and extrinsics from one recording of a moving target: near the truth, or refused where it cannot carry them


@pytest.mark.slow
def test_one_recording_gives_intrinsics_and_poses(lab: Any) -> None:
    seen = lab.watch()
    start = starting_cameras(seen, lab.target)
    assert max(abs(one.K[0, 0] / true.K[0, 0] - 1) for one, true in zip(start, lab.rig, strict=True)) < 0.12
    found = calibrate_extrinsics(seen, target=lab.target, clocks="together")
    for camera in lab.rig:
        assert found.rig[camera.name].K[0, 0] == pytest.approx(camera.K[0, 0], rel=0.003)
    millimetres, degrees = lab.errors(found.rig)
    # with known intrinsics it is 2 mm and 0.03 deg
    assert millimetres.max() < 25
    assert degrees.max() < 0.25


def test_a_recording_that_does_not_carry_them_is_refused_by_name(lab: Any) -> None:
    found = partial(calibrate_extrinsics, target=lab.target, clocks="together")
    here = lab.watch(motion=replace(lab.motion, reach_m=(0.25, 0.25, 0.2)))
    refusal(RefusedCalibration, r"recording carries the intrinsics: cam00: its image is covered by \d+% ", found, here)
    few = lab.watch()
    few = few.rows((few.camera != 1) | (few.t_ns < np.unique(few.t_ns[few.camera == 1])[3]))
    refusal(CalibrationError, r"camera cam01: \d+ views of the target, its intrinsics need at least 12", found, few)
    words = "needs `intrinsics=FILE` to refine"
    refusal(InputError, words, calibrate_extrinsics, lab.watch(), target=lab.target, focal_known_to_percent=1.0)


def test_corners_of_one_row_of_a_board_are_no_view() -> None:
    grid = np.array([[x, y, 0.0] for y in range(3) for x in range(4)]) * 0.054
    assert in_a_plane(grid) and in_a_plane(grid[[0, 1, 4, 5]])
    assert not in_a_plane(grid[:4]) and not in_a_plane(grid[[0, 5, 10]])


def test_a_clock_that_is_right_is_not_stated_with_a_negative_zero() -> None:
    clocks = ClockEstimate.known(np.array([0.0, -1e-6, -0.012]), 0.0)
    table = next(block for block in clock_blocks(["a", "b", "c"], clocks) if isinstance(block, Table))
    assert [row[1:] for row in table.rows] == [["+0.0 ± 0.0"], ["+0.0 ± 0.0"], ["-12.0 ± 0.0"]]
    assert column_texts([-0.0001, 12.3]) == ["0.0", "12.3"]
    assert column_texts([5.1e-16, 0.0]) == ["0.0", "0.0"]
