"""Who is right about the four webcams: the reference, made as if they were synchronised, or the rig with clocks of its own?

The stamps of `timestamps.csv` are when a program took the images over, not when they were exposed. Each test here asks
something that depends on neither rig, or asks both rigs the same. With `-s` they print what they find.
"""

import csv
from collections.abc import Callable
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import cv2
import numpy as np
import pytest
from calibrating import differences
from scipy.optimize import least_squares
from scipy.sparse import coo_array

from posefuse.calibration.extrinsics.pipeline import Options, RigTask, Solved, solve, starting_clocks
from posefuse.calibration.extrinsics.snapshots import snapshots
from posefuse.calibration.extrinsics.target import Calibration, calibrate_extrinsics
from posefuse.calibration.extrinsics.world import triangulate_linear
from posefuse.calibration.rotations import Poses
from posefuse.calibration.targets.corners import CornerObservations, joined
from posefuse.calibration.targets.kinds import Charuco
from posefuse.calibration.verify import verify
from posefuse.core import Rig

FRAME_S = 1 / 6
FOLDS = 5

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def found(board_views: CornerObservations, reference: Rig, board: Charuco) -> Calibration:
    return calibrate_extrinsics(board_views, reference.cameras, board, Options(clocks="offset"))


def frames_of(views: CornerObservations) -> np.ndarray:
    return np.round(views.t_ns * 1e-9 / FRAME_S).astype(int)


def steps_by_phase(views: CornerObservations, period: int) -> np.ndarray:
    """(period,) how far the image of the board moves from frame f to f + 1, by f modulo the period; its usual step is 1."""
    frame, shares = frames_of(views), [[] for _ in range(period)]
    corners = {f: dict(zip(views.corner[frame == f], views.xy_img[frame == f], strict=True)) for f in np.unique(frame)}
    for f in corners:
        around = [corners.get(f + k, {}) for k in (-1, 0, 1, 2)]
        common = sorted(set.intersection(*(set(seen) for seen in around)))
        if len(common) >= 4:
            path = np.stack([[seen[c] for c in common] for seen in around])
            step = np.median(np.linalg.norm(np.diff(path, axis=0), axis=-1), axis=1)
            shares[f % period].append(step[1] / step.mean())
    return np.array([np.median(share) for share in shares])


def test_the_board_never_rests_so_no_still_moment_can_settle_it(board_views: CornerObservations, reference: Rig) -> None:
    seen = snapshots(board_views, np.unique(board_views.t_ns), np.zeros((4, 2)))
    fastest_px = np.zeros(len(seen.t_s))
    np.maximum.at(fastest_px, seen.time_step, np.linalg.norm(seen.velocity_px_s, axis=1) * FRAME_S)
    views = [len(np.unique(seen.camera[seen.time_step == i])) for i in range(len(seen.t_s))]
    least_px = fastest_px[np.array(views) == len(reference)].min()
    print(f"\nwhere all four see the board it moves by {least_px:.1f} px from frame to frame, or more")
    assert least_px > 2.0


def test_one_webcam_exposes_on_a_tick_of_its_own_that_its_stamps_do_not_show(
    board_views: CornerObservations, shared_data: Path
) -> None:
    """In cam_1's images alone every third step is half as long: a 10 Hz camera read at 6 Hz (100, 200, 200 ms)."""
    steps = {name: steps_by_phase(board_views.of_camera(name), 3) for name in ("cam_0", "cam_1", "cam_2")}
    print("\nsteps by phase:", {name: step.round(2).tolist() for name, step in steps.items()})
    assert steps["cam_0"] == pytest.approx(np.ones(3), abs=0.1)
    assert steps["cam_2"] == pytest.approx(np.ones(3), abs=0.1)
    assert steps["cam_1"] == pytest.approx([1.2, 0.6, 1.2], abs=0.1)
    place = shared_data / "caliscope" / "post_optimization" / "calibration" / "extrinsic" / "timestamps.csv"
    with place.open() as file:
        stamps = sorted(float(row["frame_time"]) for row in csv.DictReader(file) if row["cam_id"] == "1")
    assert np.diff(stamps) == pytest.approx(FRAME_S, abs=0.016)


