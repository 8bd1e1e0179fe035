"""Between time steps: prediction, update by a fit, and the backward pass."""

from __future__ import annotations

import math

import numpy as np

from posefuse.foundation.compiled import kernel

from .algebra import solve_rows, times_transposed
from .tree import BALL, retract


@kernel()
def predict(kind, dof, slack_var, accel, elapsed_s, memory_s, slack_memory_s, q, rot, velocity, cov):
    """Carry state, velocity (D,) and covariance (2D, 2D) over a time; in place. Returns the transition's three diagonals.

    Velocities fade (Ornstein-Uhlenbeck) with white acceleration; slack falls back to zero with its own stationary spread.
    """
    size = dof[-1]
    keep = np.ones(size)
    drift = np.zeros(size)
    fade = np.zeros(size)
    decay = math.exp(-elapsed_s / memory_s)
    forget = math.exp(-elapsed_s / slack_memory_s)
    for d in range(size):
        if slack_var[d] > 0.0:
            keep[d] = forget
        else:
            drift[d], fade[d] = memory_s * (1.0 - decay), decay
    step = drift * velocity
    for n in range(kind.shape[0]):
        if kind[n] != BALL and slack_var[dof[n]] > 0.0:
            q[n] *= forget
    retract(kind, dof, step, q, rot)
    velocity *= fade
    _spread(cov, keep, drift, fade)
    for d in range(size):
        if slack_var[d] > 0.0:
            cov[d, d] += slack_var[d] * (1.0 - forget * forget)
            cov[size + d, size + d] = 1e-12
        else:
            power = accel[d] ** 2
            cov[d, d] += power * elapsed_s**3 / 3.0
            cov[d, size + d] += power * elapsed_s**2 / 2.0
            cov[size + d, d] += power * elapsed_s**2 / 2.0
            cov[size + d, size + d] += power * elapsed_s
    return keep, drift, fade


@kernel()
def _spread(cov, keep, drift, fade):
    """F cov F^T in place, F = [[diag(keep), diag(drift)], [0, diag(fade)]]."""
    n = keep.shape[0]
    for i in range(n):
        for j in range(2 * n):
            cov[i, j] = keep[i] * cov[i, j] + drift[i] * cov[n + i, j]
            cov[n + i, j] *= fade[i]
    for j in range(n):
        for i in range(2 * n):
            cov[i, j] = keep[j] * cov[i, j] + drift[j] * cov[i, n + j]
            cov[i, n + j] *= fade[j]


@kernel()
def absorb(cov, expected_information, posterior, step, velocity):
    """Measurement update of covariance (2D, 2D) and velocity, in place, given the new covariance and step of the state."""
    n = step.shape[0]
    gain = times_transposed(cov[n:, :n].copy(), expected_information)
    velocity += gain @ step
    across = times_transposed(gain, cov[:n, :n] - posterior)
    cov[n:, n:] -= times_transposed(across, gain)
    # an antisymmetric part, however small, would grow from step to step
    cov[n:, n:] = 0.5 * (cov[n:, n:] + cov[n:, n:].copy().T)
    cov[n:, :n] = times_transposed(gain, posterior)
    cov[:n, n:] = cov[n:, :n].T.copy()
    cov[:n, :n] = posterior


@kernel()
def smooth_step(cov, keep, drift, fade, cov_expected, cov_next, change):
    """One backward step (Rauch, Tung, Striebel): the change (2D,) of the filtered state and its smoothed covariance."""
    n = keep.shape[0]
    cross = cov.copy()
    for j in range(n):
        for i in range(2 * n):
            cross[i, j] = keep[j] * cov[i, j] + drift[j] * cov[i, n + j]
            cross[i, n + j] = fade[j] * cov[i, n + j]
    gain = solve_rows(cov_expected, cross)
    moved = gain @ change
    smoothed = cov + times_transposed(times_transposed(gain, cov_next - cov_expected), gain)
    return moved, 0.5 * (smoothed + smoothed.T)


@kernel()
def add_point_variance(weights, rows, jacobians, cov, sigmas):
    """Add to sigmas (J, 3) what errors of the state do through the landmarks: weights (J, P, 3, 3) of each angle."""
    size = cov.shape[0]
    for q in range(weights.shape[0]):
        for a in range(3):
            if math.isnan(sigmas[q, a]):
                continue
            g = np.zeros(size)
            for p in range(rows.shape[0]):
                for half in range(2):
                    r = rows[p, half]
                    if r < 0:
                        continue
                    for i in range(3):
                        w = 0.5 * weights[q, p, a, i]
                        if w != 0.0:
                            g += w * jacobians[r, i]
            sigmas[q, a] = math.sqrt(sigmas[q, a] ** 2 + g @ (cov @ g))
