"""One camera's intrinsics and lens from views of a flat board (Zhang 2000, by OpenCV's solver).

The lens gets no more coefficients than the views can carry, and a result whose standard errors or coverage are poor is
refused with the reason. So is one that would change if the board were not quite as described or the focus not fixed: see
`_assumptions`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from posefuse.calibration.extrinsics.snapshots import evenly
from posefuse.calibration.geometry import one_opencv_thread
from posefuse.calibration.report import LIMITS, CalibrationReport, Check, RefusedCalibration
from posefuse.calibration.targets.corners import CornerObservations
from posefuse.calibration.targets.coverage import coverage
from posefuse.calibration.targets.kinds import LEAST_CORNERS, LEAST_VIEWS, Target, check_board, in_a_plane
from posefuse.core import SE3, Camera
from posefuse.core.arrays import Array, freeze_fields

PARAMETERS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")

# in the order of time; 40 that differ most in place, size and slant are no better than twice as many of these
_MOST_VIEWS = 80
_OUTLIER_RATIO = 2.5
_SIGNIFICANT = 3.0
_MOST_SIGMA_FOCAL = 0.01
_MOST_RMS_PX_PER_1000 = 0.5
_LEAST_COVERAGE = 0.25
_MOST_CENTRE_SHARE = 0.2
_MOST_ASPECT = 1.25
_LEAST_SLANT_RAD = np.deg2rad(12)

# lens models from rich to poor, with their last coefficients; each is tried until these are worth having
_MODELS = (
    (0, ("k3",)),
    (cv2.CALIB_FIX_K3, ("p1", "p2")),
    (cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST, ("k2",)),
    (cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K2, ("k1",)),
)


@dataclass(frozen=True, eq=False, kw_only=True)
class Intrinsics:
    """What came out for one camera.

    Attributes:
        camera: with its pose at the origin.
        cells: (rows, columns) frames that covered each part of the image, from the views used.
        report: checks made; its numbers hold standard errors of `PARAMETERS`, 0 for a coefficient held at 0.
    """

    camera: Camera
    cells: Array
    report: CalibrationReport

    def __post_init__(self) -> None:
        freeze_fields(self, {"cells": np.int64})


@dataclass(frozen=True, eq=False)
class View:
    """A flat patch of a target in one image, at t_ns.

    Attributes:
        xyz: (n, 3) its corners. xy: (n, 2) px at which they were seen.
    """

    t_ns: int
    xyz: Array
    xy: Array


def calibrate_intrinsics(observations: CornerObservations, target: Target) -> Intrinsics:
    """Intrinsics of the one camera in `observations`.

    Raises:
        CalibrationError: a target that cannot serve. RefusedCalibration: too few views, or a check that does not hold.
    """
    (name,), (size_wh,) = observations.cameras, observations.sizes_wh
    check_board(target)
    views = flat_views(observations, target, LEAST_CORNERS)
    if len(views) < LEAST_VIEWS:
        detail = (
            f"expected at least {LEAST_VIEWS} views with {LEAST_CORNERS} corners or more, got {len(views)}"
            f" in {observations.frame_count[0]} frames"
        )
        few = Check("target seen", False, detail, "show the board from more places and slants; count its columns and rows")
        raise RefusedCalibration(CalibrationReport(f"camera {name}", (few,)))
    views = [views[i] for i in evenly(np.arange(len(views)), _MOST_VIEWS)]
    solved = _solve(views, size_wh)
    # a view that fits far worse than the others was blurred or wrongly detected: with 6 % of these all of 12 cameras are refused
    good = solved.view_rms_px <= _OUTLIER_RATIO * np.median(solved.view_rms_px)
    dropped = int((~good).sum())
    if dropped and good.sum() >= LEAST_VIEWS:
        views = [view for view, keep in zip(views, good, strict=True) if keep]
        solved = _solve(views, size_wh)
    return _result(name, size_wh, observations, views, solved, dropped)


def flat_views(observations: CornerObservations, target: Target, least: int) -> list[View]:
    """What one camera saw of each patch, image by image; without those of fewer corners than `least`, or all on a line."""
    starts = observations.view_starts()
    corners = {patch: target.corners(patch) for patch in np.unique(observations.patch).tolist()}
    views = []
    for first, end in zip(starts, np.append(starts[1:], len(observations)), strict=True):
        xyz = corners[int(observations.patch[first])][observations.corner[first:end]]
        if len(xyz) >= least and in_a_plane(xyz):
            views.append(View(int(observations.t_ns[first]), xyz, observations.xy_img[first:end]))
    return views


@dataclass(frozen=True, eq=False)
class _Solved:
    K: Array
    distortion: Array
    sigma: Array
    rms_px: float
    view_rms_px: Array
    rotvec: Array
    xyz: Array


def _solve(views: list[View], size_wh: tuple[int, int]) -> _Solved:
    """The richest lens model whose last coefficients all differ from 0 by three standard errors."""
    for flags, newest in _MODELS:
        solved = solve_model(views, size_wh, flags)
        values = dict(zip(PARAMETERS[4:], solved.distortion, strict=True))
        sigma = dict(zip(PARAMETERS, solved.sigma, strict=True))
        if any(abs(values[n]) > _SIGNIFICANT * sigma[n] for n in newest):
            break
    return solved


def solve_model(views: list[View], size_wh: tuple[int, int], flags: int, start: Array | None = None) -> _Solved:
    """The intrinsics by Zhang's method; `flags` of OpenCV hold some of them, and `start` is where others begin."""
    calibrate: Any = cv2.calibrateCameraExtended  # whose stubs forbid None where the documentation asks for it
    with one_opencv_thread():
        rms, K, distortion, rotvec, xyz, sigma, _, per_view = calibrate(
            [view.xyz.astype(np.float32) for view in views],
            [view.xy.astype(np.float32).reshape(-1, 1, 2) for view in views],
            size_wh, start, None, flags=flags,
            criteria=(cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 200, 1e-10),
        )  # fmt: skip
    errors = np.asarray(sigma).ravel()[:9]
    return _Solved(
        K=np.asarray(K),
        distortion=np.asarray(distortion).ravel()[:5],
        sigma=errors,
        rms_px=float(rms),
        view_rms_px=np.asarray(per_view).ravel(),
        rotvec=np.asarray(rotvec).reshape(-1, 3),
        xyz=np.asarray(xyz).reshape(-1, 3),
    )


