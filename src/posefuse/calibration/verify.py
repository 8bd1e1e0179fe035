"""How true a rig is, measured with a target it was not made from, held anywhere: millimetres and pixels."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from posefuse.calibration.extrinsics.prop_solve import Freedom, SolvedRig, focal_change, focal_sigma
from posefuse.calibration.extrinsics.snapshots import Snapshots, evenly, snapshots
from posefuse.calibration.extrinsics.world import aligned, placed_by_rig, triangulate_linear
from posefuse.calibration.geometry import Lenses, angle_between, centre_covariance_m2
from posefuse.calibration.targets.corners import CornerObservations
from posefuse.calibration.targets.kinds import Target, check_one_end
from posefuse.core import CalibrationError, Rig
from posefuse.core.arrays import Array

from .report import CalibrationReport, Check

# time steps that are measured: of all cameras, and of each at least
_MOST_VIEWS, _LEAST_VIEWS = 80, 25
# what is known of a focal length before it is let free, as a share; the other intrinsics are taken as given
_FREE_FOCAL = 0.2


@dataclass(frozen=True)
class VerifyLimits:
    """What refuses a camera in verification.

    Attributes:
        turn_rad, shift_m: of the pose: 0.2 deg is 14 mm at 4 m. focal_share: of the focal length. late_s: of the clock.
            All by judgement: what the fusion of a person's keypoints begins to show.
        effect_px_per_1000: and what the errors together do to the image, per 1000 px of width: 1.5 is about 0.1 deg. Errors that
            cancel in the image (a longer focal length from farther away) hardly show at a person. Judgement; a real rig of
            four webcams has 0.7.
        sigma: standard errors of that effect, which is known where single errors are not (they may cancel). views: least views
            shared with other cameras.
    """

    turn_rad: float = float(np.deg2rad(0.2))
    shift_m: float = 0.012
    focal_share: float = 0.01
    late_s: float = 0.004
    effect_px_per_1000: float = 1.5
    sigma: float = 5.0
    views: int = 10


VERIFY_LIMITS = VerifyLimits()
_JUST_WRONG = 1.01


@dataclass(frozen=True, kw_only=True)
class CameraError:
    """One camera against the others, with standard errors; NaN where it shares too few views.

    Attributes:
        name, views: shared with other cameras.
        turn_rad, shift_m: of its pose. focal: share of its focal length. late_s: of its clock.
        effect: what they do together to the image, in px (rms) per 1000 px of width.
        effect_sigma: its standard error.
        noise_px: spread of a corner coordinate that is left.
        unlikely: how badly all cameras fit while this one is free: mean negative log-likelihood of a corner (Cauchy).
        odd: the others agree without it alone, though by its own error alone it would pass.
    """

    name: str
    views: int
    turn_rad: float = np.nan
    turn_sigma: float = np.nan
    shift_m: float = np.nan
    shift_sigma: float = np.nan
    focal: float = np.nan
    focal_sigma: float = np.nan
    late_s: float = np.nan
    late_sigma: float = np.nan
    effect: float = np.nan
    effect_sigma: float = np.nan
    noise_px: float = np.nan
    unlikely: float = np.nan
    odd: bool = False

    @property
    def excess(self) -> float:
        """The largest error over its limit; more than 1 is wrong, NaN is not known."""
        limits = VERIFY_LIMITS
        pairs = (
            (self.turn_rad, limits.turn_rad), (self.shift_m, limits.shift_m), (self.focal, limits.focal_share),
            (self.late_s, limits.late_s),
        )  # fmt: skip
        single = max(abs(value) / most for value, most in pairs)
        effect = self.effect / max(limits.effect_px_per_1000, limits.sigma * self.effect_sigma)
        return max(min(single, effect), _JUST_WRONG if self.odd else 0.0)

    @property
    def words(self) -> str:
        """The errors, for people."""
        return (
            f"{self.name} is turned by {np.rad2deg(self.turn_rad):.2f} ± {np.rad2deg(self.turn_sigma):.2f} deg, shifted by"
            f" {self.shift_m * 1e3:.1f} ± {self.shift_sigma * 1e3:.1f} mm, its focal length off by {self.focal:+.2%} ±"
            f" {self.focal_sigma:.2%}, its clock {self.late_s * 1e3:+.1f} ± {self.late_sigma * 1e3:.1f} ms late:"
            f" {self.effect:.1f} ± {self.effect_sigma:.1f} px per 1000"
        )


def camera_errors(rig: Rig, seen: Snapshots, target: Target) -> tuple[CameraError, ...]:
    """Each camera against those that are not found wrong.

    As long as one is wrong, the camera goes without which the others agree best: a wrong camera makes others look wrong that are
    measured against it, often more than itself. In the end those that went are measured against those that stayed.
    """
    views = _each_patch_alone(seen)
    trusted, gone = {int(c) for c in np.unique(views.camera)}, []
    found = {c: _against(rig, views, target, c, trusted - {c}) for c in range(len(rig))}
    while len(trusted) > 2:
        known = [found[c] for c in trusted if np.isfinite(found[c].turn_rad)]
        if not any(one.excess > 1 for one in known):
            break
        gone.append(rig.names.index(min(known, key=lambda one: one.unlikely).name))
        trusted.discard(gone[-1])
        again = {c: _against(rig, views, target, c, trusted - {c}) for c in range(len(rig))}
        found |= {c: one for c, one in again.items() if np.isfinite(one.turn_rad)}
    if gone and not any(one.excess > 1 for one in found.values()):
        found[gone[0]] = replace(found[gone[0]], odd=True)
    return tuple(found[c] for c in range(len(rig)))


def _each_patch_alone(seen: Snapshots) -> Snapshots:
    """Every marker at every time step as a target of its own, on at most so many of them that several cameras see."""
    key = seen.time_step * len(seen.patches) + seen.patch
    used, place = np.unique(key, return_inverse=True)
    present = np.zeros((len(used), int(seen.camera.max(initial=0)) + 1), bool)
    present[place, seen.camera] = True
    several = np.flatnonzero(present.sum(axis=1) >= 2)
    chosen = evenly(several, _MOST_VIEWS)
    for c in range(present.shape[1]):
        # a camera that seldom sees the target needs more than its share
        if present[chosen, c].sum() < _LEAST_VIEWS:
            chosen = np.union1d(chosen, evenly(several[present[several, c]], _LEAST_VIEWS))
    number = np.full(len(used), -1)
    number[chosen] = np.arange(len(chosen))
    t_s = seen.t_s[used[chosen] // len(seen.patches)]
    alone = replace(seen, t_s=t_s, time_step=number[place], patch=np.zeros(len(place), np.int64), patches=seen.patches[:1])
    return alone.rows(number[place] >= 0)


def _against(rig: Rig, views: Snapshots, target: Target, c: int, others: Iterable[int]) -> CameraError:
    """One camera's pose, focal length and clock are free, the others fixed."""
    trusted = sorted(others)
    shared = np.unique(views.time_step[np.isin(views.camera, trusted)])
    seen = views.rows(np.isin(views.camera, [*trusted, c]) & np.isin(views.time_step, shared))
    count = len(np.unique(seen.time_step[seen.camera == c]))
    sigma = focal_sigma((rig.cameras[c],), _FREE_FOCAL)
    freedom = Freedom(reference=None, held_patches=None, offset=True, lens_sigma=sigma, lens_of=(c,), moving=(c,))
    enough = trusted and count >= VERIFY_LIMITS.views
    freed = placed_by_rig(rig, seen, seen.rows(seen.camera != c), target, freedom) if enough else None
    return CameraError(name=rig.names[c], views=count) if freed is None else _error(freed, c, count)