def test_stamps_on_that_tick_halve_its_residual_and_leave_the_cameras_where_they_are(
    board_views: CornerObservations, reference: Rig, board: Charuco
) -> None:
    late_ms = np.array([-33, 0, -67])[frames_of(board_views) % 3]
    mine = board_views.camera == board_views.index("cam_1")
    stamped = replace(board_views, t_ns=board_views.t_ns + np.where(mine, late_ms * 1_000_000, 0))
    again, before = (solved_freely(views, reference, board) for views in (stamped, board_views))
    left_px = np.array([usual_residual_px(solved, len(reference)) for solved in (again, before)])
    metres, radians = differences(*(with_poses(reference, solved.solution.state.cam_from_world) for solved in (again, before)))
    print(f"\nby camera, on the output tick {left_px[0].round(2)} px are left, before {left_px[1].round(2)} px")
    print(f"{said(metres, radians)} between the rigs")
    one = reference.names.index("cam_1")
    assert left_px[0, one] < 0.55 * left_px[1, one]
    assert (left_px[0] < 1.05 * left_px[1]).all()
    assert left_px[0].max() < 0.42
    assert metres.max() < 0.002
    assert np.rad2deg(radians.max()) < 0.05


def test_the_other_three_webcams_alone_confirm_the_rig_and_not_the_reference(
    found: Calibration, board_views: CornerObservations, reference: Rig, board: Charuco
) -> None:
    names = ("cam_0", "cam_2", "cam_3")
    views = joined([board_views.of_camera(name) for name in names])
    ours, theirs = (Rig(tuple(rig[name] for name in names)) for rig in (found.rig, reference))
    three = calibrate_extrinsics(views, theirs.cameras, board).rig
    print(f"\nthree cameras alone: {said(*differences(three, ours))} from ours, {said(*differences(three, theirs))} from theirs")
    assert differences(three, ours)[0].max() < 0.004
    assert differences(three, theirs)[0].max() > 0.010
    # measured as the reference was made: every frame at its stamp
    lengths_mm = [verify(rig, views, board).report.numbers["length_rms_mm"] for rig in (ours, theirs)]
    print(f"every frame at its stamp, lengths are off by {lengths_mm[0]:.2f} mm in ours, {lengths_mm[1]:.2f} in theirs")
    assert lengths_mm[0] < 0.8 * lengths_mm[1]


def test_frames_the_rig_has_not_seen_measure_better_than_in_the_reference_which_has(
    board_views: CornerObservations, reference: Rig, board: Charuco
) -> None:
    """The recording in five stretches, each measured in a rig made from the other four."""
    fold = frames_of(board_views) * FOLDS // 57
    ours, theirs = [], []
    for out in range(FOLDS):
        state = solved_freely(board_views.rows(fold != out), reference, board).solution.state
        rig, left_out = with_poses(reference, state.cam_from_world), board_views.rows(fold == out)
        ours.append(verify(rig, left_out, board, state.delay_s[:, 0]).length_error_m)
        theirs.append(verify(reference, left_out, board).length_error_m)
    print(f"\nframes left out measure to {rms(ours) * 1e3:.2f} mm rms in ours, {rms(theirs) * 1e3:.2f} mm in the reference")
    assert rms(ours) < 1.0e-3 < rms(theirs)


def test_taken_as_synchronised_and_every_corner_as_a_free_point_the_reference_comes_out(
    found: Calibration, board_views: CornerObservations, reference: Rig
) -> None:
    """So the lenses, the corners and the reading of its file agree; what differs is the clocks, and 1.4 px are left."""
    rig, rms_px = free_points_in_step(board_views, found.rig)
    ours_px = found.report.numbers["residual_px"]
    metres, degrees = np.max(
        [relative_pose_difference(rig, reference, a, b) for a, b in combinations(reference.names, 2)], axis=0
    )
    print(
        f"\nin step, free points: pairs within {metres * 1e3:.1f} mm / {degrees:.2f} deg of the reference, {rms_px:.2f} px left"
    )
    print(f"with clocks of their own: {ours_px:.2f} px left")
    assert metres < 0.005
    assert degrees < 0.3
    assert rms_px > 1.7 * ours_px


