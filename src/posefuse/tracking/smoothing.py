"""Recorded data: zero-lag smoothing, gaps, outliers; and bones that keep their length, a soft prior within each time step."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from posefuse.core import Kind, PoseSequence, Skeleton
from posefuse.core.arrays import MEDIAN_CHI2, SIGMA_PER_MAD, Array, give_away

from .settings import SmoothSettings

# |H| = 1 / (1 + (f / f0)^6) of the white-jerk smoother is 1 / sqrt(2) at this share of f0
_HALF_POWER = (np.sqrt(2) - 1) ** (1 / 6)
# the model of the response holds while the sampled signal keeps away from its Nyquist frequency
_RATE_SHARE = 0.35
_PASSES = 6
# in units of its time scale: where the smoother's weight has fallen to less than a hundredth
_REACH = 9.0


def cutoff_hz(t_ns: Array, settings: SmoothSettings) -> float:
    """The cut-off in force for these times: the one asked for, or 0.35 of the frame rate if that is less."""
    if len(t_ns) < 2:
        return settings.cutoff_hz
    return min(settings.cutoff_hz, _RATE_SHARE / (float(np.median(np.diff(t_ns))) * 1e-9))


def smooth(sequence: PoseSequence, settings: SmoothSettings) -> PoseSequence:
    """The recording without its jitter, gaps up to `max_gap_s` bridged, nothing invented before or after.

    Each keypoint is a point under white jerk, measured with its own covariance at its own times (irregular times are
    fine): the exact posterior given all its measurements, past and future, so there is no lag. The strength of the jerk
    is set so that at the keypoint's typical noise the response is that of `cutoff_hz`. Measurements the others
    contradict are left out, and covariances grow by the ratio of residuals to stated values, and by what lasting
    errors leave. Bone lengths then hold the keypoints of each time step together (`hold_bones`).

    Returns:
        PoseSequence: kind SMOOTHED where measured, INTERPOLATED inside a bridged gap (n_views 0, reproj_px NaN;
        covariance grown accordingly), MISSING elsewhere.
    """
    xyz, cov = sequence.xyz_world.copy(), sequence.cov_world.copy()
    used, scales = smooth_in_place(sequence.t_ns, sequence.skeleton, xyz, cov, settings)
    rate_hz, (people, keypoints) = cutoff_hz(sequence.t_ns, settings), sequence.kind.shape[1:]
    # after the bones: they constrain the smoother's estimate, not the common error of all keypoints
    for n, k in np.ndindex(people, keypoints):
        noise = scales[n, k] * sequence.cov_world[:, n, k]
        cov[:, n, k] += _lasting(sequence.t_ns, noise, cov[:, n, k], used[:, n, k], rate_hz, settings)
    there = np.isfinite(xyz[..., 0])
    kind = np.where(used, Kind.SMOOTHED, np.where(there, Kind.INTERPOLATED, Kind.MISSING))
    give_away(xyz, cov)
    return replace(
        sequence,
        xyz_world=xyz,
        cov_world=cov,
        reproj_px=np.where(used, sequence.reproj_px, np.nan),
        n_views=np.where(used, sequence.n_views, 0),
        kind=kind,
    )


def smooth_in_place(t_ns: Array, skeleton: Skeleton, xyz: Array, cov: Array, settings: SmoothSettings) -> tuple[Array, Array]:
    """Smooth positions (T, N, K, 3) and covariances (T, N, K, 3, 3) where they lie: of an hour, a second copy takes much memory.

    Covariances lack what lasting errors leave, which needs the measured ones; see `smooth`.

    Returns:
        Which measurements (T, N, K) went into it, and by what covariances (N, K) had to grow.
    """
    used, scales, rate_hz = np.zeros(xyz.shape[:-1], bool), np.ones(xyz.shape[1:-1]), cutoff_hz(t_ns, settings)
    for n in range(xyz.shape[1]):
        for k in range(xyz.shape[2]):
            point = np.ascontiguousarray(xyz[:, n, k]), np.ascontiguousarray(cov[:, n, k])
            xyz[:, n, k], cov[:, n, k], used[:, n, k], scales[n, k] = _smooth_point(t_ns, *point, rate_hz, settings)
        if settings.bones and len(skeleton.bone_indices):
            hold_bones(xyz[:, n], cov[:, n], used[:, n], skeleton, settings.bone_sigma_m)
    return used, scales


def _smooth_point(
    t_ns: Array, z: Array, noise: Array, rate_hz: float, settings: SmoothSettings
) -> tuple[Array, Array, Array, float]:
    """Posterior mean (T, 3), covariance (T, 3, 3), which measurements (T,) went into it, and by what covariances had to grow."""
    from . import smooth_kernels

    measured = np.asarray(np.isfinite(z).all(axis=-1) & np.isfinite(noise).all(axis=(-1, -2)))
    mean, cov = np.full(z.shape, np.nan), np.full(noise.shape, np.nan)
    if not measured.any():
        return mean, cov, measured, 1.0
    t_s = (t_ns - t_ns[0]) * 1e-9
    q = _jerk_density(t_s, noise[measured], rate_hz)
    z, noise = np.where(measured[:, None], z, 0.0), np.where(measured[:, None, None], noise, 0.0)
    gate = settings.outlier_sigma**2

    def solve() -> tuple[Array, float]:
        smooth_kernels.smooth_point(t_s, z, noise, measured & ~left_out, q, settings.max_gap_s, mean, cov)
        miss = _contradiction(z, noise, mean, cov, measured, left_out)
        known = np.isfinite(miss) & ~left_out
        return miss, max(1.0, float(np.median(miss[known])) / MEDIAN_CHI2) if known.any() else 1.0

    left_out = np.zeros(len(z), bool)
    miss, scale = solve()
    for _ in range(_PASSES):
        worst = _peaks(np.where(left_out, np.nan, miss)) & (miss > gate * scale)
        if not worst.any():
            break
        left_out |= worst
        miss, scale = solve()
    # what only looked bad next to an outlier comes back: twelve good time steps about one that lasts for three
    welcome = left_out & (miss < gate * scale)
    if welcome.any():
        left_out &= ~welcome
        _, scale = solve()
    return mean, cov * scale, measured & ~left_out, scale


def _lasting(t_ns: Array, noise: Array, cov: Array, used: Array, rate_hz: float, settings: SmoothSettings) -> Array:
    """(T, 3, 3) what lasting errors add to a covariance (T, 3, 3) of errors that are independent.

    With weights w that sum to 1, independent errors of unit variance leave sum w_i^2. Of the rest that is averaged away, those
    that last leave a share: the mean of exp(-|t_i - t_j| / lasting_s) over all pairs of different measurements.
    """
    if not used.any():
        return np.zeros(noise.shape)
    t_s = (t_ns - t_ns[0]) * 1e-9
    step_s = float(np.median(np.diff(t_s))) if len(t_s) > 1 else 1.0
    rate = 2 * np.pi * rate_hz / _HALF_POWER
    reach = math.ceil(_REACH / (rate * step_s))
    at_s = np.arange(-reach, reach + 1) * step_s
    weight = _weight(at_s * rate)
    pairs = np.outer(weight, weight) * (1 - np.eye(len(weight)))
    alike = float((pairs * np.exp(-np.abs(at_s[:, None] - at_s) / settings.lasting_s)).sum() / pairs.sum())
    flat = [np.interp(t_s, t_s[used], part[used]) for part in noise.reshape(-1, 9).T]
    around = np.stack(flat, axis=-1).reshape(noise.shape)
    averaged = 1 - np.trace(cov, axis1=-2, axis2=-1) / np.trace(around, axis1=-2, axis2=-1)
    return np.asarray(settings.lasting_share * max(alike, 0.0) * np.maximum(averaged, 0.0)[:, None, None] * around)


def _weight(x: Array) -> Array:
    """The smoother's weight of a measurement x time scales away: the transform of 1 / (1 + w^6), but for a factor."""
    x = np.abs(x)
    turn = 0.5 * np.sqrt(3.0) * x
    return np.asarray(np.exp(-x) + np.exp(-0.5 * x) * (np.cos(turn) + np.sqrt(3.0) * np.sin(turn)))


