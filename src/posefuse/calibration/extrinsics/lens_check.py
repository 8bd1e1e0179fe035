"""What a rig would rather have for intrinsics, or for the shape of its board, when they are let free, and how surely."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from posefuse.calibration.report import Check
from posefuse.core import Camera
from posefuse.core.arrays import Array

from .limits import LIMITS
from .pipeline import Solved
from .prop_solve import Freedom, PropSolution, solve_prop
from .snapshots import Snapshots

# what remains of the radius of a camera's image points when the farthest are left out
_RIM_QUANTILE = 0.95
# by so many standard errors each half must show a change, so that one bad stretch of time stamps does not make it
_EACH_PART_SIGMA = 3.0


@dataclass(frozen=True, eq=False, kw_only=True)
class LensChange:
    """Change of each camera's intrinsics (C,) when they are let free.

    Attributes:
        size, sigma: (C, 3) with standard errors, of the focal length as a share, of the principal point as an angle, and of the
            image points at the rim of what was seen, by distortion alone, in px.
        confirmed: (C, 3) whether these may be called wrong.
    """

    size: Array
    sigma: Array
    confirmed: Array

    def excess(self, cameras: Sequence[Camera]) -> Array:
        """(C, 3) over their limits: more than 1 is wrong."""
        excess = np.abs(self.size) / np.maximum(_least(cameras), LIMITS.lens_sigma * self.sigma)
        return np.where(self.confirmed, excess, np.minimum(excess, 1.0))

    def confirmed_by(self, parts: Sequence[LensChange]) -> LensChange:
        """The same, counting only what two parts of the data show alike: each by some standard errors, and by as much.

        Noise makes standard errors; a lens model that is not quite the lens errs differently in each part, and by far more. Half
        the difference of the parts is the standard error of their mean that they themselves show: the change is to be two of it.
        """
        if len(parts) != 2:
            return self
        one, two = (part.size / np.maximum(part.sigma, 1e-12) for part in parts)
        sure = (np.minimum(np.abs(one), np.abs(two)) >= _EACH_PART_SIGMA) & (one * two > 0)
        return replace(self, confirmed=sure & (np.abs(parts[0].size - parts[1].size) <= np.abs(self.size)))

    def words(self, cameras: Sequence[Camera], camera: int, kind: int) -> str:
        """What one camera's intrinsics would rather be: kind 0 focal length, 1 principal point, 2 distortion."""
        size, sigma = float(self.size[camera, kind]), float(self.sigma[camera, kind])
        limit, name = max(float(_least(cameras)[camera, kind]), LIMITS.lens_sigma * sigma), cameras[camera].name
        if kind == 0:
            said, error = f"focal length would rather be {size:+.1%}", f"{sigma:.2%}, limit {limit:.1%}"
        elif kind == 1:
            size, sigma, limit = np.rad2deg([size, sigma, limit])
            said, error = f"principal point would rather be {size:.1f} deg elsewhere", f"{sigma:.1f} deg, limit {limit:.1f}"
        else:
            said, error = (
                f"distortion would rather move points at the rim by {size:+.1f} px",
                f"{sigma:.1f} px, limit {limit:.1f}",
            )
        return f"{name}'s {said} (standard error {error})"


def _least(cameras: Sequence[Camera]) -> Array:
    """(C, 3) limits of the sizes of a change."""
    bend_px = [LIMITS.bend_px_per_1000 * max(camera.size_wh) / 1000 for camera in cameras]
    return np.array([(LIMITS.focal_share, LIMITS.centre_rad, px) for px in bend_px])


