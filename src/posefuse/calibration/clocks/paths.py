"""Points of a moving person or prop on smooth paths, seen by known cameras whose clocks are not the same.

Every view is one ray to each point at its own stamp, so no two cameras need to have looked at the same time. The paths, and a
constant error of each camera about each point, are eliminated; the rest determines how late each camera's stamps are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posefuse.core import Rig
from posefuse.core.arrays import Array

# of a camera's views, those closer than this to the one before add no information
APART_S = 0.045
# accelerations that paths may have, from those that leave slow motion only to all
ACCELERATIONS_M_S2 = (2.0, 2.0, 4.0, *12 * (8.0,))
# noise of the paths' speeds makes steps too short: they continue until they are of no account
SETTLED_S = 1e-4
LONGEST_STEP_S = 0.1
LEAST_VIEWS = 8
# paths are cubic splines with a knot every so often
_KNOT_S = 0.1
# of a keypoint in a view: usual error, and the part of it that stays
_SIGMA_PX, _STAYS_PX = 4.0, 6.0
# errors of neighbouring views are correlated: so many count as one independent view
_ALIKE = 6.0


@dataclass(frozen=True, eq=False)
class MovingViews:
    """V views: camera c (V,), stamps t_s (V,), ideal points xy (V, P, 2), NaN where unseen."""

    c: Array
    t_s: Array
    xy: Array


@dataclass(frozen=True, eq=False)
class ClockSums:
    """What views contribute to the offsets: information (C, C) in 1/s^2, and pull (C,) in 1/s."""

    information: Array
    pull: Array

    def and_also(self, other: ClockSums) -> ClockSums:
        """Both together."""
        return ClockSums(self.information + other.information, self.pull + other.pull)


class Paths:
    """Splines through the rays of a block, and what is left over."""

    def __init__(self, rig: Rig, views: MovingViews) -> None:
        self._views, self._cameras = views, len(rig)
        seen = np.isfinite(views.xy[..., 0])
        turn = np.stack([camera.cam_from_world.matrix() for camera in rig])[views.c]
        shift = np.stack([camera.cam_from_world.xyz for camera in rig])[views.c]
        focal = np.array([camera.K[0, 0] for camera in rig])[views.c]
        xy = np.where(seen[..., None], views.xy, 0.0)
        # (P, V, 2, 3) and (P, V, 2): rows . x = right, in px times depth
        self._rows = np.moveaxis(focal[:, None, None, None] * (turn[:, None, :2] - xy[..., None] * turn[:, None, 2:]), 1, 0)
        self._right = np.moveaxis(focal[:, None, None] * (xy * shift[:, None, 2:] - shift[:, None, :2]), 1, 0)
        self._depth_row, self._depth_shift = turn[:, 2], shift[:, 2]
        centre = rig.centres_world()
        usual = np.linalg.norm(centre - centre.mean(axis=0), axis=-1)[views.c] + 1.0
        self._depth = np.broadcast_to(usual, seen.T.shape).copy()
        self._seen, self._weight = seen.T, seen.T / _SIGMA_PX**2
        self._speed = np.zeros((*seen.T.shape, 3))
        self._left_px = np.zeros(seen.T.shape)

    @property
    def camera(self) -> Array:
        """(N,) camera of each point of each view that was seen."""
        return np.asarray(np.broadcast_to(self._views.c, self._seen.shape)[self._seen])

    @property
    def left_px(self) -> Array:
        """(N,) how far it was off its path in the last step."""
        return np.asarray(self._left_px[self._seen])

    def step(self, offset_s: Array, acceleration_m_s2: float) -> ClockSums:
        """Fit the paths again; returns how much later each camera's stamps are than `offset_s`."""
        c, count = self._views.c, self._cameras
        times = self._views.t_s - offset_s[c]
        basis, slope, bend = _splines(times)
        points, n = len(self._rows), basis.shape[1]
        scale = np.sqrt(self._weight) / self._depth
        rows = (self._rows * scale[..., None, None])[..., None, :, :]
        # unknown: the spline's coefficients (n, 3), then an error of each camera that stays (C, 2)
        place = (basis[None, :, None, :, None] * np.moveaxis(rows, 2, 3)).reshape(points, -1, 3 * n)
        stays = np.sqrt(self._weight)[..., None, None] * (np.eye(2)[:, None, :] * np.eye(count)[c][:, None, :, None]).reshape(
            len(c), 2, 2 * count
        )
        design = np.concatenate([place, stays.reshape(points, -1, 2 * count)], axis=-1)
        right = (self._right * scale[..., None]).reshape(points, -1)
        late = -np.einsum("pvrx,pvx->pvr", self._rows * scale[..., None, None], self._speed)
        late = (late[..., None] * np.eye(count)[c][:, None]).reshape(points, -1, count)
        prior = np.zeros((3 * n + 2 * count,) * 2)
        prior[: 3 * n, : 3 * n] = np.kron(bend.T @ bend / acceleration_m_s2**2 + 1e-6 * np.eye(n), np.eye(3))
        prior[3 * n :, 3 * n :] = np.eye(2 * count) / _STAYS_PX**2
        turned = np.swapaxes(design, -1, -2)
        normal = turned @ design + prior
        found = np.linalg.solve(normal, turned @ np.concatenate([right[..., None], late], axis=-1))
        left = np.concatenate([right[..., None], late], axis=-1) - design @ found
        information = np.einsum("pmc,pmd->cd", late, left[..., 1:])
        pull = np.einsum("pmc,pm->c", late, left[..., 0])
        coefficients = found[:, : 3 * n, 0].reshape(points, n, 3)
        self._learn(basis @ coefficients, slope @ coefficients, left[..., 0].reshape(points, -1, 2))
        return ClockSums(information / _ALIKE, pull / _ALIKE)

    def _learn(self, place: Array, speed: Array, left: Array) -> None:
        """Depths, speeds, and how much each point of each view is believed, from what the fit left over in sigmas."""
        self._speed = speed
        self._depth = np.maximum(np.einsum("pvx,vx->pv", place, self._depth_row) + self._depth_shift, 0.3)
        sigma_px = 1 / np.sqrt(np.where(self._seen, self._weight, 1.0))
        self._left_px = np.linalg.norm(left, axis=-1) * sigma_px
        spread = max(float(np.median(self.left_px)) / 1.18, 0.5)
        self._weight = self._seen / spread**2 / (1 + (self._left_px / (2 * spread)) ** 2)


