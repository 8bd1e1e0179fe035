"""Detection, intrinsics and printing: drawn images in, known lenses and lengths out; and the real boards."""

import re
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from calibrating import marker_page, run
from checks import refusal

from bench.faults.waved_props import Faults, Waving, board, observe_prop
from posefuse.api import calibrate as api
from posefuse.calibration.extrinsics.own_intrinsics import starting_cameras
from posefuse.calibration.intrinsics import PARAMETERS, calibrate_intrinsics
from posefuse.calibration.report import RefusedCalibration
from posefuse.calibration.targets.corners import CornerObservations
from posefuse.calibration.targets.coverage import coverage, coverage_picture
from posefuse.calibration.targets.detection import Corners, TargetDetector, detect_corners, why_nothing
from posefuse.calibration.targets.kinds import (
    Charuco,
    Chessboard,
    Markers,
    Target,
    TargetDescription,
    described_target,
    write_target,
)
from posefuse.calibration.targets.printing import CUBE_IDS, Sheet, board_sheet, marker_sheets, write_pdf
from posefuse.calibration.targets.recordings import paths_by_camera
from posefuse.core import CalibrationError, ConfigError, Rig
from posefuse.formats.rig import read_rig
from posefuse.sources import ImagesConfig

BOARD = Charuco(columns=5, rows=7, square_m=0.05, marker_m=0.0375)
WIDE = Charuco(columns=8, rows=6, square_m=0.07, marker_m=0.05)
Watched = tuple[Rig, CornerObservations]
MOTION = Waving(seconds=30, rate_hz=5, centre_m=(0, 0, 1.0), reach_m=(0.5, 0.45, 0.25), seed=3)


def pages(sheets: list[Sheet], dpi: int, folder: Path) -> list[np.ndarray]:
    """The printed pages as grey pictures, by a renderer of its own."""
    write_pdf(folder / "printed.pdf", sheets)
    words = ["pdftoppm", "-r", str(dpi), "-png", "-gray", str(folder / "printed.pdf"), str(folder / "page")]
    subprocess.run(words, check=True, timeout=120)
    return [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in sorted(folder.glob("page*.png"))]


needs_poppler = pytest.mark.skipif(shutil.which("pdftoppm") is None, reason="pdftoppm (poppler-utils) is not on this machine")


def markers_by_opencv(grey: np.ndarray) -> dict[int, np.ndarray]:
    """Corners (4, 2) px of every marker by its id, as OpenCV alone reads them: top left first, clockwise."""
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50))
    corners, ids, _ = detector.detectMarkers(grey)
    return {int(i): quad.reshape(4, 2) for i, quad in zip(ids.ravel(), corners, strict=True)}


def assert_printed_true(xy_img: np.ndarray, xyz: np.ndarray, atol: float) -> None:
    """Image x is board x, image y is board -y: nothing is mirrored, and sizes are true at 127 dpi."""
    want = np.column_stack([xyz[:, 0], -xyz[:, 1]]) * 127 / 0.0254
    np.testing.assert_allclose(xy_img - xy_img.mean(axis=0), want - want.mean(axis=0), atol=atol)


@needs_poppler
def test_a_printed_charuco_board_has_its_true_size_and_the_printed_side_up(tmp_path: Path) -> None:
    [page] = pages([board_sheet(BOARD, "a3")], 127, tmp_path)
    found = TargetDetector(BOARD).detect(page)
    xyz = BOARD.corners(0)[found.corner]
    assert len(xyz) == len(BOARD.corners(0))
    assert_printed_true(found.xy_img, xyz, atol=0.6)


@needs_poppler
def test_printed_cube_faces_carry_six_ids_of_true_size(tmp_path: Path) -> None:
    ids = []
    for page in pages(marker_sheets(Markers(0.12), CUBE_IDS), 127, tmp_path):
        [(i, quad)] = markers_by_opencv(page).items()
        ids.append(i)
        assert np.linalg.norm(quad[1] - quad[0]) == pytest.approx(0.12 * 5000, abs=1.0)
        assert quad[1, 0] > quad[0, 0]
    assert ids == [0, 1, 2, 3, 4, 5]


def test_a_target_that_does_not_fit_the_page_is_refused() -> None:
    words = r"page a4: a drawing of 250 x 350 mm, .* does not fit.*page \(a3, a2, a1, a0\)"
    refusal(ConfigError, words, board_sheet, BOARD, "a4")
    refusal(ConfigError, "there are: DICT_4X4_100", Markers, 0.1, "DICT_9X9")