def lens_change(cameras: Sequence[Camera], held: PropSolution, free: PropSolution, seen: Snapshots) -> LensChange:
    """How the intrinsics of `free` differ from those of `held`."""
    focal_px = np.array([camera.K[0, 0] for camera in cameras])
    delta, covariance = free.state.lens_delta - held.state.lens_delta, free.lens_covariance
    rim = np.array([rim_radius(camera, seen.xy_img[seen.camera == i]) for i, camera in enumerate(cameras)])
    slope = np.zeros((2, len(cameras), 6))
    slope[0, :, :2] = 0.5 / focal_px[:, None]
    slope[1, :, 4], slope[1, :, 5] = focal_px * rim**3, focal_px * rim**5
    focal, bend = (slope * delta).sum(axis=-1)
    focal_sigma, bend_sigma = np.sqrt(np.einsum("kci,cij,kcj->kc", slope, covariance, slope))
    centre = np.linalg.norm(delta[:, 2:4], axis=1) / focal_px
    centre_sigma = np.sqrt(np.trace(covariance[:, 2:4, 2:4], axis1=1, axis2=2)) / focal_px
    return LensChange(
        size=np.stack([focal, centre, bend], axis=1), sigma=np.stack([focal_sigma, centre_sigma, bend_sigma], axis=1),
        confirmed=np.ones((len(cameras), 3), bool),
    )  # fmt: skip


def rim_radius(camera: Camera, xy_img: Array) -> float:
    """Radius on the ideal image plane within which most of the points lie."""
    if len(xy_img) == 0:
        return 0.0
    return float(np.quantile(np.linalg.norm((xy_img - camera.K[:2, 2]) / camera.K[0, 0], axis=1), _RIM_QUANTILE))


def check_lenses(cameras: Sequence[Camera], change: LensChange) -> Check:
    """The intrinsics, when they are let free, stay."""
    excess = change.excess(cameras)
    worst, kind = (int(i) for i in np.unravel_index(np.argmax(excess), excess.shape))
    unsure = "" if change.confirmed[worst, kind] else "; the halves of the recording do not agree on it"
    return Check(
        "intrinsics fit", bool(excess[worst, kind] <= 1), change.words(cameras, worst, kind) + unsure,
        "focus or zoom has changed since they were calibrated, or they belong to another camera or image size:"
        " calibrate them again, or let them move with `focal_known_to_percent=3`", "lenses",
    )  # fmt: skip


# shares tried on both sides, first roughly, then about what was found
_STEPS, _FARTHEST = (0.02, 0.005), 0.1


@dataclass(frozen=True, eq=False)
class Stretch:
    """How much longer a board is in one direction than described (share), its standard error, and the solve with it."""

    share: float
    sigma: float
    solution: PropSolution


def best_stretch(solved: Solved, cameras: tuple[Camera, ...]) -> Stretch | None:
    """By parabolas through three solves each; None where more of it never fits worse."""
    corners = solved.corners
    middle = (corners.max(axis=(0, 1)) + corners.min(axis=(0, 1))) / 2

    def solution_at(share: float) -> PropSolution:
        bent = replace(solved, corners=corners + share * (corners - middle) * [0, 1, 0])
        freedom = Freedom(reference=solved.links.reference, held_patches=solved.links.shape.held)
        return solve_prop(bent.seen, bent.corners, cameras, solved.solution.state, freedom)

    share, sigma = 0.0, 0.0
    for step in _STEPS:
        tried = [solution_at(share + k * step) for k in (-1, 0, 1)]
        low, level, high = (_cost(one, min(other.sigma_px for other in tried)) for one in tried)
        curve = low + high - 2 * level
        if curve <= 0:
            return None
        share = float(np.clip(share + step * (low - high) / (2 * curve), -_FARTHEST, _FARTHEST))
        # the cost is twice the negative logarithm of the likelihood
        sigma = float(step * np.sqrt(2 / curve))
    return Stretch(share, sigma, solution_at(share))


def _cost(solution: PropSolution, sigma_px: float) -> float:
    square = np.nan_to_num((solution.residual_px**2).sum(axis=1) / sigma_px**2, nan=1e3)
    return float((9 * np.log1p(square / 9)).sum())


def check_board_shape(found: Stretch | None) -> Check:
    """The board is as long in one direction as in the other, as described."""
    share, sigma = (0.0, 0.0) if found is None else (found.share, found.sigma)
    return Check(
        "board is as described", abs(share) <= max(LIMITS.stretch_share, LIMITS.lens_sigma * sigma),
        f"the board fits best as {share:+.2%} longer in one direction (standard error {sigma:.2%}, limit"
        f" {LIMITS.stretch_share:.0%})",
        "print at 100 % in both directions, glue it to a flat plate, and measure it along both sides", "input",
    )  # fmt: skip