def _splines(times: Array) -> tuple[Array, Array, Array]:
    """Uniform cubic B-splines (V, n), their first derivatives, and second derivatives at the knots (m, n)."""
    first = np.floor(times.min() / _KNOT_S) - 1
    u = times / _KNOT_S - first
    n = int(np.floor(u.max())) + 3
    knots = np.arange(1, n - 1, dtype=float)
    return _cubic(u, n, 0), _cubic(u, n, 1) / _KNOT_S, _cubic(knots, n, 2) / _KNOT_S**2


def _cubic(u: Array, n: int, derivative: int) -> Array:
    x = u[:, None] - np.arange(n)
    a, sign = np.abs(x), np.sign(x)
    near, far = a < 1, (a >= 1) & (a < 2)
    inner = (2 / 3 - a**2 + a**3 / 2, sign * (1.5 * a**2 - 2 * a), 3 * a - 2)[derivative]
    outer = ((2 - a) ** 3 / 6, -sign * (2 - a) ** 2 / 2, 2 - a)[derivative]
    return np.asarray(np.where(near, inner, np.where(far, outer, 0.0)))


def apart(times: Array, least: float) -> Array:
    """Indices of rising times (N,), in any unit, each at least so long after the one before."""
    chosen: list[int] = []
    for i, t in enumerate(times.tolist()):
        if not chosen or t >= times[chosen[-1]] + least:
            chosen.append(i)
    return np.array(chosen, np.intp)


# two frames further apart than this many periods are not interpolated between
_LONGEST_GAP_PERIODS = 2.2


def at_times(t_s: Array, values: Array, wanted_s: Array) -> Array:
    """Values (F, ..., D) known at rising t_s (F,), read at wanted_s (W,): (W, ..., D).

    Cubic between two neighbouring frames with the slopes of their neighbours (Catmull and Rom 1974), so that a wild frame does
    no harm beyond them. NaN outside and where a frame is missing; a frame at the moment asked for is given as it is.
    """
    if len(t_s) < 2:
        same = (wanted_s[:, None] == t_s).any(axis=1).reshape(-1, *[1] * (values.ndim - 1))
        return np.where(same, values[:1], np.nan)
    after = np.clip(np.searchsorted(t_s, wanted_s), 1, len(t_s) - 1)
    before = after - 1
    span = (t_s[after] - t_s[before]).reshape(-1, *[1] * (values.ndim - 1))
    share = (wanted_s - t_s[before]).reshape(span.shape) / span
    slopes = _slopes(t_s, values)
    p, q = values[before], values[after]
    line = (q - p) / span
    m, n = (np.where(np.isfinite(slopes[i]), slopes[i], line) for i in (before, after))
    curve = p + span * share * (m + share * ((3 * line - 2 * m - n) + share * (m + n - 2 * line)))
    reach = _LONGEST_GAP_PERIODS * float(np.median(np.diff(t_s)))
    inside = (share >= 0) & (share <= 1) & (span <= reach)
    curve = np.where(inside, curve, np.nan)
    # a neighbour that is missing does not matter at a frame's own moment
    return np.where(share == 0, p, np.where(share == 1, q, curve))


def _slopes(t_s: Array, values: Array) -> Array:
    """(F, ..., D) from each frame's neighbours; NaN where one is missing."""
    slopes = np.full(values.shape, np.nan)
    slopes[1:-1] = (values[2:] - values[:-2]) / (t_s[2:] - t_s[:-2]).reshape(-1, *[1] * (values.ndim - 1))
    return slopes
