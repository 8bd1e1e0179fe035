"""Camera poses from the same corners of a moving board: posefuse, OpenCV alone, and aniposelib's bundle adjustment.

    python bench/calibrate_peers.py [--seeds 4]

A ChArUco board is moved before four cameras on one side of a room for 40 s at 15 Hz; corners are projected, with noise of
0.25 px, and intrinsics are known. OpenCV: `stereoCalibrate` of every camera with the first, intrinsics held. aniposelib starts
from OpenCV's answer (`bundle_adjust`, poses only, with the board's geometry); it is measured where it is installed. Errors are
of the worst camera against the truth, after the best rigid motion; scale counts. JSON on stdout, a table on stderr.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
from faults.sessions import Session, board_session, errors
from harness import answer, arguments, medians, note

from posefuse.calibration.extrinsics.pipeline import Options
from posefuse.calibration.extrinsics.target import calibrate_extrinsics
from posefuse.calibration.targets.corners import CornerObservations
from posefuse.core import SE3, Camera, Rig
from posefuse.core.arrays import Array

FRAMES = 200


def grid(session: Session, seen: CornerObservations) -> Array:
    """(C, T, n, 2) corners, NaN where unseen, at `FRAMES` time steps that at least two cameras have."""
    times, step = np.unique(seen.t_ns, return_inverse=True)
    xy = np.full((len(session.rig), len(times), len(session.target.corners(0)), 2), np.nan)
    xy[seen.camera, step, seen.corner] = seen.xy_img
    several = np.flatnonzero((np.isfinite(xy[:, :, 0, 0])).sum(axis=0) >= 2)
    return xy[:, several[np.unique(np.linspace(0, len(several) - 1, FRAMES).astype(int))]]


def posefuse(session: Session, seen: CornerObservations, xy: Array) -> Rig:
    return calibrate_extrinsics(seen, session.rig.cameras, session.target, Options(time_steps=FRAMES, clocks="together")).rig


def opencv(session: Session, seen: CornerObservations, xy: Array) -> Rig:
    first, placed = session.rig.cameras[0], [SE3.identity()]
    board = session.target.corners(0).astype(np.float32)
    for camera, own in zip(session.rig.cameras[1:], xy[1:], strict=True):
        both = np.flatnonzero(np.isfinite(own).all(axis=(1, 2)) & np.isfinite(xy[0]).all(axis=(1, 2)))
        # OpenCV writes into what it is given
        lenses = [one.copy() for one in (first.K, first.distortion, camera.K, camera.distortion)]
        views = [list(corners[both].astype(np.float32)) for corners in (xy[0], own)]
        found = cv2.stereoCalibrate([board] * len(both), *views, *lenses, first.size_wh, flags=cv2.CALIB_FIX_INTRINSIC)
        placed.append(SE3.from_matrix(found[5], found[6].ravel()))
    return rig_of(session.rig.cameras, placed)


def aniposelib(session: Session, seen: CornerObservations, xy: Array) -> Rig:
    from aniposelib import cameras as anipose

    start = opencv(session, seen, xy)
    group = anipose.CameraGroup([
        anipose.Camera(matrix=c.K.copy(), dist=c.distortion[:5].copy(), size=c.size_wh, name=c.name,
                       rvec=cv2.Rodrigues(c.cam_from_world.matrix())[0].ravel(), tvec=c.cam_from_world.xyz.copy())
        for c in start
    ])  # fmt: skip
    count, corners = xy.shape[1], xy.shape[2]
    board = np.tile(session.target.corners(0), (count, 1))
    frame = np.repeat(np.arange(count), corners)
    flat = xy.reshape(len(xy), -1, 2)
    use = np.isfinite(flat[..., 0]).sum(axis=0) >= 2
    poses = board_poses(group, flat, use, frame, board)
    extra = {"objp": board[use], "ids": frame[use], "rvecs": poses[0][:, use], "tvecs": poses[1][:, use]}
    group.bundle_adjust(flat[:, use], extra, only_extrinsics=True, verbose=False)
    placed = [SE3.from_matrix(cv2.Rodrigues(np.asarray(c.rvec))[0], np.asarray(c.tvec).ravel()) for c in group.cameras]
    return rig_of(session.rig.cameras, placed)


def board_poses(group, flat: Array, use: Array, frame: Array, board: Array) -> tuple[Array, Array]:
    """(C, N, 3) rotation vectors and translations of the board in each camera, once for each corner, as aniposelib wants them."""
    rvecs, tvecs = np.full((*flat.shape[:2], 3), np.nan), np.full((*flat.shape[:2], 3), np.nan)
    for c, camera in enumerate(group.cameras):
        for number in np.unique(frame):
            rows = (frame == number) & np.isfinite(flat[c, :, 0])
            if rows.sum() >= 4:
                _, turn, shift = cv2.solvePnP(board[rows], flat[c, rows], camera.get_camera_matrix(), camera.get_distortions())
                rvecs[c, frame == number], tvecs[c, frame == number] = turn.ravel(), shift.ravel()
    return rvecs, tvecs


def rig_of(cameras: tuple[Camera, ...], placed: list[SE3]) -> Rig:
    return Rig(tuple(replace(camera, cam_from_world=pose) for camera, pose in zip(cameras, placed, strict=True)))


def measured(solve: Callable[[Session, CornerObservations, Array], Rig], seed: int) -> dict[str, float]:
    session = board_session(seed)
    seen = session.watch()
    xy = grid(session, seen)
    begin = time.process_time()
    millimetres, degrees = errors(session.rig, solve(session, seen, xy))
    return {"position_mm": millimetres, "rotation_deg": degrees, "cpu_s": time.process_time() - begin}


def main() -> None:
    args = arguments(__doc__, seeds=4)
    rows = []
    for solve in (posefuse, opencv, aniposelib):
        try:
            found = medians([measured(solve, 500 + seed) for seed in range(args.seeds)])
        except ModuleNotFoundError as error:
            note(f"{solve.__name__}: not installed ({error.name})")
            continue
        rows.append({"solved by": solve.__name__, **found})
    answer(args, {"Medians": rows}, seeds=args.seeds)


if __name__ == "__main__":
    main()