def _effect(freed: SolvedRig, c: int) -> tuple[float, float]:
    """How far the camera as it is sees points from where the camera of the rig would, px (rms) per 1000 px of width; and the
    standard error."""
    camera, solution, of_camera = freed.cameras[c], freed.solution, freed.seen.camera == c
    mine = freed.seen.rows(of_camera)
    xyz = solution.state.world_from_prop[mine.time_step].move(freed.corners[mine.patch, mine.corner])
    before, after = camera.cam_from_world @ xyz, solution.state.cam_from_world[mine.camera].move(xyz)
    late_s = solution.state.delay_s[c, 0]
    apart = (
        Lenses(freed.cameras, solution.state.lens_delta).px(mine.camera, after)
        - mine.velocity_px_s * late_s
        - Lenses(freed.cameras).px(mine.camera, before)
    )
    squares = np.nanmean((apart**2).sum(axis=1)), np.nanmean(solution.predicted_sigma_px[of_camera] ** 2)
    effect, sigma = np.sqrt(squares) * 1000 / max(camera.size_wh)
    return float(effect), float(sigma)


def _error(freed: SolvedRig, c: int, count: int) -> CameraError:
    camera, solution = freed.cameras[c], freed.solution
    before, after, covariance = camera.cam_from_world, solution.state.cam_from_world, solution.camera_covariance[c]
    turn = float(angle_between(after.R[c][None], before.matrix()[None])[0])
    shift = float(np.linalg.norm(after.inverse().t[c] - camera.centre_world))
    focal, focal_error = (float(one[c]) for one in focal_change(freed))
    off_px = np.linalg.norm(solution.residual_px, axis=1)
    effect, effect_sigma = _effect(freed, c)
    return CameraError(
        name=camera.name,
        views=count,
        turn_rad=turn,
        turn_sigma=float(np.sqrt(np.trace(covariance[:3, :3]))),
        shift_m=shift,
        shift_sigma=float(np.sqrt(np.trace(centre_covariance_m2(after[c], covariance)))),
        focal=focal,
        focal_sigma=focal_error,
        late_s=float(solution.state.delay_s[c, 0]),
        late_sigma=float(solution.delay_sigma_s[c, 0]),
        effect=effect,
        effect_sigma=effect_sigma,
        noise_px=solution.sigma_px,
        unlikely=float(np.log(solution.sigma_px) + np.log1p((off_px / solution.sigma_px) ** 2).mean()),
    )


