"""How well a robot follows a hand: lag, error without the lag, jitter, smoothness. Pure functions of positions over time."""

from __future__ import annotations

import numpy as np

from posefuse.core.arrays import Array

# SPARC: highest frequency, and share of the largest amplitude below which the spectrum ends (Balasubramanian et al. 2015)
_SPARC_HZ, _SPARC_SHARE = 10.0, 0.05
_SPARC_PADDING = 4


def lag_and_rms(hand: Array, robot: Array, rate_hz: float, longest_s: float = 0.4) -> tuple[float, float]:
    """Lag in s that leaves the least error of displacements (T, 3), and the root mean square of that error, m.

    Each path counts from its own mean, as the clutch makes their places arbitrary.
    """
    best = (0.0, np.inf)
    longest = round(longest_s * rate_hz)
    for k in range(longest + 1):
        # the same stretch of the hand for every lag, so that they compare
        h, r = hand[: len(hand) - longest], robot[k : len(robot) - longest + k]
        error = (r - r.mean(axis=0)) - (h - h.mean(axis=0))
        rms = float(np.sqrt((error**2).sum(axis=1).mean()))
        if rms < best[1]:
            best = (k / rate_hz, rms)
    return best


def jitter_m(xyz: Array, rate_hz: float, window_s: float = 1.0) -> float:
    """Root mean square distance of positions (T, 3) at rest from their mean over windows of one second."""
    n = round(window_s * rate_hz)
    windows = [xyz[i : i + n] for i in range(0, len(xyz) - n + 1, n)]
    squares = [((window - window.mean(axis=0)) ** 2).sum(axis=1).mean() for window in windows]
    return float(np.sqrt(np.mean(squares)))


def spectral_arc_length(xyz: Array, rate_hz: float) -> float:
    """SPARC of the speed of a path (T, 3): negative, nearer to 0 is smoother (Balasubramanian et al. 2015)."""
    speed = np.linalg.norm(np.diff(xyz, axis=0), axis=1) * rate_hz
    count = 2 ** (int(np.ceil(np.log2(len(speed)))) + _SPARC_PADDING)
    frequency = np.fft.rfftfreq(count, 1 / rate_hz)
    amplitude = np.abs(np.fft.rfft(speed, count))
    amplitude = amplitude / amplitude.max()
    inside = frequency <= _SPARC_HZ
    frequency, amplitude = frequency[inside], amplitude[inside]
    last = int(np.flatnonzero(amplitude >= _SPARC_SHARE)[-1])
    frequency, amplitude = frequency[: last + 1], amplitude[: last + 1]
    if last == 0:
        return 0.0
    steps = np.diff(frequency) / (frequency[-1] - frequency[0])
    return -float(np.sqrt(steps**2 + np.diff(amplitude) ** 2).sum())


def rms_jerk(xyz: Array, rate_hz: float) -> float:
    """Root mean square jerk of a path (T, 3), m/s^3."""
    return float(np.sqrt((np.diff(xyz, n=3, axis=0) ** 2).sum(axis=1).mean())) * rate_hz**3
