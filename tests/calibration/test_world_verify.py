"""World frames, verification, clocks and the monitor on a rig that is known exactly."""

import re
import warnings
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from built import turned
from checks import refusal
from scipy.spatial.distance import pdist

from bench.faults.waved_props import Faults, Waving, board, observe_prop
from posefuse.calibration.extrinsics.target import world_checks
from posefuse.calibration.extrinsics.world import (
    UP_FROM_CAMERAS,
    floor_from_feet,
    floor_tile,
    floor_under_body,
)
from posefuse.calibration.targets.corners import CornerObservations
from posefuse.calibration.targets.kinds import Charuco, Chessboard, Markers
from posefuse.calibration.verify import verify
from posefuse.core import SE3, CalibrationError, Rig
from posefuse.health import rig_monitor as monitor

TILE = Markers(0.4, ids=(40,))
STILL = Waving(seconds=1.0, rate_hz=10.0, reach_m=(0, 0, 0), centre_m=(0, 0, 0), swings_hz=0.0)


def tile_views(rig: Rig, world_from_tile: SE3) -> Any:
    prop = {40: STILL.pose(np.zeros(1))[0].inverse() @ world_from_tile}
    return observe_prop(rig, prop, TILE, STILL, Faults(noise_px=0.1, missed=0))


def test_a_tile_sets_the_world(lab: Any) -> None:
    world_from_tile = SE3.from_rotvec([0, 0, 0.7], [0.3, -0.2, 0.0])
    elsewhere = lab.rig.moved(SE3.from_rotvec([0.4, -0.3, 1.0], [2.0, 1.0, -0.5]))
    found = elsewhere.moved(floor_tile(tile_views(lab.rig, world_from_tile), TILE, 40).new_from_old(elsewhere))
    wanted = lab.rig.moved(world_from_tile.inverse())
    np.testing.assert_allclose(found.centres_world(), wanted.centres_world(), atol=0.02)
    assert all(check.passed for check in world_checks(found, has_floor=True))


def test_a_tile_face_down_puts_cameras_below_the_floor_and_is_refused(lab: Any) -> None:
    """The floor comes first: the next command had named every camera as upside down."""
    upside_down = lab.rig.moved(SE3.from_rotvec([np.pi, 0, 0], [0, 0, 0]))
    failed = [check for check in world_checks(upside_down, has_floor=True) if not check.passed]
    assert [check.name for check in failed] == ["cameras are above the floor", "images are upright"]


def test_a_tile_that_no_person_sees_or_that_moves_is_refused(lab: Any) -> None:
    seen = tile_views(lab.rig, SE3.identity())
    refusal(CalibrationError, r"target 41: no camera sees it; seen are: \[40\]", floor_tile(seen, TILE, 41).new_from_old, lab.rig)
    pushed = replace(seen, xy_img=seen.xy_img + np.where(seen.t_ns[:, None] > 4e8, 30.0, 0.0))
    refusal(CalibrationError, r"it moves in the images \(by \d+ px\)", floor_tile(pushed, TILE, 40).new_from_old, lab.rig)


def test_the_floor_is_found_under_feet_that_are_lifted_half_of_the_time() -> None:
    random = np.random.default_rng(1)
    feet = np.column_stack([random.uniform(-2, 2, 600), random.uniform(-1, 1, 600), np.abs(random.normal(0, 0.12, 600))])
    feet[::2, 2] = random.normal(0, 0.005, 300)
    tilt = SE3.from_rotvec([0.5, 0.2, 0.0], [0.4, 0.1, 1.3])
    new_from_old = floor_from_feet(tilt @ feet, tilt @ np.array([[0, 0, 1.6]]))
    up = (new_from_old @ tilt).matrix()[2]
    assert np.rad2deg(np.arccos(up[2])) < 0.5
    assert abs((new_from_old @ (tilt @ np.zeros(3)))[2]) < 0.02


