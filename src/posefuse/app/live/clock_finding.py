"""How far the stamps of cameras are apart, from a person who moves in front of them; cheap enough for a busy machine.

The points of the person move on smooth paths, and every view is one ray to each. Paths and offsets are sought together
(Gauss-Newton; the paths, and a constant error of each camera about each point, are eliminated), so a camera may be slow, and
no two need to have looked at the same time. Every block of new seconds is looked at once; what it says is added to what
earlier ones said, which fades.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from posefuse.core import Rig
from posefuse.core.arrays import Array

# new seconds looked at in one go, the longest looked at when more have come, and what is looked at again at both ends
_BLOCK_S, _LONGEST_S, _MARGIN_S = 2.0, 6.0, 0.3
# of a camera's views, those closer than this to the one before tell nothing new
_APART_S = 0.045
# paths are cubic splines with a knot every so often; accelerations, from those that leave slow motion only to all
_KNOT_S = 0.1
_ACCELERATIONS_M_S2 = (2.0, 2.0, 4.0, *12 * (8.0,))
# noise of the paths' speeds makes steps too short: they go on until they are of no account
_SETTLED_S = 1e-4
_LONGEST_STEP_S = 0.1
_FAR_S, _FAR_SIGMAS = 0.02, 5.0
# of a keypoint in a view: usual error, the part of it that stays, and of all cameras' offsets before anything is seen
_SIGMA_PX, _STAYS_PX = 4.0, 6.0
_BEFORE_S = 0.3
# errors of neighbouring views are alike: so many tell one news
_ALIKE = 6.0
_LEAST_VIEWS, _LEAST_SCORE = 8, 0.5
_FORGOTTEN_S, _TRUSTED_S = 20.0, 0.005


@dataclass(frozen=True, eq=False)
class _Views:
    """V views: camera c (V,), stamps t_s (V,), ideal points xy (V, P, 2), NaN where unseen."""

    c: Array
    t_s: Array
    xy: Array


@dataclass(eq=False)
class _Sums:
    """What all blocks said of the offsets: information (C, C) in 1/s^2, and pull (C,) in 1/s."""

    information: Array
    pull: Array

    def and_also(self, other: _Sums) -> _Sums:
        return _Sums(self.information + other.information, self.pull + other.pull)


class ClockFinder:
    """Offsets of all cameras' stamps about their mean; feed it views, ask it now and then."""

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        self._place = {name: c for c, name in enumerate(rig.names)}
        self._views: deque[tuple[int, float, Array]] = deque()
        self._newest_s = [-np.inf] * len(rig)
        self._zero_ns: int | None = None
        self._done_s = 0.0
        self._sums = _Sums(np.zeros((len(rig), len(rig))), np.zeros(len(rig)))
        self._offset_s = np.zeros(len(rig))

    def add(self, camera: str, t_ns: int, xy_img: Array, score: Array) -> None:
        """One person's points (P, 2) in a view with their scores (P,)."""
        self._zero_ns = t_ns if self._zero_ns is None else self._zero_ns
        c, t_s = self._place[camera], (t_ns - self._zero_ns) / 1e9
        if t_s < self._newest_s[c] + _APART_S:
            return
        self._newest_s[c] = t_s
        xy = np.where((score >= _LEAST_SCORE)[:, None], self._rig.cameras[c].norm_from_px(xy_img), np.nan)
        self._views.append((c, t_s, xy))
        while self._views[0][1] < t_s - _LONGEST_S - 2 * _MARGIN_S:
            self._views.popleft()

    def find(self) -> dict[str, float] | None:
        """Offset of each camera that is known well enough; None while there is nothing new."""
        heard = [s for s in self._newest_s if np.isfinite(s)]
        if len(heard) < 2:
            return None
        end_s = float(np.median(heard)) - _MARGIN_S
        begin_s = max(self._done_s, end_s - _LONGEST_S)
        if end_s - begin_s < _BLOCK_S:
            return None
        fade = np.exp(-(end_s - self._done_s) / _FORGOTTEN_S) if self._done_s else 1.0
        self._done_s = end_s
        views = self._between(begin_s - _MARGIN_S, end_s + _MARGIN_S)
        nothing = _Sums(np.zeros_like(self._sums.information), np.zeros_like(self._sums.pull))
        before = _Sums(fade * self._sums.information, fade * self._sums.pull)
        if (told := _told(self._rig, views, self._offset_s, before)) is not None:
            if _elsewhere(told, self._offset_s):
                # a clock that was set, or the first look: paths were wrong, so this block only says where to begin
                told = _told(self._rig, views, self._offset_s, nothing) or told
                self._sums, self._offset_s = nothing, _settled(told)
            else:
                self._sums = before.and_also(told)
                self._offset_s = _settled(self._sums)
        return self._known()

    def _between(self, begin_s: float, end_s: float) -> _Views:
        inside = [view for view in self._views if begin_s <= view[1] - self._offset_s[view[0]] <= end_s]
        return _Views(
            np.array([c for c, _, _ in inside], np.intp),
            np.array([t_s for _, t_s, _ in inside]),
            np.array([xy for _, _, xy in inside]),
        )

    def _known(self) -> dict[str, float]:
        spread = np.sqrt(np.diag(np.linalg.inv(self._sums.information + _only_differences(len(self._rig)))))
        sure = [name for name, sigma_s in zip(self._rig.names, spread, strict=True) if sigma_s < _TRUSTED_S]
        return {name: float(self._offset_s[self._place[name]]) for name in sure} if len(sure) > 1 else {}


