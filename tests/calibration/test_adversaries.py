"""Everything people do wrong: each is solved to the truth or refused by name, never a wrong rig with success."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from calibrating import merged

from bench.faults.waved_props import Faults, board, cube, observe_prop
from posefuse.calibration.extrinsics.bootstrap import rough_offsets
from posefuse.calibration.extrinsics.pipeline import Options
from posefuse.calibration.extrinsics.target import Calibration, calibrate_extrinsics
from posefuse.calibration.report import RefusedCalibration
from posefuse.calibration.targets.corners import CornerObservations
from posefuse.calibration.targets.kinds import Charuco, Chessboard, Markers
from posefuse.core import SE3, CalibrationError, Rig

TOGETHER = Options(time_steps=100, clocks="together")


@pytest.fixture(scope="module")
def plain(lab: Any) -> CornerObservations:
    return lab.watch()


@pytest.fixture(scope="module")
def found(lab: Any, plain: CornerObservations) -> Calibration:
    return calibrate_extrinsics(plain, lab.rig.cameras, lab.target, TOGETHER)


def test_the_rig_comes_out_true_and_its_standard_errors_are_honest(lab: Any, found: Calibration) -> None:
    millimetres, degrees = lab.errors(found.rig)
    assert millimetres.max() < 3.0
    assert degrees.max() < 0.05
    assert found.report.failed == ()
    assert millimetres.max() < 5 * found.position_sigma_m.max() * 1e3
    assert found.rig.residual_px == pytest.approx(0.25 * np.sqrt(2), rel=0.15)


def test_the_same_input_gives_the_same_rig(lab: Any, plain: CornerObservations, found: Calibration) -> None:
    assert calibrate_extrinsics(plain, lab.rig.cameras, lab.target, TOGETHER).rig.id == found.rig.id
    # the order in which cameras are named changes nothing but the order
    again = calibrate_extrinsics(plain, lab.rig.cameras[::-1], lab.target, TOGETHER)
    millimetres, _ = replace(lab, rig=found.rig).errors(again.rig)
    assert millimetres.max() < 0.5


def test_the_two_solutions_of_one_flat_marker_are_decided_by_other_views(lab: Any) -> None:
    seen = observe_prop(lab.rig, {0: SE3.identity()}, lab.target, lab.motion, Faults())
    found = calibrate_extrinsics(seen, lab.rig.cameras, lab.target, TOGETHER)
    millimetres, degrees = lab.errors(found.rig)
    assert millimetres.max() < 8
    assert degrees.max() < 0.1


def test_a_marker_too_small_to_decide_is_refused(lab: Any, ring_rig: Any) -> None:
    far, small = ring_rig(4, radius_m=6.0), Markers(0.16)
    seen = observe_prop(far, {0: SE3.identity()}, small, lab.motion, Faults(noise_px=0.4))
    with pytest.raises(RefusedCalibration, match=r"too small to show their slant|cannot be linked"):
        calibrate_extrinsics(seen, far.cameras, small, TOGETHER)


@pytest.mark.slow
def test_a_mirrored_board_is_refused_by_name(lab: Any) -> None:
    target = Charuco(columns=5, rows=7, square_m=0.12, marker_m=0.09)
    seen = observe_prop(lab.rig, board(), target, lab.motion, Faults())
    assert calibrate_extrinsics(seen, lab.rig.cameras, target, TOGETHER).report.failed == ()
    mirrored = replace(seen, corner=(seen.corner // 4) * 4 + 3 - seen.corner % 4)
    with pytest.raises(RefusedCalibration, match=r"mirrored: 0% of cam\d\d's views see the printed face"):
        calibrate_extrinsics(mirrored, lab.rig.cameras, target, TOGETHER)


def test_a_marker_with_a_wrong_id_now_and_then_does_no_harm(lab: Any, plain: CornerObservations) -> None:
    wrong = (plain.patch == 3) & np.repeat(np.random.default_rng(0).random(len(plain) // 4) < 0.3, 4)
    without_5 = replace(plain, patch=np.where(wrong, 5, plain.patch)).rows(plain.patch != 5)
    found = calibrate_extrinsics(without_5, lab.rig.cameras, lab.target, TOGETHER)
    assert lab.errors(found.rig)[0].max() < 3.0


def test_two_markers_exchanged_in_one_camera_are_refused(lab: Any, plain: CornerObservations) -> None:
    exchanged = (plain.camera == 1) & np.isin(plain.patch, [1, 2])
    with pytest.raises(RefusedCalibration, match="cam01"):
        calibrate_extrinsics(replace(plain, patch=np.where(exchanged, 3 - plain.patch, plain.patch)), lab.rig.cameras,
                             lab.target, TOGETHER)  # fmt: skip


@pytest.mark.parametrize("watching", [(2,), (0, 1, 2, 3)], ids=["one camera", "all cameras"])
def test_a_second_prop_is_left_out_and_named(lab: Any, plain: CornerObservations, watching: tuple[int, ...]) -> None:
    motion = replace(lab.motion, seed=5, centre_m=(0.5, -0.4, 1.0))
    second = observe_prop(lab.rig, cube(0.3, first_id=10), lab.target, motion, Faults(seed=3, missed=0.3))
    alone = second.rows(np.isin(second.camera, watching))
    found = calibrate_extrinsics(merged(plain, alone), lab.rig.cameras, lab.target, TOGETHER)
    assert lab.errors(found.rig)[0].max() < 3.0
    left_out = [note.split(" left out")[0] for note in found.report.notes if "left out" in note]
    assert left_out == [f"marker {i}" for i in range(10, 16)]


def test_a_target_that_is_held_still_is_named_and_no_lens_is_blamed(lab: Any) -> None:
    held = lab.watch(motion=replace(lab.motion, swings_hz=1e-9, seconds=4.0))
    with pytest.raises(RefusedCalibration, match=r"^extrinsics: target moves: .* it is held still"):
        calibrate_extrinsics(held, lab.rig.cameras, lab.target, TOGETHER)


def test_two_equal_props_are_refused(lab: Any, plain: CornerObservations) -> None:
    with pytest.raises(RefusedCalibration, match="marker 2 in 81 frames of cam00"):
        calibrate_extrinsics(replace(plain, doubled=(("cam00", 2, 81),)), lab.rig.cameras, lab.target, TOGETHER)


@pytest.mark.parametrize("by_m", [0.3, pytest.param(0.05, marks=pytest.mark.slow), pytest.param(0.01, marks=pytest.mark.slow)])
def test_a_camera_that_is_moved_half_way_is_refused_by_name(lab: Any, plain: CornerObservations, by_m: float) -> None:
    cameras = list(lab.rig.cameras)
    bump = SE3.from_rotvec([0, by_m / 4.5, 0], [0, 0, 0.0])
    cameras[2] = replace(cameras[2], cam_from_world=bump @ cameras[2].cam_from_world @ SE3([1.0, 0, 0, 0], [by_m, 0, 0]))
    after = lab.watch(rig=Rig(tuple(cameras)))
    middle_ns = round(lab.motion.seconds * 5e8)
    mixed = merged(
        plain.rows((plain.camera != 2) | (plain.t_ns < middle_ns)), after.rows((after.camera == 2) & (after.t_ns >= middle_ns))
    )
    with pytest.raises(RefusedCalibration, match="cam02"):
        calibrate_extrinsics(mixed, lab.rig.cameras, lab.target, TOGETHER)


def test_a_camera_that_never_sees_the_prop_is_named(lab: Any, plain: CornerObservations) -> None:
    with pytest.raises(RefusedCalibration, match=r"not found by cam03 \(0 of 360 frames\)"):
        calibrate_extrinsics(plain.rows(plain.camera != 3), lab.rig.cameras, lab.target, TOGETHER)


@pytest.mark.slow
def test_cameras_that_share_no_view_are_named_with_what_to_do(lab: Any, plain: CornerObservations) -> None:
    late = plain.t_ns >= 12_000_000_000
    apart = plain.rows(np.where(plain.camera >= 2, late, ~late))
    with pytest.raises(
        RefusedCalibration, match="cam02, cam03 cannot be linked to cam00, cam01: they never see the prop at the same"
    ):
        calibrate_extrinsics(apart, lab.rig.cameras, lab.target, TOGETHER)


@pytest.mark.slow
def test_an_image_turned_by_half_a_turn_is_named_unless_stated(lab: Any, plain: CornerObservations) -> None:
    size = np.array(lab.rig.cameras[1].size_wh)
    turned = replace(plain, xy_img=np.where((plain.camera == 1)[:, None], size - 1 - plain.xy_img, plain.xy_img))
    with pytest.raises(RefusedCalibration, match=r"the image of cam01 is turned by 180 deg|upside down: cam01"):
        calibrate_extrinsics(turned, lab.rig.cameras, lab.target, TOGETHER)
    found = calibrate_extrinsics(turned, lab.rig.cameras, lab.target, TOGETHER, upside_down=("cam01",))
    centres = replace(lab, rig=found.rig).rig.centres_world()
    true = lab.rig.centres_world()
    assert np.linalg.norm(centres[0] - centres[1]) == pytest.approx(np.linalg.norm(true[0] - true[1]), abs=0.005)


@pytest.mark.slow
def test_a_mirrored_image_is_refused(lab: Any, plain: CornerObservations) -> None:
    width = lab.rig.cameras[1].size_wh[0]
    flipped = plain.xy_img * [-1, 1] + [width - 1, 0]
    with pytest.raises(RefusedCalibration, match="cam01"):
        calibrate_extrinsics(replace(plain, xy_img=np.where((plain.camera == 1)[:, None], flipped, plain.xy_img)),
                             lab.rig.cameras, lab.target, TOGETHER)  # fmt: skip


def test_one_stream_given_twice_is_refused(lab: Any, plain: CornerObservations) -> None:
    copy = plain.rows(plain.camera == 0)
    twice = merged(plain.rows(plain.camera != 1), replace(copy, camera=np.ones(len(copy), np.int64)))
    with pytest.raises(RefusedCalibration, match="videos differ: cam00 and cam01 show the same video"):
        calibrate_extrinsics(twice, lab.rig.cameras, lab.target, TOGETHER)


@pytest.mark.slow
def test_intrinsics_of_another_zoom_are_refused(lab: Any, plain: CornerObservations) -> None:
    cameras = list(lab.rig.cameras)
    cameras[1] = replace(cameras[1], K=cameras[1].K * np.array([[1.08, 1, 1], [1, 1.08, 1], [1, 1, 1]]))
    with pytest.raises(RefusedCalibration, match=r"cam01's focal length would rather be -7\.\d%"):
        calibrate_extrinsics(plain, tuple(cameras), lab.target, TOGETHER)


@pytest.mark.slow
def test_a_principal_point_is_refused_by_how_far_it_moves_cameras(lab: Any, plain: CornerObservations) -> None:
    """20 px are 2 deg, most of which the camera's rotation takes up; what is left is 40 mm."""
    cameras = list(lab.rig.cameras)
    cameras[1] = replace(cameras[1], K=cameras[1].K + np.array([[0, 0, 20.0], [0, 0, 0], [0, 0, 0]]))
    words = r"cam01's principal point would rather be \d\.\d deg elsewhere .*moves a camera by \d\.\d% of the target's distance"
    with pytest.raises(RefusedCalibration, match=words):
        calibrate_extrinsics(plain, tuple(cameras), lab.target, TOGETHER)


