"""What a rig would rather have for intrinsics, or for the shape of its board, when they are let free, and how surely."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from posefuse.calibration.report import Check
from posefuse.core import Camera
from posefuse.core.arrays import Array

from .limits import Limits
from .pipeline import Solved
from .prop_solve import Freedom, PropSolution, solve_prop
from .self_checks import camera_differences
from .snapshots import Snapshots

# what remains of the radius of a camera's image points when the farthest are left out
_RIM_QUANTILE = 0.95
# by so many standard errors each half must show a change, so that one bad stretch of time stamps does not make it
_EACH_PART_SIGMA = 3.0
# which of the lens parameters are the principal point
_CENTRE = np.array([0, 0, 1, 1, 0, 0])


@dataclass(frozen=True, eq=False, kw_only=True)
class LensChange:
    """Change of each camera's intrinsics (C,) when they are let free, with standard errors.

    Attributes:
        focal: share of the focal length. centre_rad: shift of the principal point, as an angle; most of it is taken up by the
            camera's rotation. centre_effect: what is left: how far it moves a camera, as a share of the target's distance.
            bend_px: shift of the image points at the rim of what was seen, by distortion alone.
        confirmed: (C, 3) whether focal length, principal point and distortion may be called wrong.
    """

    focal: Array
    focal_sigma: Array
    centre_rad: Array
    centre_sigma: Array
    centre_effect: Array
    bend_px: Array
    bend_sigma: Array
    confirmed: Array

    def excess(self, cameras: Sequence[Camera], limits: Limits) -> Array:
        """(C, 3) focal length, principal point and distortion over their limits: more than 1 is wrong."""
        width = np.array([max(camera.size_wh) for camera in cameras])
        # the effect is known as well as the shift is, in shares of itself
        effect_sigma = self.centre_effect * self.centre_sigma / np.maximum(self.centre_rad, 1e-12)
        pairs = (
            (self.focal, self.focal_sigma, limits.focal_share),
            (self.centre_effect, effect_sigma, limits.centre_share),
            (self.bend_px, self.bend_sigma, limits.bend_px_per_1000 * width / 1000),
        )
        excess = np.stack([np.abs(v) / np.maximum(least, limits.lens_sigma * sigma) for v, sigma, least in pairs], axis=1)
        return np.where(self.confirmed, excess, np.minimum(excess, 1.0))

    def confirmed_by(self, parts: Sequence[LensChange]) -> LensChange:
        """The same, counting only what two parts of the data show alike: each by some standard errors, and by as much.

        Noise makes standard errors; a lens model that is not quite the lens errs differently in each part, and by far more. Half
        the difference of the parts is the standard error of their mean that they themselves show: the change is to be two of it.
        """
        if len(parts) != 2:
            return self
        one, two = (part.sizes() / np.maximum(part.sigmas(), 1e-12) for part in parts)
        sure = (np.minimum(np.abs(one), np.abs(two)) >= _EACH_PART_SIGMA) & (one * two > 0)
        apart = np.abs(parts[0].sizes() - parts[1].sizes())
        return replace(self, confirmed=sure & (apart <= np.abs(self.sizes())))

    def sizes(self) -> Array:
        """(C, 3) change of focal length (share), principal point (rad) and distortion (px)."""
        return np.stack([self.focal, self.centre_rad, self.bend_px], axis=1)

    def sigmas(self) -> Array:
        """(C, 3) standard errors of `sizes`."""
        return np.stack([self.focal_sigma, self.centre_sigma, self.bend_sigma], axis=1)


def lens_change(
    cameras: Sequence[Camera], held: PropSolution, free: PropSolution, seen: Snapshots, distance_m: float
) -> LensChange:
    """How the intrinsics of `free` differ from those of `held`; `distance_m`: usual distance of the target."""
    focal_px = np.array([camera.K[0, 0] for camera in cameras])
    delta = free.state.lens_delta - held.state.lens_delta
    covariance = free.lens_covariance
    mean = np.array([0.5, 0.5, 0, 0, 0, 0])
    rim = np.array([rim_radius(camera, seen.xy_img[seen.camera == i]) for i, camera in enumerate(cameras)])
    bend = np.zeros((len(cameras), 6))
    bend[:, 4], bend[:, 5] = focal_px * rim**3, focal_px * rim**5
    centre_px, centre_sigma = delta[:, 2:4], np.sqrt(np.diagonal(covariance[:, 2:4, 2:4], axis1=1, axis2=2))
    return LensChange(
        focal=delta @ mean / focal_px,
        focal_sigma=np.sqrt(np.einsum("i,cij,j->c", mean, covariance, mean)) / focal_px,
        centre_rad=np.linalg.norm(centre_px, axis=1) / focal_px,
        centre_sigma=np.linalg.norm(centre_sigma, axis=1) / focal_px,
        centre_effect=np.array([_moved_m(free, c, delta[c] * _CENTRE).max() / distance_m for c in range(len(cameras))]),
        bend_px=(bend * delta).sum(axis=1),
        bend_sigma=np.sqrt(np.einsum("ci,cij,cj->c", bend, covariance, bend)),
        confirmed=np.ones((len(cameras), 3), bool),
    )


def _moved_m(free: PropSolution, camera: int, change: Array) -> Array:
    """(C,) how far each camera moves against the others when one camera's intrinsics change by `change` (6,) and are held."""
    poses = free.state.cam_from_world
    follow = free.pose_by_lens[:, :, camera] @ change
    return camera_differences(poses, poses.stepped(follow))[0]