# chosen, not fitted: error of the scale that a rig may have
_MOST_SCALE_ERROR = 0.007
# chosen, not fitted: coarse, of all corners together; single cameras are judged by `VerifyLimits`
_MOST_REPROJECTION_PX_PER_1000 = 2.5
_LEAST_LENGTHS = 20
# chosen, not fitted: the misfit that is left when the names of two cameras are swapped, and pairs that leave about as little
# (of four cameras in a ring, swapping two opposite ones is swapping the other two)
_SWAP_LEAVES, _SWAP_ALIKE = 0.2, 1.5


@dataclass(frozen=True, eq=False, kw_only=True)
class Verification:
    """What was measured.

    Attributes:
        length_error_m: (L,) measured minus true distances between corners of one patch at one time step.
        cameras: turn, shift, focal length and clock of each camera against the others.
        report: checks.
    """

    length_error_m: Array
    cameras: tuple[CameraError, ...]
    report: CalibrationReport


def verify(rig: Rig, observations: CornerObservations, target: Target, late_s: Array | None = None) -> Verification:
    """Triangulate a target's corners wherever 2 cameras see them, and compare the distances between them with the truth.

    Args:
        rig: to be verified. observations: of an extra marker or board. late_s: (C,) clocks of the cameras, as calibrated.

    Raises:
        CalibrationError: too few lengths for a result, or a chessboard, whose corners cameras count from different ends.
    """
    check_one_end(target)
    observations = aligned(observations, rig)
    if len(observations) == 0:
        raise CalibrationError("verification: no camera sees the target")
    delay = np.zeros((len(rig), 2))
    delay[:, 0] = 0.0 if late_s is None else late_s
    times = np.unique(observations.t_ns)
    seen = snapshots(observations, times, delay)
    key, point = np.unique(np.stack([seen.time_step, seen.patch, seen.corner], axis=1), axis=0, return_inverse=True)
    point = point.ravel()
    xy = np.full((len(rig), len(key), 2), np.nan)
    xy[seen.camera, point] = seen.xy_img
    xyz = triangulate_linear(rig, xy)
    off = rig.project(xyz) - xy
    found = camera_errors(rig, seen, target)
    corners = np.stack([target.corners(int(patch)) for patch in seen.patches])
    # the rays of swapped cameras may meet behind one of them, where no length can be measured
    in_front = np.isfinite(off).all(axis=2).sum(axis=0) >= 2
    error, true = _lengths(key[in_front], xyz[in_front], corners)
    if len(error) < _LEAST_LENGTHS:
        raise CalibrationError(
            f"verification: {len(error)} lengths measured, at least {_LEAST_LENGTHS} are needed;"
            " hold the target where two cameras see it, and check that each video is of the camera that it is named after"
        )
    swapped = "" if all(one.excess <= 1 for one in found if one.noise_px > 0) else _swapped(rig, xy)
    report = _report(rig, error, true, swapped=swapped, reprojection_px=_rms((off**2).sum(axis=-1)), found=found)
    return Verification(length_error_m=error, cameras=found, report=report)


def _lengths(key: Array, xyz: Array, corners: Array) -> tuple[Array, Array]:
    """Errors and true values of all distances between corners of one patch at one time step."""
    image = np.unique(key[:, :2], axis=0, return_inverse=True)[1].ravel()
    order = np.argsort(image, kind="stable")
    cuts = np.flatnonzero(np.diff(image[order])) + 1
    error, true = [np.zeros(0)], [np.zeros(0)]
    for rows in np.split(order, cuts) if len(order) else []:
        i, j = np.triu_indices(len(rows), 1)
        nominal = corners[key[rows[0], 1], key[rows, 2]]
        wanted = np.linalg.norm(nominal[i] - nominal[j], axis=1)
        error.append(np.linalg.norm(xyz[rows[i]] - xyz[rows[j]], axis=1) - wanted)
        true.append(wanted)
    return np.concatenate(error), np.concatenate(true)


def _rms(square: Array) -> Array:
    """(C,) root mean square of what is known of (C, P); NaN for a camera without any."""
    known = np.isfinite(square)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.sqrt(np.where(known, square, 0.0).sum(axis=1) / known.sum(axis=1)))


