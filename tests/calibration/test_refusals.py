"""What refuses a calibration, and by which name: limits, causes, sizes, single cameras of a rig, and rigs kept all the same."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from built import turned

from bench.faults import command_cases, file_cases, good_sessions, person_cases, prop_cases, verify_cases
from bench.faults.sessions import moved, one_changed, prop_session
from bench.faults.verdict import RIGHT, SILENT, verdict
from bench.faults.waved_props import Faults, Waving, board, cube, observe_prop
from posefuse.calibration.extrinsics.causes import best_causes, cause_check
from posefuse.calibration.extrinsics.freedoms import Freed
from posefuse.calibration.extrinsics.pipeline import Options
from posefuse.calibration.extrinsics.target import calibrate_extrinsics
from posefuse.calibration.person.scale import KnownLength
from posefuse.calibration.report import Check, RefusedCalibration
from posefuse.calibration.solving.bundle import clustered_covariance
from posefuse.calibration.targets.kinds import Charuco, Markers
from posefuse.calibration.verify import verify
from posefuse.core import SE3, CalibrationError, Rig
from posefuse.formats.rig import read_placed_rig, read_rig, write_rig

TOGETHER = Options(time_steps=60, clocks="together")


def test_standard_errors_grow_where_blocks_share_errors_and_never_shrink() -> None:
    random = np.random.default_rng(0)
    block, covariance = np.repeat(np.arange(20), 10), np.eye(2) / 200
    alone = random.normal(0, 1, (200, 2))
    shared = alone + np.repeat(random.normal(0, 3, (20, 2)), 10, axis=0)
    assert np.diag(clustered_covariance(covariance, alone, block)) == pytest.approx(np.diag(covariance), rel=0.8)
    assert (np.diag(clustered_covariance(covariance, alone, block)) >= np.diag(covariance)).all()
    # ten that share an error of 3 count as much as one: 1 + 10 * 9 times the variance
    assert np.diag(clustered_covariance(covariance, shared, block)) == pytest.approx(91 * np.diag(covariance), rel=0.7)
    np.testing.assert_array_equal(clustered_covariance(covariance, alone, np.zeros(200)), covariance)


def solved(spread_px: float) -> Any:
    residual_px = np.random.default_rng(1).normal(0, spread_px, (400, 2))
    return SimpleNamespace(seen=SimpleNamespace(camera=np.repeat([0, 1], 200)), solution=SimpleNamespace(residual_px=residual_px))


def trial(words: str, spread_px: float, frees: int) -> Freed:
    return Freed(Check("cause", False, words, f"mend {words}"), solved(spread_px), frees)


def named(*trials: Freed) -> list[str]:
    return [cause.freed.check.detail for cause in best_causes(solved(3.0), trials)]


def test_the_explanation_that_frees_least_among_equals_is_named() -> None:
    swapped, free = trial("names swapped", 0.3, 0), trial("intrinsics", 0.29, 12)
    assert named(free, swapped) == ["names swapped"]
    # one that explains far more wins though it frees more
    assert named(trial("turned", 2.0, 0), free) == ["intrinsics"]


def test_two_explanations_that_cannot_be_separated_are_both_named() -> None:
    refused = solved(3.0)
    found = best_causes(refused, [trial("moved", 0.3, 6), trial("zoomed", 0.3, 6)])
    assert {cause.freed.check.detail for cause in found} == {"moved", "zoomed"}
    assert "moved or zoomed (the images do not show which" in cause_check(found, refused).line


def test_what_explains_little_is_not_named() -> None:
    assert named(trial("moved", 2.7, 6)) == []


def test_a_side_in_other_units_is_refused_before_and_after_the_solve(lab: Any) -> None:
    seen = lab.watch()
    with pytest.raises(RefusedCalibration, match=r"target has a plausible size: marker side 0\.24 mm"):
        calibrate_extrinsics(seen, lab.rig.cameras, Markers(0.24e-3), TOGETHER)
    with pytest.raises(
        RefusedCalibration, match=r"rig has a plausible size: with a marker side of 24 mm .*`any_size=True`"
    ) as caught:
        calibrate_extrinsics(seen, lab.rig.cameras, Markers(0.024), TOGETHER)
    # it can be had on request, and says what it failed
    assert caught.value.kept.rig.refused == "rig has a plausible size"
    small = replace(TOGETHER, any_size=True)
    assert calibrate_extrinsics(seen, lab.rig.cameras, Markers(0.024), small).rig.refused == ""


def test_a_refused_rig_is_marked_in_its_file(lab: Any, tmp_path: Path) -> None:
    write_rig(tmp_path / "rig.toml", replace(lab.rig, refused="halves agree"))
    assert read_rig(tmp_path / "rig.toml").refused == "halves agree"
    write_rig(tmp_path / "rig.toml", lab.rig)
    assert read_rig(tmp_path / "rig.toml").refused == ""


@pytest.mark.parametrize(
    ("known", "said"),
    [
        ({"stature_m": 0.5}, "height of the person: .*got 0.5"),
        ({"stature_m": 178.0}, "height of the person: .*did you mean 1.78 m"),
        ({"apart": ("cam00", "cam00", 3.4)}, "expected the distance of two cameras, got cam00 twice"),
    ],
)
def test_a_length_that_cannot_be_is_refused(known: dict[str, Any], said: str) -> None:
    with pytest.raises(CalibrationError, match=said):
        KnownLength(**known)
    assert KnownLength(stature_m=1.2).stature_m == 1.2


def test_intrinsics_alone_are_read_as_intrinsics_and_not_as_a_rig(lab: Any, tmp_path: Path) -> None:
    write_rig(tmp_path / "lenses.toml", Rig(tuple(replace(camera, cam_from_world=SE3.identity()) for camera in lab.rig)))
    assert read_rig(tmp_path / "lenses.toml").names == lab.rig.names
    with pytest.raises(CalibrationError, match=r"lenses\.toml: all 4 cameras are at one place: these are intrinsics only"):
        read_placed_rig(tmp_path / "lenses.toml")


TARGET = Charuco(columns=4, rows=5, square_m=0.12, marker_m=0.09)


@pytest.fixture(scope="module")
def wall(ring_rig: Any) -> Rig:
    """Four cameras near each other, which see the printed face together."""
    return Rig(ring_rig(10, radius_m=3.0).cameras[:4])


@pytest.fixture(scope="module")
def held(wall: Rig) -> Any:
    motion = Waving(seconds=20.0, rate_hz=8.0, reach_m=(0.7, 0.7, 0.5), swings_hz=0.2)
    return observe_prop(wall, board(), TARGET, motion, Faults(noise_px=0.1))


@pytest.mark.slow
def test_the_camera_that_was_turned_is_named_with_its_turn(wall: Rig, held: Any) -> None:
    found = verify(wall, held, TARGET)
    assert [check.name for check in found.report.failed] == []
    wrong = verify(turned(wall, 1, [0, np.deg2rad(1.0), 0]), held, TARGET)
    check = next(check for check in wrong.report.failed if check.name == "cameras are where the rig has them")
    assert check.detail.startswith("cam01 is turned by")
    assert np.rad2deg(wrong.cameras[1].turn_rad) == pytest.approx(1.0, abs=0.1)
    assert wrong.cameras[1].excess > 1


def test_cameras_without_views_are_not_verified(wall: Rig, held: Any) -> None:
    found = verify(wall, held.rows(held.camera < 2), TARGET)
    check = next(check for check in found.report.failed if check.name == "every camera is measured")
    assert "cam02 (0 views shared with others" in check.detail
    assert "cam03 (0 views" in check.detail


@pytest.mark.slow
def test_a_wrong_camera_is_blamed_and_not_those_that_are_measured_against_it() -> None:
    # in this ring the two neighbours look worse than the camera that was turned
    session = prop_session(0)
    turned_one = int(np.random.default_rng([0, 4]).integers(4))
    cameras = one_changed(session.rig.cameras, turned_one, moved(session.rig.cameras[turned_one], 0.0, 0.5, 4))
    found = verify(Rig(cameras), session.watch(), session.target)
    assert [one.name for one in found.cameras if one.excess > 1] == [session.rig.names[turned_one]]


CASES = (*prop_cases.CASES, *person_cases.CASES, *verify_cases.CASES, *file_cases.CASES, *command_cases.CASES)


@pytest.mark.slow
def test_the_faults_of_the_benchmark_are_never_silent() -> None:
    """One seed of every sixth fault, and every tenth good session."""
    for session in good_sessions.SESSIONS[::10]:
        answer = session.run(3)
        assert not answer.refused, f"{session.name}: {answer.words}"
    for case in CASES[::6]:
        assert case.not_in_images or verdict(case, case.run(3)) != SILENT, case.name


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        "image of one turned by 180 deg",
        "images of one camera mirrored",
        "images of all cameras mirrored",
        "focal length of one +10 %",
        "principal point of one 25 px off",
        "one camera 100 ms late, stated as synchronised",
        "two groups of cameras never see it together",
        "a camera moved by 0.3 deg",
        "a camera moved by 30 mm",
        "a camera moved by 200 mm near the end",
        "person: image of one mirrored",
        "person: focal length of one +25 %",
        "person: one camera 100 ms late, stated as synchronised",
        "person: a camera turned by 1 deg",
    ],
)
def test_a_fault_of_the_benchmark_is_refused_by_its_right_name(name: str) -> None:
    [case] = [case for case in CASES if case.name == name]
    answer = case.run(3)
    assert verdict(case, answer) == RIGHT, answer.words


def test_a_camera_that_is_late_is_found_where_corners_spread_so_much_that_places_are_not_determined(ring_rig: Any) -> None:
    rig, target = ring_rig(3), Markers(0.24)
    late = Faults(noise_px=0.7, missed=0.4, delay_s=(0, 0.025, 0))
    seen = observe_prop(rig, cube(0.3), target, Waving(seconds=10, rate_hz=10), late)
    with pytest.raises(RefusedCalibration, match=r"cam01 is off.*cameras are determined, cameras are synchronised"):
        calibrate_extrinsics(seen, rig.cameras, target, Options(time_steps=60, clocks="together"))
    found = calibrate_extrinsics(seen, rig.cameras, target, Options(time_steps=60, clocks="auto"))
    assert any("not synchronised" in note for note in found.report.notes)
