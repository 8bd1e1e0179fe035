"""Rotation and clock error of each camera, and the size of a network's errors, estimated from points that several cameras see.

At every time step the points are triangulated from all cameras. Residuals are taken in metres at the point, because a 2D network
errs by about the same share of a body in every view. The points are eliminated; the rest is linear in the rotations and clock
errors of all cameras together. This separates a faulty camera from those whose residuals it contaminates.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise

import numpy as np
from scipy.special import gammaincinv

from posefuse.calibration.extrinsics.world import linear_points
from posefuse.calibration.geometry import hat
from posefuse.core import Rig
from posefuse.core.arrays import Array
from posefuse.fusion import FuseSettings, triangulate

# unknowns of a camera: its rotation about its own axes in rad, and the delay of its images in s
UNKNOWNS, TURN, LATE = 4, slice(0, 3), slice(3, 4)
# Huber loss: threshold in medians of the time step's residuals
_WORSE = 2.0
_LEAST_DEPTH_M, _MOST_OFF_M = 0.2, 3.0
_RIDGE = 1e-3


@dataclass(frozen=True, eq=False, kw_only=True)
class TriangulatedStep:
    """Points of one time step, and how they fit.

    Attributes:
        t_ns: when. xyz_world: (P, 3) where the rays meet, NaN where fewer than two do.
        misfit_m: (P,) rms of what each point leaves over per redundant coordinate; NaN where nothing is redundant.
        rows: (P, C, 2, 3) metres at the point per metre of the point. off_m: (P, C, 2) seen minus expected, 0 where unseen.
        xyz_cam: (P, C, 3). seen: (P, C).
    """

    t_ns: int
    xyz_world: Array
    misfit_m: Array
    rows: Array
    off_m: Array
    xyz_cam: Array
    seen: Array


@dataclass(frozen=True, eq=False, kw_only=True)
class Sums:
    """Normal equations of time steps for the unknowns u (4 C) of all cameras; squares in m^2.

    They are kept apart by keypoint: a network errs in a keypoint for as long as a view shows it alike, so keypoints are what
    errs independently, not time steps.

    Attributes:
        information: (P, 4C, 4C), the points eliminated. pull: (P, 4C) right-hand side. squares: sum of squared residuals.
        count: of redundant coordinates.
        own: (C, 4, 4) squares by which each camera's unknowns displace its own points. points: (C,) of them.
        places: (5,) of the middle of the points: how many, sums of x, y, z in m, and of their squares.
    """

    information: Array
    pull: Array
    squares: float
    count: float
    own: Array
    points: Array
    places: Array

    @property
    def walked_m(self) -> float:
        """How far the middle of the points moved about its mean, rms."""
        count, *place, square = self.places / max(self.places[0], 1e-9)
        return float(np.sqrt(max(square - np.dot(place, place), 0.0))) if count else 0.0

    @staticmethod
    def nothing(cameras: int) -> Sums:
        """No time step yet."""
        return Sums(
            information=np.zeros((1, UNKNOWNS * cameras, UNKNOWNS * cameras)),
            pull=np.zeros((1, UNKNOWNS * cameras)),
            squares=0.0,
            count=0.0,
            own=np.zeros((cameras, UNKNOWNS, UNKNOWNS)),
            points=np.zeros(cameras),
            places=np.zeros(5),
        )

    def decayed(self, keep: float, new: Sums) -> Sums:
        """These counting `keep` times, and new ones."""
        return Sums(**{name: keep * one + getattr(new, name) for name, one in vars(self).items()})

    def taken_up(self, unknowns: slice) -> tuple[Array, Array]:
        """What these unknowns of all cameras together take up: the matrix (4C, 4C) that leaves the rest, their values (4C,)."""
        taken = np.tile(np.isin(np.arange(UNKNOWNS), np.arange(UNKNOWNS)[unknowns]), len(self.points))
        all_points = self.information.sum(axis=0)
        normal = all_points[np.ix_(taken, taken)]
        # a common rotation of all cameras is hardly determined
        normal = normal + (_RIDGE * np.trace(normal) / len(normal) + 1e-9) * np.eye(len(normal))
        solved = np.linalg.solve(normal, np.column_stack([all_points[np.ix_(taken, ~taken)], self.pull[:, taken].sum(axis=0)]))
        left, found = np.diag((~taken).astype(np.float64)), np.zeros(len(taken))
        left[np.ix_(~taken, taken)] = -solved[:, :-1].T
        found[taken] = solved[:, -1]
        return left, found

    def without(self, unknowns: slice) -> Sums:
        """What these unknowns of all cameras together leave over, for the other unknowns."""
        left, found = self.taken_up(unknowns)
        squares = self.squares - float(self.pull.sum(axis=0) @ found)
        return replace(self, information=left @ self.information @ left.T, pull=self.pull @ left.T, squares=squares)


def instant_of(rig: Rig, t_ns: int, xy_img: Array) -> TriangulatedStep:
    """Points (C, P, 2) in raw px, NaN where unseen, as they fit the rig."""
    norm = np.stack([camera.norm_from_px(xy) for camera, xy in zip(rig, xy_img, strict=True)])
    points = linear_points(rig, norm)
    turn, shift = _poses(rig)
    norm = np.moveaxis(norm, 0, 1)
    # where the rays meet with every camera's error counted in metres
    for _ in range(2):
        xyz_cam = np.einsum("cij,pj->pci", turn, points) + shift
        seen = np.isfinite(norm).all(axis=-1) & (xyz_cam[..., 2] > _LEAST_DEPTH_M)
        seen &= seen.sum(axis=1, keepdims=True) >= 2
        rows = np.where(seen[..., None, None], turn[:, :2] - norm[..., None] * turn[:, None, 2], 0.0)
        off = np.where(seen[..., None], norm * xyz_cam[..., 2:] - xyz_cam[..., :2], 0.0)
        normal = np.einsum("pcix,pciy->pxy", rows, rows) + 1e-9 * np.eye(3)
        points = np.where(seen.any(axis=1)[:, None], points, np.nan)
        step = np.linalg.solve(normal, np.einsum("pcix,pci->px", rows, off)[..., None])[..., 0]
        points = points + step
        off = off - np.einsum("pcix,px->pci", rows, step)
    length = np.hypot(off[..., 0], off[..., 1])[..., None]
    off = off * np.minimum(1.0, _MOST_OFF_M / np.maximum(length, 1e-9))
    redundant = 2 * seen.sum(axis=1) - 3
    with np.errstate(divide="ignore", invalid="ignore"):
        misfit = np.sqrt(np.where(redundant > 0, (off**2).sum(axis=(1, 2)) / redundant, np.nan))
    xyz_cam = np.where(seen[..., None], np.einsum("cij,pj->pci", turn, points) + shift, 0.0)
    return TriangulatedStep(t_ns=t_ns, xyz_world=points, misfit_m=misfit, rows=rows, off_m=off, xyz_cam=xyz_cam, seen=seen)


def sums_of(rig: Rig, now: TriangulatedStep, velocity_world: Array) -> Sums:
    """Normal equations of one time step whose points move at (P, 3) m/s, NaN where unknown."""
    good = np.isfinite(now.misfit_m) & np.isfinite(velocity_world).all(axis=-1)
    cameras = len(rig)
    if not good.any():
        return Sums.nothing(cameras)
    misfit = now.misfit_m[good]
    weight = np.minimum(1.0, _WORSE * np.median(misfit) / np.maximum(misfit, 1e-9))
    rows, off, xyz_cam, seen = now.rows[good], now.off_m[good], now.xyz_cam[good], now.seen[good]
    turn, _ = _poses(rig)
    moved = np.concatenate([-hat(xyz_cam), -np.einsum("cij,pj->pci", turn, velocity_world[good])[..., None]], axis=-1)
    depth = np.maximum(xyz_cam[..., 2], _LEAST_DEPTH_M)
    across = moved[..., :2, :] - (xyz_cam[..., :2] / depth[..., None])[..., None] * moved[..., 2:, :]
    across = np.where(seen[..., None, None], across, 0.0)
    own = np.einsum("p,pciu,pciv->cpuv", weight, across, across)
    # what the points can take up is taken out; each camera's rows know its own unknowns only: (P, 3, 4 C) joins them
    joint = np.einsum("pcix,pciu->pxcu", rows, across).reshape(len(rows), 3, UNKNOWNS * cameras)
    normal = np.einsum("pcix,pciy->pxy", rows, rows)
    taken = np.linalg.solve(normal + 1e-9 * np.eye(3), joint)
    common = weight[:, None, None] * (2 * joint - normal @ taken)
    information, pull = np.zeros((len(good), UNKNOWNS * cameras, UNKNOWNS * cameras)), np.zeros((len(good), UNKNOWNS * cameras))
    known, each = -np.swapaxes(taken, 1, 2) @ common, np.arange(cameras)
    known.reshape(len(rows), cameras, UNKNOWNS, cameras, UNKNOWNS)[:, each, :, each] += own
    information[good] = known
    pull[good] = np.einsum("p,pciu,pci->pcu", weight, across, off).reshape(len(rows), -1)
    pull[good] -= np.einsum("p,pxv,pcix,pci->pv", weight, taken, rows, off, optimize=True)
    redundant = 2 * seen.sum(axis=1) - 3
    squares, count = float((weight * redundant * misfit**2).sum()), float((weight * redundant).sum())
    middle = np.median(now.xyz_world[good], axis=0)
    places = np.array([1.0, *middle, middle @ middle])
    return Sums(
        information=information,
        pull=pull,
        squares=squares,
        count=count,
        own=own.sum(axis=1),
        points=(weight[:, None] * seen).sum(axis=0),
        places=places,
    )


@lru_cache(maxsize=8)
def _poses(rig: Rig) -> tuple[Array, Array]:
    """(C, 3, 3) and (C, 3) of cam_from_world."""
    return np.stack([camera.cam_from_world.matrix() for camera in rig]), np.stack([camera.cam_from_world.xyz for camera in rig])


_PERIOD_NS = 100_000_000
# a time step is given when views this much newer are there: those of a slower camera should have come
_PATIENCE_NS = 500_000_000
# two views of a camera further apart than this are not interpolated between: a hand leaves the straight line by centimetres
_REACH_NS = 125_000_000
# after a gap this long time steps continue where views do
_GAP_NS = 2_000_000_000
_MOST_VIEWS = 256


class CommonTimeSteps:
    """Every camera's points at ten time steps a second, linear between its views on both sides."""

    def __init__(self, cameras: Iterable[str]) -> None:
        self._views: dict[str, deque[tuple[int, Array]]] = {name: deque(maxlen=_MOST_VIEWS) for name in cameras}
        self._next_ns: int | None = None

    def add(self, camera: str, t_ns: int, xy_img: Array, seen: Array) -> None:
        """One view's points (P, 2), of which those `seen` (P,) count; one that is older than the camera's newest does not."""
        views = self._views[camera]
        if views and t_ns <= views[-1][0]:
            # a clock that was set back starts again
            if t_ns < views[-1][0] - _GAP_NS:
                views.clear()
            else:
                return
        views.append((t_ns, np.where(seen[:, None], xy_img, np.nan)))

    def ready(self) -> Iterator[tuple[int, Array]]:
        """Time steps that no view can change any more: time, and points (C, P, 2), NaN where a camera has none."""
        newest = sorted(views[-1][0] for views in self._views.values() if views)
        if len(newest) < 2:
            return
        # one camera that is ahead of all others does not push them
        last_ns = newest[-2] - _PATIENCE_NS
        if self._next_ns is None or abs(last_ns - self._next_ns) > _GAP_NS:
            self._next_ns = last_ns - last_ns % _PERIOD_NS
        while self._next_ns <= last_ns:
            t_ns, self._next_ns = self._next_ns, self._next_ns + _PERIOD_NS
            read = [_at(views, t_ns) for views in self._views.values()]
            points = next((xy for xy in read if xy is not None), None)
            if points is not None:
                yield t_ns, np.stack([np.full(points.shape, np.nan) if xy is None else xy for xy in read])