def _result(
    name: str, size_wh: tuple[int, int], observations: CornerObservations, views: list[View], solved: _Solved, dropped: int
) -> Intrinsics:
    times = np.array([view.t_ns for view in views])
    cells = coverage(observations.rows(np.isin(observations.t_ns, times))).cells[0]
    report = CalibrationReport(
        f"camera {name}: intrinsics",
        (*_checks(size_wh, solved, cells, len(views)), *_assumptions(views, solved)),
        notes=(f"{dropped} views left out that fitted far worse than the others",) if dropped else (),
        numbers={"rms_px": solved.rms_px, "views": len(views)}
        | dict(zip(PARAMETERS, [*solved.K[[0, 1, 0, 1], [0, 1, 2, 2]], *solved.distortion], strict=True))
        | {f"sigma_{p}": s for p, s in zip(PARAMETERS, solved.sigma, strict=True)},
    )
    report.require()
    camera = Camera(name=name, size_wh=size_wh, K=solved.K, cam_from_world=SE3.identity(), distortion=solved.distortion)
    return Intrinsics(camera=camera, cells=cells, report=report)


def _checks(size_wh: tuple[int, int], solved: _Solved, cells: Array, count: int) -> tuple[Check, ...]:
    focal = solved.K[[0, 1], [0, 1]]
    sigma = float((solved.sigma[:2] / focal).max())
    slant = _largest_slant(solved.rotvec)
    limit_px = _MOST_RMS_PX_PER_1000 * max(size_wh) / 1000
    centre_off = float(np.abs(solved.K[:2, 2] / size_wh - 0.5).max())
    aspect = float(focal[0] / focal[1])
    share = float((cells > 0).mean())
    return (
        Check(
            "slants differ",
            slant >= _LEAST_SLANT_RAD,
            f"the board was turned by up to {np.rad2deg(slant):.0f} deg between {count} views"
            f" (needed {np.rad2deg(_LEAST_SLANT_RAD):.0f})",
            "tilt the board this way and that",
        ),
        Check(
            "focal length is determined",
            sigma <= _MOST_SIGMA_FOCAL,
            f"standard error {sigma:.2%} of {focal.mean():.1f} px (limit {_MOST_SIGMA_FOCAL:.0%})",
            "the views are too few or too alike: add slanted ones, near and far",
        ),
        Check(
            "corners fit",
            solved.rms_px <= limit_px,
            f"rms {solved.rms_px:.2f} px (limit {limit_px:.2f})",
            "compare the board with its description; is it flat, and are the images sharp?",
        ),
        Check(
            "image is covered",
            share >= _LEAST_COVERAGE,
            f"{share:.0%} of the image (needed {_LEAST_COVERAGE:.0%})",
            "bring the board to the corners of the image",
        ),
        Check(
            "lens is plausible",
            centre_off < _MOST_CENTRE_SHARE and 1 / _MOST_ASPECT < aspect < _MOST_ASPECT,
            f"principal point {centre_off:.0%} off the middle (limit {_MOST_CENTRE_SHARE:.0%}), fx/fy {aspect:.3f}",
            "is the image cropped or squeezed? otherwise the views are too alike",
        ),
    )


def _largest_slant(rotvec: Array) -> float:
    """Largest angle between the normals of two views."""
    normals = SE3.from_rotvec(rotvec, np.zeros_like(rotvec)).matrix()[..., 2]
    return float(np.arccos(np.clip((normals @ normals.T).min(), -1, 1)))


# of each: name, what it does when it is let free, and the remedy
_PRINT = ("board is as described", "measure the print in both directions; print it again at 100 %, never 'fit to page'")
_FLAT = ("board is flat", "glue the print to something flat and stiff, without bubbles")
_FOCUS = ("focus is fixed", "switch autofocus, zoom and stabilisation off, and record again")
_PARTS = (0.25, 0.5, 0.75)