def _jerk_density(t_s: Array, noise: Array, rate_hz: float) -> float:
    """q in m^2/s^5 for which a signal sampled with the typical noise passes 1/sqrt(2) at rate_hz.

    The smoother's response is 1 / (1 + w^6 r dt / q): the quintic smoothing spline's.
    """
    variance = float(np.median(np.trace(noise, axis1=-2, axis2=-1))) / 3
    step_s = float(np.median(np.diff(t_s))) if len(t_s) > 1 else 1.0
    return float((2 * np.pi * rate_hz / _HALF_POWER) ** 6 * variance * step_s)


def _contradiction(z: Array, noise: Array, mean: Array, cov: Array, measured: Array, left_out: Array) -> Array:
    """(T,) squared distance of each measurement from the estimate of all others, in units of its variance; NaN where none.

    Residual and posterior of a linear model give it without leaving anything out: cov(z - mean) is noise - cov for a
    measurement that went in, noise + cov for one that did not.
    """
    miss = np.full(len(z), np.nan)
    sign = np.where(left_out, 1.0, -1.0)[:, None, None]
    spread = np.where((measured & np.isfinite(mean[:, 0]))[:, None, None], noise + sign * cov, 0.0)
    # alone in its run a measurement is its own posterior: nothing contradicts it
    known = np.linalg.eigvalsh(spread)[:, 0] > 1e-6 * np.trace(noise, axis1=-2, axis2=-1)
    residual = (z - mean)[known]
    miss[known] = (residual * np.linalg.solve(spread[known], residual[..., None])[..., 0]).sum(axis=-1)
    return miss


def _peaks(miss: Array) -> Array:
    """Where a value is no less than its finite neighbours': an outlier makes those next to it look bad too."""
    full = np.where(np.isfinite(miss), miss, -np.inf)
    left, right = np.concatenate([[-np.inf], full[:-1]]), np.concatenate([full[1:], [-np.inf]])
    return (full >= left) & (full >= right) & np.isfinite(miss)