def _at(views: deque[tuple[int, Array]], t_ns: int) -> Array | None:
    while len(views) > 1 and views[1][0] <= t_ns:
        views.popleft()
    for (before_ns, before), (after_ns, after) in pairwise(list(views)[:2]):
        if before_ns <= t_ns < after_ns <= before_ns + _REACH_NS:
            share = (t_ns - before_ns) / (after_ns - before_ns)
            return np.asarray(before + share * (after - before))
    return None


# fewer joints in a time step, seen by enough cameras, say nothing; and beyond these limits it is not the noise that is wrong
_LEAST_SEEN = 200
_LIMITS = (0.5, 3.0)


def disagreement(rig: Rig, xy_img: Array, score: Array, sigma_px: Array, fusing: FuseSettings) -> Array:
    """(R,) of every point whose views all agree: chi-square of its residuals over the median that is expected.

    Errors that all cameras share are not seen by it.

    Args:
        xy_img: (..., C, K, 2) views of the points. score, sigma_px: (..., C, K).
    """
    solved = triangulate(rig, xy_img, score, sigma_px, settings=fusing)
    off = (xy_img - np.moveaxis(rig.project(solved.xyz), 0, -3)) / sigma_px[..., None]
    used: Array = np.isfinite(off).all(axis=-1) & (score >= fusing.score_min)
    count = used.sum(axis=-2)
    # coordinates that were seen less those of the point
    freedom = 2 * count - 3
    known = (freedom > 0) & (count == solved.n_views)
    chi2 = (np.where(used[..., None], off, 0.0) ** 2).sum(axis=(-3, -1))[known]
    return np.asarray(chi2 / (2 * gammaincinv(freedom[known] / 2, 0.5)))


def noise_scale(shares: Array) -> float | None:
    """By what the stated standard deviations are to be multiplied, from 0.5 to 3; None where too little is seen.

    The Birge ratio (Birge 1932, "The calculation of errors by the method of least squares"): the root of chi-square over its
    degrees of freedom. Here it is a median over joints and time steps whose views agree.
    """
    return float(np.clip(np.sqrt(np.median(shares)), *_LIMITS)) if len(shares) >= _LEAST_SEEN else None