def drawn(target: Charuco) -> np.ndarray:
    image = target.board().generateImage((500, 700), marginSize=0)
    return cv2.copyMakeBorder(image, 60, 60, 60, 60, cv2.BORDER_CONSTANT, value=255)


def test_a_target_that_is_not_found_is_explained() -> None:
    grey = drawn(BOARD)
    assert len(TargetDetector(BOARD).detect(grey).xy_img) == 24
    nothing = np.full((200, 300), 128, np.uint8)
    for image, target, words in (
        (cv2.flip(grey, 1), BOARD, "mirrored"),
        (255 - grey, BOARD, "colours exchanged"),
        (grey, replace(BOARD, columns=7, rows=5), "it is there with columns = 5, rows = 7"),
        (grey, replace(BOARD, columns=6), "but not as described: count columns and rows"),
        (grey, replace(BOARD, dictionary="DICT_7X7_50"), "DICT_4X4"),
        (nothing, BOARD, "no marker of any known dictionary"),
        (nothing, Chessboard(6, 5, 0.05), "no chessboard of 6 x 5 inner corners is wholly inside"),
    ):
        assert words in why_nothing([image], target)


def test_the_same_id_twice_in_an_image_counts_for_nothing() -> None:
    page = marker_page(7)[..., 0]
    found = TargetDetector(Markers(0.1)).detect(np.hstack([page, page]))
    assert len(found.xy_img) == 0
    assert found.doubled == (7,)


@pytest.fixture(scope="module")
def watched(ring_rig: Callable[..., Rig]) -> Watched:
    rig = ring_rig(1, radius_m=1.2, height_m=1.0, size_wh=(1280, 720), distortion=(-0.2, 0.06, 0.001, -0.0008, 0.0))
    return rig, observe_prop(rig, board(), WIDE, MOTION, Faults(noise_px=0.2, missed=0))


def test_intrinsics_come_back_within_their_standard_errors(watched: Watched) -> None:
    rig, seen = watched
    found = calibrate_intrinsics(seen, WIDE)
    true = [*rig.cameras[0].K[[0, 1, 0, 1], [0, 1, 2, 2]], *rig.cameras[0].distortion]
    got = [*found.camera.K[[0, 1, 0, 1], [0, 1, 2, 2]], *found.camera.distortion]
    for name, value, want in zip(PARAMETERS, got, true, strict=True):
        sigma = found.report.numbers[f"sigma_{name}"]
        # a coefficient the views cannot carry is held at 0, with a standard error of 0
        assert sigma == 0 or abs(value - want) < 5 * sigma, name
    assert found.camera.K[0, 0] == pytest.approx(true[0], rel=0.003)
    assert found.report.numbers["views"] <= 80


