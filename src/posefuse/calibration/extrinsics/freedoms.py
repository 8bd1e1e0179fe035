"""What a solved rig would rather have for clocks, camera poses, intrinsics or the shape of its board, when let free.

Each is a check of a solution: what is let free has to stay. And it is a likely cause where a solution is refused (`causes`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from posefuse.calibration.report import LIMITS, Check
from posefuse.core import Camera
from posefuse.core.arrays import Array

from .pipeline import Solved
from .prop_solve import PropSolution, SolvedRig, residuals_px
from .snapshots import Snapshots

IN_STEP = "cameras are synchronised"
_FREE_FOCAL, _FREE_LENS = 0.2, (10.0, 10.0, 0.05, 0.05)
# what remains of the radius of a camera's image points when the farthest are left out
_RIM_QUANTILE = 0.95
# by so many standard errors each half must show a change, so that one bad stretch of time stamps does not make it
_EACH_PART_SIGMA = 3.0


@dataclass(frozen=True, eq=False)
class Freed:
    """A solve in which one thing was free.

    Attributes:
        check: what it found, and what mends it. solved: the solution. frees: unknowns more than in the solution it began with.
        lost: corners that it could not place.
    """

    check: Check
    solved: SolvedRig
    frees: int
    lost: int = 0


def clocks_freed(solved: Solved) -> Freed:
    """A clock of its own for every camera, within what the motion of the corners extrapolates to."""
    free = solved.again(offset=True)
    return Freed(check_clocks(free), free, len(solved.cameras) - 1)


def lenses_freed(solved: Solved, offset: bool, of: tuple[int, ...] | None = None) -> Solved:
    """Nearly free intrinsics, of all cameras or of some."""
    focal_px = _FREE_FOCAL * float(np.mean([camera.K[0, 0] for camera in solved.cameras]))
    sigma = np.array([focal_px, focal_px, *_FREE_LENS])
    return solved.again(offset=offset, lens_sigma=sigma, lens_of=of)


def check_clocks(
    free: SolvedRig, least: tuple[float, float] = (LIMITS.late_s, LIMITS.drift), sigmas: float = LIMITS.late_sigma
) -> Check:
    """Clocks that are let free stay: against the median, since the held one may be the one that is off.

    `least` s and s/s, and `sigmas` standard errors, of the usual camera or of its own, are allowed.
    """
    cameras, delay_s, sigma_s = free.cameras, free.solution.state.delay_s, free.solution.delay_sigma_s
    late_s, sigma_s = delay_s - np.median(delay_s, axis=0), np.maximum(sigma_s, np.median(sigma_s, axis=0))
    off = np.abs(late_s) > np.maximum(least, sigmas * sigma_s)
    words = [
        f"the clock of {camera.name} runs {drift * 1e6:+.0f} ppm fast (drift)" if drifts else
        f"the clock of {camera.name} is off by {late * 1e3:+.1f} ms"
        for camera, (late, drift), (is_late, drifts) in zip(cameras, late_s, off, strict=True) if is_late or drifts
    ]  # fmt: skip
    worst = int(np.argmax(np.abs(late_s[:, 0])))
    fine = f"{cameras[worst].name} is off most, by {late_s[worst, 0] * 1e3:+.1f} ± {sigma_s[worst, 0] * 1e3:.1f} ms"
    return Check(
        IN_STEP, not words, f"{', '.join(words) or fine} (limit {least[0] * 1e3:.0f} ms)",
        f"the cameras are not synchronised: calibrate with `clocks={'drift' if off[:, 1].any() else 'offset'}`",
    )  # fmt: skip


@dataclass(frozen=True, eq=False, kw_only=True)
class LensChange:
    """Change of each camera's intrinsics (C,) when they are let free.

    Attributes:
        cameras: as given.
        size, sigma: (C, 3) with standard errors, of the focal length as a share, of the principal point as an angle, and of the
            image points at the rim of what was seen, by distortion alone, in px.
        confirmed: (C, 3) whether these may be called wrong.
    """

    cameras: tuple[Camera, ...]
    size: Array
    sigma: Array
    confirmed: Array

    @property
    def limit(self) -> Array:
        """(C, 3) of the sizes."""
        bend_px = [LIMITS.bend_px_per_1000 * max(camera.size_wh) / 1000 for camera in self.cameras]
        least = [(LIMITS.focal_share, LIMITS.centre_rad, px) for px in bend_px]
        return np.asarray(np.maximum(least, LIMITS.lens_sigma * self.sigma))

    @property
    def excess(self) -> Array:
        """(C, 3) over their limits: more than 1 is wrong."""
        excess = np.abs(self.size) / self.limit
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

    def words(self, camera: int, kind: int) -> str:
        """What one camera's intrinsics would rather be: kind 0 focal length, 1 principal point, 2 distortion."""
        size, sigma, limit = (float(one[camera, kind]) for one in (self.size, self.sigma, self.limit))
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
        return f"{self.cameras[camera].name}'s {said} (standard error {error})"