def test_feet_on_one_line_stand_on_a_floor_below_the_body() -> None:
    random = np.random.default_rng(1)
    feet = np.column_stack([random.uniform(-2, 2, 600), random.normal(0, 0.02, 600), np.abs(random.normal(0, 0.1, 600))])
    feet[::2, 2] = 0
    head = np.column_stack([random.uniform(-2, 2, 300), np.zeros(300), np.full(300, 1.6)])
    tilt = SE3.from_rotvec([0.5, 0.2, 0.0], [0.4, 0.1, 1.3])
    refusal(CalibrationError, "the feet stay on one line", floor_from_feet, tilt @ feet, tilt @ head)
    new_from_old = floor_under_body(tilt @ feet, tilt @ head)
    assert np.rad2deg(np.arccos((new_from_old @ tilt).matrix()[2, 2])) < 6
    assert abs((new_from_old @ (tilt @ np.zeros(3)))[2]) < 0.02


def test_without_a_floor_up_is_where_the_images_say(lab: Any) -> None:
    tilted = lab.rig.moved(SE3.from_rotvec([1.0, 0.3, 0.2], [0, 1.0, 0]))
    found = tilted.moved(UP_FROM_CAMERAS.new_from_old(tilted))
    assert all(check.passed for check in world_checks(found, has_floor=False))
    assert np.ptp(found.centres_world()[:, 2]) < 0.02


BOARD = Charuco(columns=5, rows=7, square_m=0.1, marker_m=0.075)


def board_seen(lab: Any, rig: Rig | None = None, noise_px: float = 0.2) -> CornerObservations:
    return observe_prop(rig or lab.rig, board(), BOARD, replace(lab.motion, seed=9), Faults(noise_px=noise_px, seed=4))


def test_verification_measures_millimetres_and_finds_a_moved_camera_and_a_wrong_scale(lab: Any) -> None:
    seen = board_seen(lab)
    true = verify(lab.rig, seen, BOARD)
    assert true.report.failed == ()
    assert true.report.numbers["length_rms_mm"] < 3
    assert true.report.numbers["scale"] == pytest.approx(1, abs=2e-3)
    moved_rig = verify(turned(lab.rig, 0, [0.02, 0, 0]), seen, BOARD)
    failed = {check.name: check.detail for check in moved_rig.report.failed}
    assert "reprojection" in failed and failed["cameras are where the rig has them"].startswith("cam00 is turned by")
    assert moved_rig.cameras[0].turn_rad == pytest.approx(0.02, abs=0.002) and moved_rig.cameras[0].excess > 1
    big = Rig(tuple(replace(c, cam_from_world=SE3(c.cam_from_world.wxyz, c.cam_from_world.xyz * 1.01)) for c in lab.rig))
    assert "scale is right" in {check.name for check in verify(big, seen, BOARD).report.failed}


@pytest.mark.parametrize(
    ("cameras", "swapped"), [(4, (0, 1)), (4, (0, 2)), (2, (0, 1))], ids=["neighbours", "opposite", "two alone"]
)
def test_swapped_cameras_are_refused_with_figures_that_are_known(lab: Any, cameras: int, swapped: tuple[int, int]) -> None:
    rig = Rig(lab.rig.cameras[:cameras])
    seen = board_seen(lab, rig)
    names = list(seen.cameras)
    a, b = swapped
    names[a], names[b] = names[b], names[a]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        report = verify(rig, replace(seen, cameras=tuple(names)), BOARD).report
    details = " ".join(check.detail for check in report.checks)
    [moved] = [check for check in report.failed if check.name == "cameras are where the rig has them"]
    assert f"{rig.names[a]} and {rig.names[b]}" in moved.detail
    assert "have swapped names" in moved.detail
    assert "nan" not in details and "inf" not in details
    assert max(map(float, re.findall(r"([0-9.]+) px rms", details)), default=0.0) <= lab.rig.cameras[0].size_wh[0]


def test_cameras_without_views_are_not_verified(lab: Any) -> None:
    seen = board_seen(lab)
    failed = {check.name: check.detail for check in verify(lab.rig, seen.rows(seen.camera < 2), BOARD).report.failed}
    assert "cam02 (0 views shared with others" in failed["every camera is measured"]
    assert "cam03 (0 views" in failed["every camera is measured"]