def test_one_refused_camera_loses_no_other(watched: Watched, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is good is in the file, and the camera that is recorded again joins it there."""
    good = watched[1]
    few = good.rows(np.isin(good.t_ns, np.unique(good.t_ns)[:2]))
    seen = {"cam01": good, "cam02": few, "cam03": good, "cam04": few}
    monkeypatch.setattr(api, "open_sources", lambda inputs: [SimpleNamespace(camera=name) for name in paths_by_camera(inputs)])
    monkeypatch.setattr(api, "detect_corners", lambda source, *_: replace(seen[source.camera], cameras=(source.camera,)))
    out = tmp_path / "lenses.toml"
    target = write_target(tmp_path / "board.toml", WIDE)
    words = ("intrinsics", "--target", str(target), "--out", str(out))
    with pytest.raises(RefusedCalibration, match="camera cam02: target seen: expected at least 4 views") as refused:
        run(*words, *(f"{name}={name}.mp4" for name in seen))
    assert "cam04" in refused.value.__notes__[0]
    assert read_rig(out).names == ("cam01", "cam03")
    before = read_rig(out)["cam01"].K
    seen["cam02"] = good
    run(*words, "--force", "cam02=cam02.mp4")
    assert read_rig(out).names == ("cam01", "cam03", "cam02")
    np.testing.assert_array_equal(read_rig(out)["cam01"].K, before)
    with pytest.raises(RefusedCalibration) as none:
        run(*words, "--force", "cam04=cam04.mp4")
    assert none.value.kept is None and len(read_rig(out)) == 3


def test_views_that_are_too_few_or_too_alike_are_refused(watched: Watched) -> None:
    _, seen = watched
    times = np.unique(seen.t_ns)
    with pytest.raises(CalibrationError, match="expected at least 4 views with 8 corners or more, got 2"):
        calibrate_intrinsics(seen.rows(np.isin(seen.t_ns, times[:2])), WIDE)
    one = seen.rows(seen.t_ns == times[len(times) // 2])
    alike = [
        replace(one, t_ns=one.t_ns + k, xy_img=one.xy_img + np.random.default_rng(k).normal(0, 0.2, one.xy_img.shape))
        for k in range(12)
    ]
    names = ("camera", "t_ns", "patch", "corner", "xy_img")
    same = replace(one, **{name: np.concatenate([getattr(part, name) for part in alike]) for name in names})
    refusal(RefusedCalibration, "slants differ", calibrate_intrinsics, same, WIDE)


class Misprinted(Charuco):
    """Its corners lie where the print has them, not where the file states."""

    def corners(self, patch: int) -> np.ndarray:
        x, y, _ = (flat := super().corners(patch)).T
        return flat + np.stack([0 * x, 0.02 * y, 0 * x], axis=1)


class Curled(Charuco):
    """A print that is bowed by 2.5 mm."""

    def corners(self, patch: int) -> np.ndarray:
        x, _, _ = (flat := super().corners(patch)).T
        return flat + np.stack([0 * x, 0 * x, 0.0025 * (2 * (x - x.mean()) / np.ptp(x)) ** 2], axis=1)


@pytest.mark.parametrize(
    ("printed", "zoom", "words"),
    [
        (Misprinted, lambda part, near: 1.0, r"board is as described: \+[12]\.\d+% longer upwards than across"),
        (Curled, lambda part, near: 1.0, r"board is flat: bent by [23]\.\d mm"),
        (Charuco, lambda part, near: 1.0 + 0.03 * (part > 0.5), r"focal length \+[23]\.\d% between earlier and later"),
        (Charuco, lambda part, near: 1.0 + 0.05 * (part > 0.75), r"focal length \+\d+\.\d% between earlier and later"),
        (Charuco, lambda part, near: 1.0 + 0.06 * near, r"focal length \+[2-6]\.\d% between far and near"),
    ],
)
def test_intrinsics_that_a_wrong_print_or_autofocus_makes_wrong_are_refused(
    watched: Watched, printed: type[Charuco], zoom: Callable[[float, float], float], words: str
) -> None:
    """Each gave focal lengths 1 to 3 % off, with stated errors of 0.1 % and all checks passed."""
    rig, _ = watched
    seen = observe_prop(rig, board(), printed(**vars(WIDE)), MOTION, Faults(noise_px=0.2, missed=0))
    centre, xy = rig.cameras[0].K[:2, 2], seen.xy_img.copy()
    starts = seen.view_starts()
    for first, end in zip(starts, [*starts[1:], len(seen)], strict=True):
        side = np.sqrt(np.prod(np.ptp(xy[first:end], axis=0))) / 720 if end - first > 30 else 0.4
        xy[first:end] = centre + (xy[first:end] - centre) * zoom(seen.t_ns[first] / 30e9, np.clip((side - 0.2) / 0.4, 0, 1))
    refused = refusal(RefusedCalibration, words, calibrate_intrinsics, replace(seen, xy_img=xy), WIDE)
    assert printed is not Charuco or "focus is fixed: " in refused


def test_coverage_guides_to_what_is_missing(watched: Watched, lab: Any) -> None:
    _, seen = watched
    now = coverage(seen)
    assert 0 < now.share[0] <= 1
    few = coverage(seen.rows(seen.t_ns == seen.t_ns[0]))
    assert re.search(r"cam00: \d+% covered, 25% needed; go to the \w+ \w+ of its image", few.advice())
    assert now.advice() == "enough: stop moving the target and calibrate"
    assert coverage_picture(now.cells[0], (320, 180)).shape == (180, 320, 3)
    several = coverage(lab.watch().rows(lab.watch().camera != 2))
    assert several.advice() == "show the target to cam02"


def test_intrinsics_are_the_same_to_the_last_bit_in_every_run(watched: Watched, lab: Any) -> None:
    """OpenCV sums views in the order in which its threads are done with them: results differed by 1e-12."""
    threads, short = cv2.getNumThreads(), lab.watch(motion=replace(lab.motion, seconds=6.0))
    for found in (lambda: [calibrate_intrinsics(watched[1], WIDE).camera], lambda: starting_cameras(short, lab.target)):
        runs = {b"".join(camera.K.tobytes() + camera.distortion.tobytes() for camera in found()) for _ in range(4)}
        assert len(runs) == 1 and cv2.getNumThreads() == threads


@pytest.mark.slow
@pytest.mark.parametrize(("number", "camera"), [(2, "cam_02"), (4, "cam_04")])
def test_real_chessboards_give_the_reference_lens(shared_data: Path, number: int, camera: str) -> None:
    folder = shared_data / "pose2sim_single" / "calibration"
    target: Target = Chessboard(4, 7, 0.06)
    seen = detect_corners(ImagesConfig(folder / "intrinsics" / f"int_cam0{number}_img", camera, rate_hz=30.0).build(), target)
    found = calibrate_intrinsics(seen, target).camera
    reference = read_rig(folder / "Calib.qca.txt")[camera.replace("_", "")]
    np.testing.assert_allclose(found.K[[0, 1], [0, 1]], reference.K[[0, 1], [0, 1]], rtol=0.01)
    # coefficients as they are in the file, and not a 64th of them
    np.testing.assert_allclose(found.distortion[0], reference.distortion[0], atol=0.02)


@pytest.mark.parametrize("marker_m", [0.022, 0.0225, 0.0234])
def test_squares_and_markers_have_the_sizes_that_were_asked_for(marker_m: float) -> None:
    sheet = board_sheet(Charuco(columns=5, rows=7, square_m=0.03, marker_m=marker_m), "a4")
    sizes_m = np.array(sheet.black_m)[:, 2:]
    square = np.isclose(sizes_m, 0.03, atol=1e-9).all(axis=1)
    assert square.sum() >= 17
    modules = sizes_m[~square] / (marker_m / 6)
    np.testing.assert_allclose(modules, np.round(modules), atol=1e-6)
    assert modules.max() == pytest.approx(6)


def test_an_inverted_board_has_its_corners_where_the_usual_one_has_them() -> None:
    target = Charuco(columns=5, rows=7, square_m=0.12, marker_m=0.09)
    inverted = replace(target, inverted=True)
    grey = drawn_page(board_sheet(target, "a0"))
    usual, other = detected(target, grey), detected(inverted, 255 - grey)
    np.testing.assert_array_equal(usual.corner, other.corner)
    np.testing.assert_allclose(usual.xy_img, other.xy_img, atol=0.05)
    printed = detected(inverted, drawn_page(board_sheet(inverted, "a0")))
    assert len(printed.xy_img) == len(usual.xy_img)
    shift = printed.xy_img - usual.xy_img
    np.testing.assert_allclose(shift, np.broadcast_to(shift.mean(axis=0), shift.shape), atol=0.6)
    assert len(detected(inverted, grey).xy_img) == 0


@pytest.mark.parametrize(
    ("said", "words"),
    [
        ({"kind": "markers", "marker_mm": 100, "legacy": True}, "legacy: a target of kind markers has none"),
        ({"kind": "charuco", "columns": 5, "rows": 7, "square_mm": 50, "marker_mm": 37, "ids": (40, 41)}, "ids: a target of"),
        ({"kind": "markers", "marker_mm": 37, "columns": 5, "square_mm": 50}, "columns, square_mm: a target"),
        ({"kind": "chessboard", "columns": 9, "rows": 6, "square_mm": 25, "inverted": True}, "inverted: a target of"),
    ],
)
def test_what_a_kind_of_target_does_not_have_is_refused(said: dict[str, Any], words: str) -> None:
    """Most were taken, and ignored without a word."""
    refusal(ConfigError, words, described_target, TargetDescription(**said), lambda names: ConfigError(str(names)))


def detected(target: Charuco, grey: np.ndarray) -> Corners:
    """By the number of the corner: OpenCV finds markers in any order."""
    found = TargetDetector(target).detect(grey)
    order = np.argsort(found.corner, kind="stable")
    return Corners(found.patch[order], found.corner[order], found.xy_img[order])


def drawn_page(sheet: Sheet, px_per_m: float = 800.0) -> np.ndarray:
    """A page as an image, white where nothing is printed."""
    width, height = (round(side * px_per_m) for side in sheet.size_m)
    scale = 8
    page = np.full((height * scale // 4, width * scale // 4), 255, np.uint8)
    for x, y, w, h in np.array(sheet.black_m) * px_per_m * scale / 4:
        page[round(len(page) - y - h) : round(len(page) - y), round(x) : round(x + w)] = 0
    return cv2.resize(page, (width, height), interpolation=cv2.INTER_AREA)