def rim_radius(camera: Camera, xy_img: Array) -> float:
    """Radius on the ideal image plane within which most of the points lie."""
    if len(xy_img) == 0:
        return 0.0
    return float(np.quantile(np.linalg.norm((xy_img - camera.K[:2, 2]) / camera.K[0, 0], axis=1), _RIM_QUANTILE))


def check_lenses(cameras: Sequence[Camera], change: LensChange, limits: Limits) -> Check:
    """The intrinsics, when they are let free, stay."""
    excess = change.excess(cameras, limits)
    worst, kind = (int(i) for i in np.unravel_index(np.argmax(excess), excess.shape))
    unsure = "" if change.confirmed[worst, kind] else "; the halves of the recording do not agree on it"
    return Check(
        "intrinsics fit", bool(excess[worst, kind] <= 1), lens_words(cameras, change, limits, worst, kind) + unsure,
        "focus or zoom has changed since they were calibrated, or they belong to another camera or image size:"
        " calibrate them again, or let them move with `focal_known_to_percent=3`", "lenses",
    )  # fmt: skip


def lens_words(cameras: Sequence[Camera], change: LensChange, limits: Limits, camera: int, kind: int) -> str:
    """What one camera's intrinsics would rather be: kind 0 focal length, 1 principal point, 2 distortion."""
    name = cameras[camera].name
    if kind == 0:
        limit = max(limits.focal_share, limits.lens_sigma * float(change.focal_sigma[camera]))
        return (
            f"{name}'s focal length would rather be {change.focal[camera]:+.1%}"
            f" (standard error {change.focal_sigma[camera]:.2%}, limit {limit:.1%})"
        )
    if kind == 1:
        return (
            f"{name}'s principal point would rather be {np.rad2deg(change.centre_rad[camera]):.1f} deg elsewhere"
            f" (standard error {np.rad2deg(change.centre_sigma[camera]):.1f} deg), which moves a camera by"
            f" {change.centre_effect[camera]:.1%} of the target's distance (limit {limits.centre_share:.1%})"
        )
    return (
        f"{name}'s distortion would rather move points at the rim by {change.bend_px[camera]:+.1f} px"
        f" (standard error {change.bend_sigma[camera]:.1f} px)"
    )


# shares tried on both sides, first roughly, then about what was found
_STEPS, _FARTHEST = (0.02, 0.005), 0.1
STRETCHED_REMEDY = "print at 100 % in both directions, glue it to a flat plate, and measure it along both sides"


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


def check_board_shape(solved: Solved, cameras: tuple[Camera, ...], limits: Limits) -> Check:
    """The board is as long in one direction as in the other, as described."""
    found = best_stretch(solved, cameras)
    share, sigma = (0.0, 0.0) if found is None else (found.share, found.sigma)
    return Check(
        "board is as described", abs(share) <= max(limits.stretch_share, limits.lens_sigma * sigma),
        f"fits best as {share:+.2%} longer in one direction (standard error {sigma:.2%}, limit {limits.stretch_share:.0%})",
        STRETCHED_REMEDY, "input",
    )  # fmt: skip
