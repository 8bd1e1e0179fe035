"""Clocks of calibrated cameras from what moves in front of them: offset and drift of each against the reference.

With the rig known, a point's images must meet in space. Between two frames an image point moves by its velocity times the
clock error, so the offset is a least-squares problem in the epipolar distance; a coarse search comes first, because
that linearisation holds for some frames only. Works for keypoints of a person and for corners of a prop alike.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import make_smoothing_spline
from scipy.optimize import least_squares

from posefuse.core import CalibrationError, Rig
from posefuse.core.arrays import Array

_STEP_S = 0.01
_LEAST_KNOWN = 8
# lets motion of up to a ninth of the frame rate through
_SMOOTHING_FRAMES = 3.0
# offset in s and drift in s/s over which the image motion is straight
_STEPS = np.array([1e-4, 1e-6])
_LEAST_INFORMATION, _LEAST_SPREAD_PX = 1e-6, 0.05
_LEAST_POINTS = 100
_LOSS_PX = 2.0
_LONGEST_GAP_PERIODS = 2.2
_MOST_SAMPLES = 400
_TRUSTED_SIGMA_S = 0.02


@dataclass(frozen=True, eq=False)
class Track:
    """What one camera saw of P named points: stamps t_s (F,) and raw px xy_img (F, P, 2), NaN where unseen."""

    t_s: Array
    xy_img: Array


@dataclass(frozen=True, eq=False)
class ClockEstimate:
    """offset_s, drift, and their standard errors, each (C,); the reference camera has 0.

    A frame that camera c stamped s was taken at s - offset - drift * (s - middle_s) on the reference camera's clock.
    """

    offset_s: Array
    drift: Array
    offset_sigma_s: Array
    drift_sigma: Array
    middle_s: float


def estimate_clocks(
    rig: Rig, tracks: tuple[Track, ...], most_s: float = 0.3, reference: int = 0, with_drift: bool = False
) -> ClockEstimate:
    """Clock of every camera against the reference, each pair by itself.

    Raises:
        CalibrationError: a camera shares too little motion with the reference, by name.
    """
    count = len(rig)
    offset, drift, offset_sigma, drift_sigma = (np.zeros(count) for _ in range(4))
    times = _samples(tracks[reference].t_s)
    middle = float((tracks[reference].t_s[0] + tracks[reference].t_s[-1]) / 2)
    for c in range(count):
        if c == reference:
            continue
        pair = _Pair(rig, tracks, reference, c, times, middle)
        values, sigmas = pair.solve(most_s, with_drift)
        offset[c], drift[c] = values
        offset_sigma[c], drift_sigma[c] = sigmas
        if not offset_sigma[c] < _TRUSTED_SIGMA_S:
            raise CalibrationError(
                f"clock of {rig.names[c]} against {rig.names[reference]}: not determined (standard error"
                f" {offset_sigma[c] * 1e3:.0f} ms); more motion across the line between the two is needed"
            )
    return ClockEstimate(offset, drift, offset_sigma, drift_sigma, middle)


def _samples(t_s: Array) -> Array:
    return t_s[:: max(1, len(t_s) // _MOST_SAMPLES)]


class _Pair:
    """Epipolar distances of one camera's interpolated points to the reference camera's."""

    def __init__(self, rig: Rig, tracks: tuple[Track, ...], reference: int, other: int, times: Array, middle_s: float) -> None:
        self._camera, self._times, self._middle = rig.cameras[other], times, middle_s
        self._names = (rig.names[reference], rig.names[other])
        at = np.searchsorted(tracks[reference].t_s, times)
        self._norm_a = rig.cameras[reference].norm_from_px(tracks[reference].xy_img[at])
        b_from_a = self._camera.cam_from_world @ rig.cameras[reference].cam_from_world.inverse()
        x, y, z = b_from_a.xyz
        self._essential = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) @ b_from_a.matrix()
        self._lines = self._with_one(self._norm_a) @ self._essential.T
        self._splines = [_spline(tracks[other].t_s, tracks[other].xy_img[:, p]) for p in range(tracks[other].xy_img.shape[1])]

    @staticmethod
    def _with_one(norm: Array) -> Array:
        return np.concatenate([norm, np.ones_like(norm[..., :1])], axis=-1)

    def distances_px(self, offset_s: float, drift: float) -> Array:
        """(S, P) signed distance to the epipolar line in px; NaN where either does not see the point."""
        wanted = self._times + offset_s + drift * (self._times - self._middle)
        xy = np.stack([spline(wanted) for spline in self._splines], axis=1)
        norm = self._camera.norm_from_px(xy)
        length = np.linalg.norm(self._lines[..., :2], axis=-1)
        return np.asarray((self._with_one(norm) * self._lines).sum(axis=-1) / length * self._camera.K[0, 0])

    def solve(self, most_s: float, with_drift: bool) -> tuple[tuple[float, float], tuple[float, float]]:
        trials = np.arange(-most_s, most_s + _STEP_S / 2, _STEP_S)
        cost = np.array([self._cost(trial) for trial in trials])
        if not np.isfinite(cost).any():
            raise CalibrationError(f"clock of {self._names[1]} against {self._names[0]}: too few points seen by both")
        first = float(trials[int(np.nanargmin(cost))])
        start = np.array([first, 0.0]) if with_drift else np.array([first])
        seen = np.isfinite(self.distances_px(first, 0.0))

        steps = _STEPS[: len(start)]

        def residual(p: Array) -> Array:
            x = start + p * steps
            off = self.distances_px(x[0], x[1] if with_drift else 0.0)[seen]
            return np.asarray(np.where(np.isfinite(off), off, 0.0))

        def jacobian(p: Array) -> Array:
            return np.stack([(residual(p + h) - residual(p - h)) / 2 for h in np.eye(len(p))], axis=1)

        found = least_squares(residual, np.zeros(len(start)), jac=jacobian, loss="cauchy", f_scale=_LOSS_PX)
        spread = max(1.4826 * float(np.median(np.abs(residual(found.x)))), _LEAST_SPREAD_PX)
        slope = jacobian(found.x)
        information = slope.T @ slope / spread**2
        known = np.linalg.eigvalsh(information).min() > _LEAST_INFORMATION
        sigma = np.sqrt(np.diag(np.linalg.inv(information))) * steps if known else np.full(len(start), np.inf)
        values = np.pad(start + found.x * steps, (0, 2 - len(start)))
        sigmas = np.pad(sigma, (0, 2 - len(start)))
        return (float(values[0]), float(values[1])), (float(sigmas[0]), float(sigmas[1]))

    def _cost(self, offset_s: float) -> float:
        off = self.distances_px(offset_s, 0.0)
        off = off[np.isfinite(off)]
        return float(np.median(np.abs(off))) if len(off) >= _LEAST_POINTS else float("nan")


def _spline(t_s: Array, xy: Array) -> Callable[[Array], Array]:
    """Interpolator times (n,) -> (n, 2), NaN outside what was seen and across gaps."""
    good = np.isfinite(xy).all(axis=-1)
    if good.sum() < _LEAST_KNOWN:
        return lambda wanted: np.full((len(wanted), 2), np.nan)
    known_s = t_s[good]
    # smoothed, because the noise of an interpolated velocity would pull clocks towards no offset
    period = float(np.median(np.diff(t_s)))
    curve = make_smoothing_spline(known_s / period, xy[good], lam=_SMOOTHING_FRAMES)
    longest = _LONGEST_GAP_PERIODS * period

    def at(wanted: Array) -> Array:
        after = np.clip(np.searchsorted(known_s, wanted), 1, len(known_s) - 1)
        inside = (wanted >= known_s[0]) & (wanted <= known_s[-1]) & (known_s[after] - known_s[after - 1] <= longest)
        return np.asarray(np.where(inside[:, None], curve(wanted / period), np.nan))

    return at