def lens_change(solved: SolvedRig, free: SolvedRig) -> LensChange:
    """How the intrinsics of `free` differ from those of the same solve with them held."""
    cameras, seen = solved.cameras, solved.seen
    focal_px = np.array([camera.K[0, 0] for camera in cameras])
    delta = free.solution.state.lens_delta - solved.solution.state.lens_delta
    covariance = free.solution.lens_covariance
    rim = np.array([_rim_radius(camera, seen.xy_img[seen.camera == i]) for i, camera in enumerate(cameras)])
    slope = np.zeros((2, len(cameras), 6))
    slope[0, :, :2] = 0.5 / focal_px[:, None]
    slope[1, :, 4], slope[1, :, 5] = focal_px * rim**3, focal_px * rim**5
    focal, bend = (slope * delta).sum(axis=-1)
    focal_sigma, bend_sigma = np.sqrt(np.einsum("kci,cij,kcj->kc", slope, covariance, slope))
    centre = np.linalg.norm(delta[:, 2:4], axis=1) / focal_px
    centre_sigma = np.sqrt(np.trace(covariance[:, 2:4, 2:4], axis1=1, axis2=2)) / focal_px
    return LensChange(
        cameras=cameras, size=np.stack([focal, centre, bend], axis=1),
        sigma=np.stack([focal_sigma, centre_sigma, bend_sigma], axis=1),
        confirmed=np.ones((len(cameras), 3), bool),
    )  # fmt: skip


def _rim_radius(camera: Camera, xy_img: Array) -> float:
    """Radius on the ideal image plane within which most of the points lie."""
    if len(xy_img) == 0:
        return 0.0
    return float(np.quantile(np.linalg.norm((xy_img - camera.K[:2, 2]) / camera.K[0, 0], axis=1), _RIM_QUANTILE))


def check_lenses(change: LensChange) -> Check:
    """The intrinsics, when they are let free, stay."""
    excess = change.excess
    worst, kind = (int(i) for i in np.unravel_index(np.argmax(excess), excess.shape))
    unsure = "" if change.confirmed[worst, kind] else "; the halves of the recording do not agree on it"
    return Check(
        "intrinsics fit", bool(excess[worst, kind] <= 1), change.words(worst, kind) + unsure,
        "focus or zoom has changed since they were calibrated, or they belong to another camera or image size:"
        " calibrate them again, or let them move with `focal_known_to_percent=3`", "lenses",
    )  # fmt: skip


# shares tried on both sides, first roughly, then about what was found
_STEPS, _FARTHEST = (0.02, 0.005), 0.1


@lru_cache(maxsize=1)
def board_freed(solved: Solved) -> Freed:
    """A board that is longer in one direction than described, by parabolas through three solves each.

    As described where more of it never fits worse. The last answer is kept: the cause of a refusal asks what the check has found.
    """
    middle = (solved.corners.max(axis=(0, 1)) + solved.corners.min(axis=(0, 1))) / 2

    def solved_at(share: float) -> Solved:
        return replace(solved, corners=solved.corners + share * (solved.corners - middle) * [0, 1, 0]).again()

    share, sigma = 0.0, 0.0
    for step in _STEPS:
        tried = [solved_at(share + k * step).solution for k in (-1, 0, 1)]
        low, level, high = (_cost(one, min(other.sigma_px for other in tried)) for one in tried)
        curve = low + high - 2 * level
        if curve <= 0:
            return Freed(check_board_shape(0.0, 0.0), solved, 1)
        share = float(np.clip(share + step * (low - high) / (2 * curve), -_FARTHEST, _FARTHEST))
        # the cost is twice the negative logarithm of the likelihood
        sigma = float(step * np.sqrt(2 / curve))
    return Freed(check_board_shape(share, sigma), solved_at(share), 1)


