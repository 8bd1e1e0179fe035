"""The target file: what `print` writes is what every step takes, and what is wrong in it is named."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from calibrating import run

from posefuse.api import calibrate
from posefuse.api.calibrate import target_of
from posefuse.calibration.extrinsics.world import FloorMarker, with_floor
from posefuse.calibration.targets.detection import TargetDetector
from posefuse.calibration.targets.kinds import Charuco, Chessboard, Markers, Target, dictionary_of, read_target, write_target
from posefuse.cli.command_line import WrongCommandLineError, parse
from posefuse.core import ConfigError, InputError

TARGETS: tuple[Target, ...] = (
    Markers(0.1205, "DICT_5X5_100", (3, 4, 7), True),
    Charuco(columns=5, rows=7, square_m=0.05, marker_m=0.0375, dictionary="DICT_4X4_100", inverted=True, legacy=True),
    Chessboard(8, 6, 0.031),
)


@pytest.mark.parametrize("target", TARGETS, ids=lambda target: type(target).__name__)
def test_a_target_file_gives_the_same_target_again(target: Target, tmp_path: Path) -> None:
    path = tmp_path / "target.toml"
    write_target(path, target)
    assert read_target(path) == target == target_of(str(path)) == target_of(target)


def test_printing_writes_the_file_and_the_other_steps_take_it(tmp_path: Path) -> None:
    out, described = tmp_path / "board.pdf", tmp_path / "board.toml"
    sizes = ("--columns", "5", "--rows", "7", "--square-mm", "50", "--marker-mm", "37.5")
    assert run("print", *sizes, "--page", "a3", "--out", str(out))["target"] == str(described)
    assert read_target(described) == Charuco(columns=5, rows=7, square_m=0.05, marker_m=0.0375)
    recording = f"cam={tmp_path / 'none.mp4'}"
    with pytest.raises(InputError, match="no such video or folder of images"):
        run("intrinsics", "--target", str(described), "--out", str(tmp_path / "lenses.toml"), recording)
    with pytest.raises(InputError, match=r"board\.toml already exists"):
        run("print", *sizes, "--page", "a3", "--out", str(tmp_path / "board.ps"))


def test_what_is_wrong_with_a_target_is_named(tmp_path: Path) -> None:
    path = tmp_path / "target.toml"
    path.write_text('kind = "charuco"\ncolumns = 5\nrows = 7\nsquare_mm = 50.0\n')
    with pytest.raises(ConfigError, match=r"target\.toml: charuco: missing marker_mm"):
        read_target(path)
    path.write_text('kind = "markers"\nmarker_cm = 12\n')
    with pytest.raises(ConfigError, match=r"target\.toml: unknown key 'marker_cm'; there are: .*marker_mm"):
        read_target(path)
    with pytest.raises(ConfigError, match=r"none\.toml: no such file"):
        read_target(tmp_path / "none.toml")
    with pytest.raises(WrongCommandLineError, match=r'--target.*Did you mean "charuco"'):
        parse(["calibrate", "print", "--target", "charuko", "--out", "a.pdf"])


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (("--cube", "--marker-mm", "120", "--ids", "48,49,50"), "markers 0 to 49, this target needs 48 to 50"),
        (("--cube", "--marker-mm", "120", "--ids", "3,4,3"), "ids: expected each once, got 3, 4, 3"),
        (("--columns", "12", "--rows", "12", "--square-mm", "50", "--marker-mm", "37"), "this target needs 0 to 71"),
        (("--columns", "1", "--rows", "7", "--square-mm", "50", "--marker-mm", "37"), "columns: expected at least 2, got 1"),
        (("--columns", "5", "--rows", "7", "--square-mm", "50", "--marker-mm", "60"), "60 mm: expected less than .* 50 mm"),
    ],
)
def test_a_target_that_cannot_be_is_not_printed(words: tuple[str, ...], reason: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=reason):
        run("print", *words, "--page", "a0", "--out", str(tmp_path / "target.pdf"))
    assert list(tmp_path.iterdir()) == []


def test_other_files_in_place_of_the_target_file_and_of_the_result_are_named(tmp_path: Path) -> None:
    rig, target, video = tmp_path / "rig.toml", tmp_path / "cube.toml", f"cam={tmp_path / 'none.mp4'}"
    rig.write_text("[cameras]\n")
    with pytest.raises(ConfigError, match=r"rig\.toml: not a target file: expected kind = markers, charuco"):
        read_target(rig)
    write_target(target, Markers(0.12))
    before = target.read_bytes()
    for step in (("extrinsics", "--out"), ("intrinsics", "--out")):
        with pytest.raises(InputError, match=r"cube\.toml"):
            run(step[0], "--target", str(target), "--force", step[1], str(target), video)
    assert target.read_bytes() == before


def test_a_floor_marker_is_looked_for_where_the_target_has_ids_of_its_own(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    looked_for: list[Target] = []

    def stop(sources: object, target: Target, *_: object) -> None:
        looked_for.append(target)
        raise KeyboardInterrupt

    monkeypatch.setattr(calibrate, "observe_sources", stop)
    monkeypatch.setattr(calibrate, "open_sources", lambda inputs: [])
    target = Markers(0.12, ids=(3, 4, 7))
    with pytest.raises(KeyboardInterrupt):
        calibrate.calibrate_extrinsics([], target=target, floor=FloorMarker(40))
    with pytest.raises(KeyboardInterrupt):
        described = str(write_target(tmp_path / "cube.toml", target))
        run("extrinsics", "--target", described, "--floor-marker", "40", "--out", str(tmp_path / "rig.toml"), "a.mp4")
    assert [one.ids for one in looked_for if isinstance(one, Markers)] == [(3, 4, 7, 40)] * 2
    page = np.full((300, 300), 255, np.uint8)
    page[50:250, 50:250] = cv2.aruco.generateImageMarker(dictionary_of("DICT_4X4_50"), 40, 200)
    assert set(TargetDetector(with_floor(target, FloorMarker(40))).detect(page).patch) == {40}
    with pytest.raises(ConfigError, match="markers 0 to 49, this target needs 60"):
        calibrate.calibrate_extrinsics([], target=Markers(0.12), floor=FloorMarker(60))
