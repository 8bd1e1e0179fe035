"""Intrinsics from the same recording as the camera poses: start values, and whether the recording determines them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from posefuse.calibration.intrinsics import flat_views, solve_model
from posefuse.calibration.report import LIMITS, Check
from posefuse.calibration.targets.corners import CornerObservations
from posefuse.calibration.targets.coverage import ENOUGH_SHARE, coverage
from posefuse.calibration.targets.kinds import Target
from posefuse.core import SE3, CalibrationError, Camera

from .freedoms import lens_change
from .pipeline import TIME_STEPS, Options, RigTask, Solved, solve, starting_clocks

# views of one patch that start a camera, and the least that can
_VIEWS, _LEAST_VIEWS, _LEAST_CORNERS = 120, 12, 4
# how wrong a start may be: share of the focal length, of the image width, and k1, k2
_FOCAL, _CENTRE, _K1, _K2 = 0.1, 0.05, 0.3, 0.3


def starting_cameras(observations: CornerObservations, target: Target) -> tuple[Camera, ...]:
    """Cameras at the origin whose intrinsics are roughly right, one by one: each view of a patch is a view of a flat board.

    Zhang's method (2000) with one focal length, the principal point in the middle and no distortion.

    Raises:
        CalibrationError: a camera with too few views of the target.
    """
    return tuple(_start(observations, c, target) for c in range(len(observations.cameras)))


def start_sigma(cameras: Sequence[Camera]) -> tuple[float, ...]:
    """Standard errors of fx, fy, cx, cy (px), k1, k2 of such a start."""
    focal_px = float(np.mean([camera.K[0, 0] for camera in cameras]))
    width = float(np.mean([max(camera.size_wh) for camera in cameras]))
    return (_FOCAL * focal_px,) * 2 + (_CENTRE * width,) * 2 + (_K1, _K2)


def cameras_of(observations: CornerObservations, target: Target, options: Options) -> tuple[Camera, ...]:
    """Intrinsics of all cameras together from a moving target: those of `starting_cameras`, refined with the poses.

    Raises:
        CalibrationError: a camera with too few views of the target.
    """
    cameras = starting_cameras(observations, target)
    free = replace(options, lens_sigma=start_sigma(cameras), time_steps=min(options.time_steps, 2 * TIME_STEPS))
    task = RigTask(observations, cameras, target, free)
    try:
        return solve(task, starting_clocks(task)).refined
    except CalibrationError:
        # the error of the calibration itself names the camera and the reason
        return cameras


def check_carried(observations: CornerObservations, solved: Solved) -> Check:
    """The recording determines the intrinsics: near and far, over the image, and by the standard errors of the solve."""
    share, sigma = coverage(observations).share, lens_change(solved, solved).sigma
    distance_m, problems = solved.distance_m, []
    for c, camera in enumerate(solved.cameras):
        focal, bend_px = sigma[c, 0], sigma[c, 2] * 1000 / max(camera.size_wh)
        near, far = np.quantile(distance_m[solved.seen.camera == c], [0.05, 0.95])
        rules = (
            (share[c] < ENOUGH_SHARE, f"its image is covered by {share[c]:.0%} (needed {ENOUGH_SHARE:.0%})"),
            (far < LIMITS.own_depth_ratio * near,
             f"the target was {near:.1f} to {far:.1f} m away (needed a range of 1 to {LIMITS.own_depth_ratio:g})"),
            (focal > LIMITS.own_focal_sigma,
             f"its focal length is known to {focal:.2%} (needed {LIMITS.own_focal_sigma:.2%})"),
            (bend_px > LIMITS.own_bend_px_per_1000,
             f"its distortion is known to {bend_px:.1f} px per 1000 at the rim (needed {LIMITS.own_bend_px_per_1000:g})"),
        )  # fmt: skip
        problems += [f"{camera.name}: {words}" for wrong, words in rules if wrong]
    return Check(
        "recording carries the intrinsics", not problems, "; ".join(problems) or "near and far, over all images",
        "move the target near and far, into all corners, tilted this way and that; or calibrate the intrinsics with a board",
    )  # fmt: skip


def _start(observations: CornerObservations, c: int, target: Target) -> Camera:
    name, size = observations.cameras[c], observations.sizes_wh[c]
    views = flat_views(observations.rows(observations.camera == c), target, _LEAST_CORNERS)
    if len(views) < _LEAST_VIEWS:
        raise CalibrationError(f"camera {name}: {len(views)} views of the target, its intrinsics need at least {_LEAST_VIEWS}")
    # large views know more of the perspective
    large = sorted(views, key=lambda view: -float(np.ptp(view.xy, axis=0).sum()))[:_VIEWS]
    K = np.array([[0.9 * size[0], 0, (size[0] - 1) / 2], [0, 0.9 * size[0], (size[1] - 1) / 2], [0, 0, 1]])
    flags = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_PRINCIPAL_POINT | cv2.CALIB_FIX_ASPECT_RATIO
    flags |= cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST
    found = solve_model(large, size, flags, K).K
    return Camera(name=name, size_wh=size, K=found, cam_from_world=SE3.identity(), distortion=np.zeros(5))