# chosen, not fitted: the median of ten lengths scatters by about 0.4 of what one does
_MIN_TIME_STEPS = 10
# chosen, not fitted: from three steps on the end is far nearer to the minimum than the minimum to the truth
_ITERATIONS = 3
# time steps solved at once, which bounds the memory for slopes (T, B, K, 3) of a long recording; results do not depend on it
_CHUNK = 256


def bone_lengths(xyz: Array, cov: Array, used: Array, skeleton: Skeleton, sigma_min_m: float) -> tuple[Array, Array]:
    """Length (B,) of each bone over a recording and how constant it was, as a standard deviation (B,), in metres.

    Args:
        xyz, cov, used: (T, K, 3), (T, K, 3, 3), (T, K) bool: which time steps count.
        skeleton: its bones.
        sigma_min_m: the least spread that is believed.

    Returns:
        NaN for a bone seen in fewer than ten time steps. The length is the median, less what noise across the bone adds to
        a distance; the spread is that of the lengths beyond what the covariances explain.
    """
    centre, spread = np.full((2, len(skeleton.bone_indices)), np.nan)
    for b, (one, two) in enumerate(skeleton.bone_indices.tolist()):
        span, both = xyz[:, one] - xyz[:, two], cov[:, one] + cov[:, two]
        distance = np.linalg.norm(span, axis=-1)
        counts = used[:, one] & used[:, two] & np.isfinite(distance)
        if counts.sum() < _MIN_TIME_STEPS:
            continue
        divisor = np.where(distance > 1e-9, distance, np.nan)
        along = span / divisor[:, None]
        variance = np.einsum("ti,tij,tj->t", along, both, along)
        across = np.trace(both, axis1=-2, axis2=-1) - variance
        length = np.where(counts, distance - across / (2 * divisor), np.nan)
        centre[b] = np.nanmedian(length)
        seen = SIGMA_PER_MAD * np.nanmedian(np.abs(length - centre[b]))
        noise = np.nanmedian(np.where(counts, variance, np.nan))
        spread[b] = np.sqrt(np.maximum(seen**2 - noise, sigma_min_m**2))
    return centre, spread


def hold_bones(xyz: Array, cov: Array, used: Array, skeleton: Skeleton, sigma_min_m: float) -> None:
    """One person's keypoints (T, K, 3) and covariances (T, K, 3, 3), given also that bones keep their length, in place.

    Iterated extended Kalman update of each time step with one pseudo-measurement per bone, |a - b| = length with its spread
    (`bone_lengths`): the Gauss-Newton minimum of the keypoints' Mahalanobis distances plus the bones' squared errors.
    Missing keypoints stay missing, and bones that end in one carry no information.
    """
    length, spread = bone_lengths(xyz, cov, used, skeleton, sigma_min_m)
    known = np.flatnonzero(np.isfinite(length) & (length > 0.02))
    if not len(known):
        return
    ends = skeleton.bone_indices[known]
    for start in range(0, len(xyz), _CHUNK):
        part = slice(start, start + _CHUNK)
        xyz[part], cov[part] = _hold(xyz[part], cov[part], ends, length[known], spread[known])


def _hold(xyz: Array, cov: Array, ends: Array, length: Array, spread: Array) -> tuple[Array, Array]:
    there = np.asarray(np.isfinite(xyz).all(axis=-1) & np.isfinite(cov).all(axis=(-1, -2)))
    prior = np.where(there[..., None], xyz, 0.0)
    prior_cov = np.where(there[..., None, None], cov, 0.0)
    held, known = prior, there[:, ends].all(axis=-1)
    count, keypoints = there.shape
    # (B, K) which keypoint each bone goes to, and from which: 1 and -1
    bones = np.eye(keypoints)[ends[:, 0]] - np.eye(keypoints)[ends[:, 1]]
    for _ in range(_ITERATIONS):
        span = bones @ held
        distance = np.linalg.norm(span, axis=-1)
        used = known & (distance > 1e-6)
        along = np.where(used[..., None], span / np.where(used, distance, 1.0)[..., None], 0.0)
        # J and J P (T, B, K, 3): covariances of different keypoints are independent
        slope = bones[..., None] * along[:, :, None]
        pushed = np.einsum("tbki,tkij->tbkj", slope, prior_cov)
        slope, flat = (rows.reshape(count, len(ends), -1) for rows in (slope, pushed))
        innovation = flat @ slope.transpose(0, 2, 1) + np.diag(spread**2)
        error = np.where(used, length - distance - (slope @ (prior - held).reshape(count, -1, 1))[..., 0], 0.0)
        held = prior + (flat.transpose(0, 2, 1) @ np.linalg.solve(innovation, error[..., None])).reshape(prior.shape)
    weighted = np.linalg.solve(innovation, flat).reshape(pushed.shape)
    narrowed = prior_cov - np.einsum("tbki,tbkj->tkij", pushed, weighted)
    return np.where(there[..., None], held, np.nan), np.where(there[..., None, None], narrowed, np.nan)