def test_a_chessboard_cannot_verify_a_rig(lab: Any) -> None:
    """A camera that counts its corners from the other end saw them a board away: a right rig was refused, cameras blamed."""
    seen, words = board_seen(lab), "looks the same from both ends; use a ChArUco"
    refusal(CalibrationError, words, verify, lab.rig, seen, Chessboard(4, 6, 0.05))


def test_noise_of_the_corners_neither_refuses_a_rig_nor_changes_its_scale(lab: Any) -> None:
    noisy = verify(lab.rig, board_seen(lab, noise_px=0.8), BOARD)
    assert noisy.report.failed == ()
    assert noisy.report.numbers["length_rms_mm"] > 20 * np.median(pdist(BOARD.corners(0)))
    assert noisy.report.numbers["scale"] == pytest.approx(1, abs=2e-3)


def walk(t_s: np.ndarray) -> np.ndarray:
    """(T, 6, 3) points that swing about a walking middle."""
    middle = np.stack([1.2 * np.sin(0.8 * t_s), 0.9 * np.cos(0.8 * t_s), 1.0 + 0 * t_s], axis=-1)
    swing = np.stack([np.sin(5 * t_s[:, None] + np.arange(6)) * 0.3, np.cos(3.1 * t_s[:, None] + np.arange(6)) * 0.25,
                      np.tile(np.linspace(-0.8, 0.6, 6), (len(t_s), 1))], axis=-1)  # fmt: skip
    return middle[:, None] + swing


def walked(rig: Rig, t_s: float) -> np.ndarray:
    """(C, 6, 2) where they are in the images."""
    return rig.project(walk(np.array([t_s]))[0])


def run_monitor(rig: Rig, pictures: Any, seconds: float = 14.0) -> list[monitor.RigFinding]:
    random = np.random.default_rng(3)
    state, found = monitor.new_monitor_state(rig), []
    for k in range(round(seconds * 10)):
        xy = pictures(k / 10) + random.normal(0, 1.5, (len(rig), 6, 2))
        state, new = monitor.observe(state, rig, round(k * 1e8), xy)
        found += new
    return found


def test_the_monitor_names_what_went_wrong_within_seconds(lab: Any) -> None:
    # a ring of four is its own mirror image, in which swapped cables cannot be distinguished
    aside = replace(lab.rig.cameras[3], cam_from_world=lab.rig.cameras[3].cam_from_world @ SE3([1.0, 0, 0, 0], [0.7, 0.3, -0.5]))
    rig = Rig((*lab.rig.cameras[:3], aside))
    assert run_monitor(rig, lambda t: walked(rig, t)) == []
    after = turned(rig, 2, [0, 0.03, 0])
    moved_rig = run_monitor(rig, lambda t: walked(rig if t < 10 else after, t))
    assert (moved_rig[0].kind, moved_rig[0].cameras) == ("moved", ("cam02",))
    assert 10 <= moved_rig[0].t_ns / 1e9 < 13
    swapped = run_monitor(rig, lambda t: walked(rig, t)[[0, 1, 2, 3] if t < 10 else [0, 3, 2, 1]])
    assert (swapped[0].kind, swapped[0].cameras) == ("swapped", ("cam01", "cam03"))
    second = np.array([0, 1, 0, 0], bool)[:, None, None]
    late = run_monitor(rig, lambda t: np.where(second & (t >= 10), walked(rig, t - 0.08), walked(rig, t)))
    assert (late[0].kind, late[0].cameras) == ("unsynchronised", ("cam01",))
    assert 10 <= late[0].t_ns / 1e9 < 14
    assert "lag by about +" in late[0].detail


@pytest.mark.parametrize("seed", range(6))
def test_lasting_errors_of_a_network_name_no_camera_and_hide_none_that_moved(lab: Any, seed: int) -> None:
    """A network errs in each keypoint of each view in the same way for as long as it sees the body from there."""
    lasting = 2.0 * np.random.default_rng([seed, 6]).standard_normal((len(lab.rig), 6, 2))
    assert run_monitor(lab.rig, lambda t: walked(lab.rig, t) + lasting, seconds=20.0) == []
    for camera in (0, 2):
        after = turned(lab.rig, camera, [0.0, 0.03, 0.0])
        found = run_monitor(lab.rig, lambda t, after=after: walked(lab.rig if t < 6 else after, t) + lasting, seconds=11.0)
        assert [(one.kind, one.cameras) for one in found] == [("moved", (lab.rig.names[camera],))]
        assert 6 <= found[0].t_ns / 1e9 < 9