@pytest.mark.slow
def test_synchronised_is_not_taken_on_trust_and_offsets_are_found(lab: Any) -> None:
    late_s = (0.0, 0.1, -0.05, 0.2)
    seen = lab.watch(Faults(delay_s=late_s))
    with pytest.raises(RefusedCalibration, match=r"clocks"):
        calibrate_extrinsics(seen, lab.rig.cameras, lab.target, TOGETHER)
    found = calibrate_extrinsics(seen, lab.rig.cameras, lab.target, replace(TOGETHER, clocks="offset"))
    late = found.delay_s[:, 0] - found.delay_s[0, 0]
    np.testing.assert_allclose(late, late_s, atol=2e-3)
    assert lab.errors(found.rig)[0].max() < 5.0


@pytest.mark.parametrize("late_s", [(0.3, -0.3, 0.3, -0.3), (0.0, 1.2, -0.6, 0.35)])
def test_cameras_that_are_all_late_are_found_to_half_a_step_of_the_search(lab: Any, late_s: tuple[float, ...]) -> None:
    seen = lab.watch(Faults(delay_s=late_s))
    found = rough_offsets(seen, lab.rig.cameras, lab.target)
    np.testing.assert_allclose(found - found[0], np.array(late_s) - late_s[0], atol=0.05)