def _cost(solution: PropSolution, sigma_px: float) -> float:
    square = np.nan_to_num((solution.residual_px**2).sum(axis=1) / sigma_px**2, nan=1e3)
    return float((9 * np.log1p(square / 9)).sum())


def check_board_shape(share: float, sigma: float) -> Check:
    """The board is as long in one direction as in the other, as described."""
    return Check(
        "board is as described", abs(share) <= max(LIMITS.stretch_share, LIMITS.lens_sigma * sigma),
        f"the board fits best as {share:+.2%} longer in one direction (standard error {sigma:.2%}, limit"
        f" {LIMITS.stretch_share:.0%})",
        "print at 100 % in both directions, glue it to a flat plate, and measure it along both sides",
    )  # fmt: skip


_STRETCHES = 8
# a step, or a turn all the time, counts from so many times what stretches without it scatter by, and where two poses fit so much
# better than one: good sessions 0.1 or less, moves of 0.15 deg 0.17 or more (`bench/calibration_faults.py`)
_MOVED_SIGMAS, _SLOWLY_SIGMAS, _LEAST_BETTER = 6.0, 4.0, 0.1
# two explanations whose cost differs by less than this share cannot be distinguished
_ALIKE = 0.02
_MOST_COMPARED = 300


@dataclass(frozen=True, eq=False)
class _Step:
    """The largest step between the poses that camera `of` has in stretches of time.

    Attributes:
        ratio: the step over its limit. px: by how much the target moves in the image. at_s: when. slowly: all the time.
    """

    of: int
    ratio: float
    px: float
    at_s: float
    slowly: bool


@dataclass(frozen=True, eq=False)
class _Move:
    """A solve in which camera `of` has another pose from a time on.

    Attributes:
        solved: with the second pose as one more camera, the last one. words: when it moved, and how far.
        cost: of all image points, robust. better: by which share the camera's own fit better.
    """

    of: int
    solved: SolvedRig
    words: str
    cost: float
    better: float


def standing_freed(solved: SolvedRig, least_rad: float) -> Freed:
    """Each camera by itself may have another pose in each of eight stretches of time; a step of `least_rad` or more is a move.

    All that move are named, each with the time.
    """
    count = len(solved.cameras)
    now, worst, left = solved, 0.0, list(range(count))
    words: list[str] = []
    place = list(range(count))
    while len(left) > 1 or not words:
        steps = [_largest_step(now, c, least_rad) for c in left]
        worst = max(worst, max(step.ratio for step in steps))
        tried = [_move(now, step) for step in steps if step.ratio > 1]
        moves = sorted((move for move in tried if move.better > _LEAST_BETTER), key=lambda move: move.cost)
        if not moves:
            break
        alike = [move for move in moves if move.cost <= moves[0].cost * (1 + _ALIKE)]
        words.append(" or ".join(move.words for move in alike))
        now, place = moves[0].solved, [*place, moves[0].of]
        left = [c for c in left if c not in [move.of for move in alike]]
    detail = f"the largest step is {worst:.0%} of what would be noticed" if not words else "; ".join(words)
    remedy = "fasten it, switch autofocus off, and record again; or use the part before or after that time"
    as_before = replace(now, seen=replace(now.seen, camera=np.array(place)[now.seen.camera]))
    return Freed(Check("cameras stand still", not words, detail, remedy), as_before, 7 * len(words))


