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
LONGEST_GAP_PERIODS = 2.2
# a frame is given as it is at the moment of its exposure
_SAME_S = 1e-4


def at_times(t_s: Array, values: Array, wanted_s: Array) -> Array:
    """As `between_frames`, with no frame lost but one; the values alone."""
    longest_s = LONGEST_GAP_PERIODS * float(np.median(np.diff(t_s))) if len(t_s) > 1 else 0.0
    return between_frames(t_s, values, wanted_s, longest_s)[0]


def between_frames(t_s: Array, values: Array, wanted_s: Array, longest_s: float) -> tuple[Array, Array]:
    """Values (F, ..., D) known at rising t_s (F,), read at wanted_s (W,), and their rates per second: both (W, ..., D).

    Cubic between two neighbouring frames with the slopes of their neighbours (Catmull and Rom 1974), so that a wild frame does
    no harm beyond them. NaN outside, where frames are farther apart than `longest_s` and where one is missing; a frame at the
    moment asked for is given as it is.
    """
    before = np.clip(np.searchsorted(t_s, wanted_s + _SAME_S, side="right") - 1, 0, len(t_s) - 1)
    after = np.minimum(before + 1, len(t_s) - 1)
    column = (-1, *[1] * (values.ndim - 1))
    since, span = ((one - t_s[before]).reshape(column) for one in (wanted_s, t_s[after]))
    slopes = _slopes(t_s, values, longest_s)
    share, p, line = since / np.where(span > 0, span, 1.0), values[before], values[after] - values[before]
    m, n = slopes[before] * span, slopes[after] * span
    bend, twist = 3 * line - 2 * m - n, m + n - 2 * line
    curve = p + share * (m + share * (bend + share * twist))
    rate = (m + share * (2 * bend + 3 * share * twist)) / np.where(span > 0, span, 1.0)
    exact, inside = np.abs(since) <= _SAME_S, (since > 0) & (since < span) & (span <= longest_s)
    # a neighbour that is missing does not matter at a frame's own moment
    known = np.where(exact, p, np.where(inside, curve, np.nan))
    return known, np.where(exact, slopes[before], np.where(inside, rate, np.nan))


def _slopes(t_s: Array, values: Array, longest_s: float) -> Array:
    """(F, ..., D) from the neighbours of each frame on both sides; from one where that is all there is, and 0 from none."""
    step = np.diff(t_s).reshape(-1, *[1] * (values.ndim - 1))
    chord = np.where((step > 0) & (step <= longest_s), np.diff(values, axis=0) / np.where(step > 0, step, 1.0), np.nan)
    nothing, no_time = np.full_like(values[:1], np.nan), np.zeros((1, *step.shape[1:]))
    left, right = np.concatenate([nothing, chord]), np.concatenate([chord, nothing])
    gap_left, gap_right = np.concatenate([no_time, step]), np.concatenate([step, no_time])
    both = (left * gap_right + right * gap_left) / np.maximum(gap_left + gap_right, 1e-12)
    slope = np.where(np.isnan(left), right, np.where(np.isnan(right), left, both))
    # the parabola through three frames has 2 * chord - slope at one end of a chord if it has that slope at the other end
    inner, first, final = np.isfinite(both), np.isnan(left), np.isnan(right)
    slope[:-1] = np.where(first[:-1] & inner[1:], 2 * chord - slope[1:], slope[:-1])
    slope[1:] = np.where(final[1:] & inner[:-1], 2 * chord - slope[:-1], slope[1:])
    return np.asarray(np.nan_to_num(slope))