def _only_differences(count: int) -> Array:
    """Information that holds the mean of all offsets at 0, and each about there before anything is seen."""
    return np.ones((count, count)) / (count * _TRUSTED_S) ** 2 + np.eye(count) / _BEFORE_S**2


def _settled(sums: _Sums) -> Array:
    offset_s = np.linalg.solve(sums.information + _only_differences(len(sums.pull)), sums.pull)
    return np.asarray(offset_s - offset_s.mean())


def _elsewhere(told: _Sums, offset_s: Array) -> bool:
    """Whether offsets are clearly far from where they were looked for."""
    sigma_s = np.sqrt(np.diag(np.linalg.inv(told.information + _only_differences(len(offset_s)))))
    return bool((np.abs(_settled(told) - offset_s) > np.maximum(_FAR_S, _FAR_SIGMAS * sigma_s)).any())


def _told(rig: Rig, views: _Views, offset_s: Array, before: _Sums) -> _Sums | None:
    """What the views say of the offsets, looked for about `offset_s` and what was known `before`; None when there are too few."""
    if sum(np.bincount(views.c, minlength=len(rig)) >= _LEAST_VIEWS) < 2:
        return None
    paths = _Paths(rig, views, np.isfinite(views.xy[..., 0]))
    for acceleration in _ACCELERATIONS_M_S2:
        told = paths.step(offset_s, acceleration)
        told = _Sums(told.information, told.pull + told.information @ offset_s)
        moved_s = np.clip(_settled(before.and_also(told)) - offset_s, -_LONGEST_STEP_S, _LONGEST_STEP_S)
        offset_s = offset_s + moved_s
        if acceleration == _ACCELERATIONS_M_S2[-1] and np.abs(moved_s).max() < _SETTLED_S:
            break
    return told


class _Paths:
    """Splines through the rays of a block, and what is left over."""

    def __init__(self, rig: Rig, views: _Views, seen: Array) -> None:
        self._views, self._cameras = views, len(rig)
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

    def step(self, offset_s: Array, acceleration_m_s2: float) -> _Sums:
        """Fit the paths anew, and say how much later each camera's stamps are than `offset_s`."""
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
        return _Sums(information / _ALIKE, pull / _ALIKE)

    def _learn(self, place: Array, speed: Array, left: Array) -> None:
        """Depths, speeds, and how much each point of each view is believed, from what the fit left over in sigmas."""
        self._speed = speed
        self._depth = np.maximum(np.einsum("pvx,vx->pv", place, self._depth_row) + self._depth_shift, 0.3)
        sigma_px = 1 / np.sqrt(np.where(self._seen, self._weight, 1.0))
        left_px = np.linalg.norm(left, axis=-1) * sigma_px
        spread = max(float(np.median(left_px[self._seen])) / 1.18, 0.5)
        self._weight = self._seen / spread**2 / (1 + (left_px / (2 * spread)) ** 2)


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