def _assumptions(views: list[View], solved: _Solved) -> tuple[Check, ...]:
    """What the solve takes for granted, each let free by itself in one linear step from the solution.

    One fails when it changes focal length or principal point by more than `LIMITS.focal_share` of the focal length, and differs
    from 0 by `LIMITS.lens_sigma` standard errors. An error in one shows in others, so that only the surest fails.
    """
    kept = np.flatnonzero(solved.sigma > 0)
    rows = [_freed(view, solved, i, kept) for i, view in enumerate(views)]
    view, all_rows = np.repeat(np.arange(len(rows)), [len(part) for part in rows]), np.concatenate(rows)
    lens, (zoom, stretch, *bows), off = all_rows[:, : len(kept)], all_rows[:, len(kept) : -1].T, all_rows[:, -1]
    nearness = 1 / np.array([_depth_m(one, solved, i) for i, one in enumerate(views)])
    far, near = np.percentile(nearness, [10, 90])
    by_depth = (nearness - far) / max(near - far, 1e-9) - 0.5
    parts = [(np.arange(len(views)) >= part * len(views)) - 0.5 for part in _PARTS]
    half_m = max(float(np.ptp(one.xyz[:, :2], axis=0).max()) for one in views) / 2
    # the assumption, the change in words, what it is a multiple of, and whether it is itself a share of the focal length
    freed: list[tuple[tuple[str, str], str, Array, bool]] = [
        (_PRINT, "{0:+.2%} longer upwards than across", stretch, False),
        *((_FLAT, "bent by {1:.1f} mm", bow, False) for bow in bows),
        (_FOCUS, "focal length {0:+.1%} between far and near", zoom * by_depth[view], True),
        *((_FOCUS, "focal length {0:+.1%} between earlier and later views", zoom * part[view], True) for part in parts),
    ]
    scale = np.linalg.norm(lens, axis=0)
    freedom = len(off) - len(kept) - 6 * len(views)
    found = []
    for assumed, words, column, of_focal in freed:
        absorbed = np.linalg.lstsq(lens / scale, np.stack([column, off], axis=1), rcond=None)[0]
        alone, left = (np.stack([column, off], axis=1) - lens / scale @ absorbed).T
        known = max(float(alone @ alone), 1e-30)
        change = float(alone @ left) / known
        sigma = float(np.sqrt(((left - alone * change) ** 2).sum() / freedom / known))
        # fx, fy, cx, cy come first
        moves = np.abs(change * (absorbed[:, 0] / scale)[:4] / solved.K[[0, 1, 0, 1], [0, 1, 0, 1]]).max()
        share = abs(change) if of_focal else float(moves)
        moved = "" if of_focal else f", which moves focal length or principal point by {share:.1%} of the focal length"
        line = f"{words.format(change, 1e3 * abs(change) * half_m**2)}{moved} (limit {LIMITS.focal_share:.1%})"
        found.append((abs(change) / sigma, share > LIMITS.focal_share, assumed, line))
    found.sort(key=lambda one: one[0], reverse=True)
    wrong = [one for one in found if one[1] and one[0] >= LIMITS.lens_sigma]
    lines = {assumed: line for *_, assumed, line in reversed(found)}
    if wrong and wrong[0] is not found[0]:
        lines[found[0][2]] += f"; it shows as {wrong[0][3]}"
    return tuple(Check(one[0], not (wrong and one == found[0][2]), line, one[1]) for one, line in lines.items())


def _freed(view: View, solved: _Solved, i: int, kept: Array) -> Array:
    """(2n, lens + 6) derivatives of a view's image points, less what its pose absorbs: by the intrinsics that were solved for, a
    share of both focal lengths, of the board's height, its curvatures (3, 1/m); and at last how far the points are off."""
    step, (pose, shift) = 1e-4, (solved.rotvec[i], solved.xyz[i])
    xy, by_pose = cv2.projectPoints(view.xyz, pose, shift, solved.K, solved.distortion)
    across, up = (view.xyz[:, :2] - view.xyz[:, :2].mean(axis=0)).T
    none = np.zeros_like(up)
    board = [np.stack([none, up, none], axis=1)]
    board += [np.stack([none, none, bow], axis=1) for bow in (across**2, up**2, across * up)]
    changed = [cv2.projectPoints(view.xyz + step * one, pose, shift, solved.K, solved.distortion)[0] for one in board]
    by_board = np.stack([(one - xy).ravel() / step for one in changed], axis=1)
    by_lens = by_pose[:, 6:15]
    zoom = by_lens[:, :2] @ solved.K[[0, 1], [0, 1]]
    rows = np.column_stack([by_lens[:, kept], zoom, by_board, (view.xy - xy[:, 0]).ravel()])
    absorbed, _ = np.linalg.qr(by_pose[:, :6])
    return np.asarray(rows - absorbed @ (absorbed.T @ rows))


def _depth_m(view: View, solved: _Solved, i: int) -> float:
    return float((SE3.from_rotvec(solved.rotvec[i], solved.xyz[i]) @ view.xyz)[:, 2].mean())