def said(metres: np.ndarray, radians: np.ndarray) -> str:
    return f"{metres.max() * 1e3:.1f} mm / {np.rad2deg(radians.max()):.2f} deg"


def rms(parts: list[np.ndarray]) -> float:
    return float(np.sqrt((np.concatenate(parts) ** 2).mean()))


def relative_pose_difference(one: Rig, other: Rig, a: str, b: str) -> tuple[float, float]:
    """Metres and degrees between where two rigs put camera b in the axes of camera a."""
    first, second = (rig[a].cam_from_world @ rig[b].cam_from_world.inverse() for rig in (one, other))
    turn = first.matrix() @ second.matrix().T
    angle = np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1))
    return float(np.linalg.norm(first.xyz - second.xyz)), float(np.rad2deg(angle))


def with_poses(cameras: Rig, poses: Poses) -> Rig:
    pose = poses.se3()
    return Rig(tuple(replace(camera, cam_from_world=pose[i]) for i, camera in enumerate(cameras)))


def usual_residual_px(solved: Solved, cameras: int) -> np.ndarray:
    """(C,) median over all corners of a camera, those that disagree included: what counts as agreeing depends on the solve."""
    size = np.linalg.norm(solved.solution.residual_px, axis=1)
    return np.array([np.median(size[solved.seen.camera == c]) for c in range(cameras)])


def solved_freely(views: CornerObservations, lenses: Rig, board: Charuco) -> Solved:
    """The solve without its checks, which would refuse some of the shortened recordings."""
    task = RigTask(views, lenses.cameras, board, Options(clocks="offset"))
    return solve(task, starting_clocks(task))


def free_points_in_step(views: CornerObservations, start: Rig) -> tuple[Rig, float]:
    """Plain least squares over cameras and free points, every frame at its stamp; and the rms distance left in px."""
    seen = snapshots(views, np.unique(views.t_ns), np.zeros((len(start), 2)))
    point = np.unique(np.stack([seen.time_step, seen.corner]), axis=1, return_inverse=True)[1].ravel()
    kept = np.bincount(point)[point] >= 2
    camera, xy_img = seen.camera[kept], seen.xy_img[kept]
    point = np.unique(point[kept], return_inverse=True)[1].ravel()
    tracks = np.full((len(start), point.max() + 1, 2), np.nan)
    tracks[camera, point] = xy_img
    poses = [np.append(cv2.Rodrigues(c.cam_from_world.matrix())[0], c.cam_from_world.xyz) for c in start]
    x = np.concatenate([*poses, triangulate_linear(start, tracks).ravel()])
    misfit = _misfit(start, camera, point, xy_img)
    solved = least_squares(misfit, x, jac_sparsity=_sparsity(len(start), camera, point), x_scale="jac")
    pose = solved.x[: 6 * len(start)].reshape(-1, 6)
    placed = Poses(np.stack([cv2.Rodrigues(p[:3])[0] for p in pose]), pose[:, 3:])
    return with_poses(start, placed), float(np.sqrt((misfit(solved.x).reshape(-1, 2) ** 2).sum(axis=1).mean()))


def _misfit(rig: Rig, camera: np.ndarray, point: np.ndarray, xy_img: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    def misfit(x: np.ndarray) -> np.ndarray:
        pose, xyz = x[: 6 * len(rig)].reshape(-1, 6), x[6 * len(rig) :].reshape(-1, 3)
        off = np.empty_like(xy_img)
        for c, one in enumerate(rig):
            mine = camera == c
            px = cv2.projectPoints(xyz[point[mine]], pose[c, :3], pose[c, 3:], one.K.copy(), one.distortion.copy())[0]
            off[mine] = px[:, 0] - xy_img[mine]
        return off.ravel()

    return misfit


def _sparsity(cameras: int, camera: np.ndarray, point: np.ndarray) -> coo_array:
    columns = np.concatenate([6 * camera[:, None] + np.arange(6), 6 * cameras + 3 * point[:, None] + np.arange(3)], axis=1)
    columns = np.repeat(columns, 2, axis=0)
    rows = np.repeat(np.arange(len(columns)), columns.shape[1])
    shape = (len(columns), 6 * cameras + 3 * (int(point.max()) + 1))
    return coo_array((np.ones(columns.size), (rows, columns.ravel())), shape=shape)