def swapped_cameras(rig: Rig, misfit: Callable[[Array], float], most: float) -> tuple[list[tuple[int, int]], float]:
    """Pairs of cameras with images of one size whose swap leaves less than `most`: the best, and others about as good.

    Args:
        misfit: of the rig, with the cameras' images in an order (C,).

    Returns:
        The pairs, none where no swap leaves so little; and what the best one leaves.
    """
    left = {}
    for a, b in combinations(range(len(rig)), 2):
        if rig.cameras[a].size_wh == rig.cameras[b].size_wh:
            order = np.arange(len(rig))
            order[[a, b]] = b, a
            left[a, b] = misfit(order)
    best = min(left.values(), default=np.inf)
    as_good = _SWAP_ALIKE * best if best < most else -np.inf
    return [pair for pair, value in left.items() if value < as_good], best


def pairs_in_words(rig: Rig, pairs: Sequence[tuple[int, int]]) -> str:
    """Either pair of cameras, by their names."""
    return " or ".join(f"{rig.names[a]} and {rig.names[b]}" for a, b in pairs)


def _swapped(rig: Rig, xy: Array) -> str:
    """Which two cameras have each other's name, in words; empty where no swap makes the rays of corners (C, P, 2) meet."""
    now_px = _median_px(rig, xy)
    pairs, best_px = swapped_cameras(rig, lambda order: _median_px(rig, xy[order]), _SWAP_LEAVES * now_px)
    words = f"{pairs_in_words(rig, pairs)} have swapped names: so corners are {best_px:.1f} px off, not {now_px:.1f}"
    return words if pairs else ""


def _median_px(rig: Rig, xy: Array) -> float:
    off_px = np.linalg.norm(rig.project(triangulate_linear(rig, xy)) - xy, axis=-1)
    known = off_px[np.isfinite(off_px)]
    return float(np.median(known)) if len(known) else np.inf


def _camera_checks(found: tuple[CameraError, ...], swapped: str) -> tuple[Check, Check]:
    unseen = [
        f"{one.name} ({one.views} views shared with others, needed {VERIFY_LIMITS.views})"
        for one in found
        if np.isnan(one.turn_rad)
    ]
    known = [one for one in found if not np.isnan(one.turn_rad)]
    wrong = [one for one in known if one.excess > 1]
    worst = max(known, key=lambda one: one.excess, default=None)
    detail = (
        swapped or "; ".join(one.words for one in wrong) or (f"the worst: {worst.words}" if worst else "no camera was measured")
    )
    return (
        Check("cameras are where the rig has them", not wrong, detail,
              "give each camera the name it had in the calibration" if swapped else
              "it was moved, zoomed or refocused since the calibration, or its clock differs: calibrate again", "rig"),
        Check("every camera is measured", not unseen, f"not verified: {', '.join(unseen)}" if unseen else "all saw the target",
              "hold the target where this camera and another see it, or leave the camera out"),
    )  # fmt: skip


def _report(
    rig: Rig,
    error: Array,
    true: Array,
    swapped: str,
    reprojection_px: Array,
    found: tuple[CameraError, ...],
) -> CalibrationReport:
    rms, scale = float(np.sqrt((error**2).mean())), float(np.median(1 + error / true))
    worst = int(np.nanargmax(reprojection_px))
    width_px = max(rig.cameras[worst].size_wh)
    limit_px = _MOST_REPROJECTION_PX_PER_1000 * width_px / 1000
    worst_px = f"{reprojection_px[worst]:.2f} px rms" if reprojection_px[worst] < width_px else f"more than {width_px} px rms"
    checks = (
        *_camera_checks(found, swapped),
        Check("scale is right", abs(scale - 1) <= _MOST_SCALE_ERROR,
              f"lengths measure {scale:.4f} of the truth (limit {_MOST_SCALE_ERROR:.1%} off); {len(error)} of them are"
              f" {rms * 1e3:.2f} mm off (rms)",
              "a wrong marker side, here or in the calibration", "rig"),
        Check("reprojection", bool(reprojection_px[worst] <= limit_px),
              f"{rig.names[worst]} is worst with {worst_px} (limit {limit_px:.2f})",
              "this camera moved, or its intrinsics are wrong", "rig"),
    )  # fmt: skip
    numbers = {"length_rms_mm": rms * 1e3, "scale": scale, "lengths": float(len(error))}
    for one in found:
        numbers |= {f"{one.name}_turn_deg": float(np.rad2deg(one.turn_rad)), f"{one.name}_shift_mm": one.shift_m * 1e3,
                    f"{one.name}_focal_percent": 1e2 * one.focal, f"{one.name}_late_ms": 1e3 * one.late_s}  # fmt: skip
    numbers |= {f"{name}_reprojection_px": float(px) for name, px in zip(rig.names, reprojection_px, strict=True)}
    return CalibrationReport("verification", checks, numbers=numbers)