def _largest_step(solved: SolvedRig, c: int, least_rad: float) -> _Step:
    rows, mine = solved.seen, np.flatnonzero(solved.seen.camera == c)
    stretch = np.zeros(len(rows.camera), np.int64)
    stretch[mine] = np.arange(len(mine)) * _STRETCHES // max(len(mine), 1)
    free = solved.with_camera_apart(c, stretch)
    pose_of = np.r_[c, len(solved.cameras) : len(free.cameras)]
    poses = free.solution.state.cam_from_world[pose_of].se3()
    xyz = free.solution.state.world_from_prop.t[rows.time_step[mine[:: max(1, len(mine) // _MOST_COMPARED)]]]
    xy = np.stack([replace(solved.cameras[c], cam_from_world=poses[i]).project(xyz) for i in range(len(pose_of))])
    ratio, first, last, px, slowly = _step_between(xy, least_rad * float(solved.cameras[c].K[0, 0]))
    own = rows.rows(rows.camera == c)
    before, after = (_costs(free, replace(own, camera=np.full(len(mine), pose_of[i % len(pose_of)]))) for i in (first - 1, last))
    # image points before the cut belong to the first pose, those after it to the second
    cut = int(np.argmin(np.append(0, np.cumsum(before - after)[:-1])))
    return _Step(c, ratio, px, float(own.t_s[own.time_step[cut]]) if len(mine) else 0.0, slowly)


def _costs(solved: SolvedRig, seen: Snapshots) -> Array:
    """(N,) robust cost of each of these image points in a solution."""
    off = residuals_px(seen, solved.corners, solved.cameras, solved.solution.state) / seen.noise[:, None]
    return np.asarray(np.log1p(np.nan_to_num((off**2).sum(axis=1) / solved.solution.sigma_px**2, nan=1e6)))


def _step_between(xy: Array, least_px: float) -> tuple[float, int, int, float, bool]:
    """Of points (S, N, 2) seen by the pose of each stretch: the largest step over its limit, the stretches it lies between, px,
    and whether the camera rather moves all the time.

    A stretch in which the camera moves is no part of either side.
    """
    best, count = (0.0, 1, 1, 0.0, False), len(xy)
    xy = xy[:, np.isfinite(xy).all(axis=(0, 2))]
    if not xy.shape[1]:
        return best
    for first in range(1, count):
        for last in (first, min(first + 1, count - 1)):
            before, after = xy[:first], xy[last:]
            step_px = _size(after.mean(axis=0) - before.mean(axis=0))
            within = np.concatenate([before - before.mean(axis=0), after - after.mean(axis=0)])
            each_px = _size(within) * np.sqrt(len(within) / (len(within) - 2))
            sigma_px = each_px * np.sqrt(1 / len(before) + 1 / len(after))
            best = max(best, (float(step_px / max(least_px, _MOVED_SIGMAS * sigma_px)), first, last, step_px, False))
    time = (np.arange(count) - (count - 1) / 2) / count
    change = np.tensordot(time, xy, 1) / (time @ time)
    left = xy - xy.mean(axis=0) - time[:, None, None] * change
    change_sigma_px = float(_size(left) * np.sqrt(count / (count - 2) / (time @ time)))
    ratio = _size(change) / max(least_px, _SLOWLY_SIGMAS * change_sigma_px)
    return max(best, (ratio, count // 2, count // 2, _size(change), True))


def _size(off: Array) -> float:
    """Root mean square length of vectors (..., 2)."""
    return float(np.sqrt((off**2).sum(axis=-1).mean()))


def _move(solved: SolvedRig, step: _Step) -> _Move:
    camera, seen = solved.cameras[step.of], solved.seen
    later = (seen.camera == step.of) & (seen.t_s[seen.time_step] >= step.at_s)
    two = solved.with_camera_apart(step.of, later.astype(np.int64))
    when = "slowly" if step.slowly else f"at about {step.at_s - seen.t_s.min():.0f} s"
    words = f"{camera.name} was moved {when}, its view by {np.rad2deg(step.px / float(camera.K[0, 0])):.1f} deg"
    alike = replace(two, solution=replace(two.solution, sigma_px=solved.solution.sigma_px))
    before, after = _costs(solved, seen), _costs(alike, two.seen)
    own = np.isin(two.seen.camera, (step.of, len(solved.cameras)))
    better = 1 - float(after[own].mean() / before[seen.camera == step.of].mean())
    return _Move(step.of, two, words, float(after.mean()), better)


@lru_cache(maxsize=1)
def camera_moves(solved: Solved) -> Freed:
    """`standing_freed` of a target; the last answer is kept as that of `board_freed` is."""
    return standing_freed(solved, LIMITS.moved_rad)