def test_a_camera_that_looks_at_another_person_is_not_called_moved(lab: Any) -> None:
    def another_person(t: float) -> np.ndarray:
        xy = walked(lab.rig, t)
        if t >= 5:
            xy[1] = lab.rig.cameras[1].project(walk(np.array([1.7 * t + 4]))[0] + [0.8, -0.7, 0.0])
        return xy

    assert run_monitor(lab.rig, another_person, seconds=11) == []


@pytest.mark.parametrize(("reach_m", "turn_rad", "kinds"), [(0.0, 0.02, []), (0.0, 0.1, ["moved"]), (1.0, 0.02, ["moved"])])
def test_a_standing_person_shows_large_displacements_only(lab: Any, reach_m: float, turn_rad: float, kinds: list[str]) -> None:
    """What a network makes up for limbs that one view does not show stays as long as a person stands; a walk tells it apart."""
    start, after = walk(np.zeros(1))[0], turned(lab.rig, 1, [0.0, turn_rad, 0.0])

    def pictures(t: float) -> np.ndarray:
        swing = 0.05 * np.sin(5 * t + np.arange(len(start)))[:, None]
        return after.project(start + swing + reach_m * np.array([np.sin(t), np.cos(t), 0.0]))

    assert [one.kind for one in run_monitor(lab.rig, pictures, seconds=9)] == kinds


def test_a_late_camera_stays_so_while_the_person_stands_still(lab: Any) -> None:
    random, state, found = np.random.default_rng(4), monitor.new_monitor_state(lab.rig), []
    for k in range(180):
        there_s = min(k / 10, 9.0)
        late_s = 0.1 if k >= 30 and there_s < 9.0 else 0.0
        xy = walked(lab.rig, there_s)
        xy[2] = walked(lab.rig, there_s - late_s)[2]
        state, new = monitor.observe(state, lab.rig, round(k * 1e8), xy + random.normal(0, 1.5, xy.shape))
        found += new
    assert [(one.kind, one.cameras) for one in found] == [("unsynchronised", ("cam02",))]
    assert [one.cameras for one in state.findings] == [("cam02",)]


@pytest.mark.filterwarnings("error")
def test_the_monitor_bears_points_on_the_horizon_and_cameras_that_see_nothing(lab: Any) -> None:
    state, shape = monitor.new_monitor_state(lab.rig), (len(lab.rig), 6, 2)
    far, nothing = np.full(shape, 1e200), np.full(shape, np.nan)
    one_blind = walked(lab.rig, 0.0)
    one_blind[2] = np.nan
    for k in range(90):
        state, _ = monitor.observe(state, lab.rig, k * 100_000_000, (far, nothing, one_blind)[k % 3])
        assert all(np.isfinite(sums.information).all() and np.isfinite(sums.pull).all() for sums in state.sums)
        assert np.isfinite([[sums.squares, sums.count] for sums in state.sums]).all()
    assert state.findings == ()


def test_stated_errors_of_cameras_are_those_that_they_have(lab: Any) -> None:
    """Of a small board, far away: focal length and distance of a camera all but cancel."""
    target, ratios = Charuco(columns=4, rows=3, square_m=0.22, marker_m=0.165), []
    for seed in range(4):
        motion = replace(lab.motion, seed=20 + seed)
        seen = observe_prop(lab.rig, board(), target, motion, Faults(noise_px=0.1, seed=seed))
        for one in verify(lab.rig, seen, target).cameras:
            assert one.excess < 0.5
            ratios.append((one.focal / one.focal_sigma, one.shift_m / one.shift_sigma, one.effect / one.effect_sigma))
    off = np.sqrt(np.square(ratios).mean(axis=0))
    assert (off > 0.4).all() and (off < 1.6).all(), off