def test_a_recording_of_a_second_determines_no_clock(lab: Any) -> None:
    seen = lab.watch(motion=replace(lab.motion, seconds=1.0))
    assert np.isnan(rough_offsets(seen, lab.rig.cameras, lab.target)).all()


@pytest.mark.slow
def test_cameras_that_are_late_in_turn_are_calibrated_with_their_clocks(lab: Any) -> None:
    late_s = np.array([0.3, -0.3, 0.3, -0.3])
    seen = lab.watch(Faults(delay_s=tuple(late_s)))
    found = calibrate_extrinsics(seen, lab.rig.cameras, lab.target, Options(time_steps=60))
    np.testing.assert_allclose(found.delay_s[:, 0] - found.delay_s[0, 0], late_s - late_s[0], atol=2e-3)
    assert lab.errors(found.rig)[0].max() < 5.0


def test_unusable_input_is_refused_with_the_reason(lab: Any, plain: CornerObservations) -> None:
    with pytest.raises(CalibrationError, match="looks the same from both ends"):
        calibrate_extrinsics(plain, lab.rig.cameras, Chessboard(5, 7, 0.1))
    with pytest.raises(CalibrationError, match="expected at least 2 cameras, got 1"):
        calibrate_extrinsics(plain, lab.rig.cameras[:1], lab.target)
    with pytest.raises(CalibrationError, match="no observations of camera cam03"):
        calibrate_extrinsics(plain.of_camera("cam00"), (lab.rig.cameras[0], lab.rig.cameras[3]), lab.target)


@pytest.mark.slow
def test_lenses_known_to_a_per_cent_are_refined_when_asked(lab: Any, plain: CornerObservations) -> None:
    cameras = list(lab.rig.cameras)
    cameras[1] = replace(cameras[1], K=cameras[1].K * np.array([[1.01, 1, 1], [1, 1.01, 1], [1, 1, 1]]))
    with pytest.raises(
        RefusedCalibration, match=r"cam01's focal length would rather be -1\.\d%.*`focal_known_to_percent=3`"
    ) as refused:
        calibrate_extrinsics(plain, tuple(cameras), lab.target, TOGETHER)
    held = refused.value.kept
    focal = cameras[1].K[0, 0]
    sigma = (0.01 * focal,) * 4 + (0.02, 0.02)
    freed = calibrate_extrinsics(plain, tuple(cameras), lab.target, replace(TOGETHER, lens_sigma=sigma))
    assert freed.rig.cameras[1].K[0, 0] == pytest.approx(focal / 1.01, rel=0.003)
    assert held.rig.cameras[1].K[0, 0] == focal
    assert lab.errors(freed.rig)[0].max() < 0.5 * lab.errors(held.rig)[0].max()
