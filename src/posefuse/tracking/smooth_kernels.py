"""The compiled fixed-interval smoother of one point moving in space.

State: position, velocity, acceleration in three axes (9); prior: white jerk of spectral density q (m^2/s^5), i.e. the
quintic smoothing spline in state-space form. Forward Kalman filter, backward the modified Bryson-Frazier recursion
(Bierman 1973), which never inverts a covariance, so a diffuse start and gaps do no harm.
"""

from __future__ import annotations

import numpy as np

from posefuse.foundation.compiled import kernel


@kernel()
def inverse3(a, out):
    """Inverse of any 3x3 matrix into `out`; its determinant."""
    m00, m01 = a[1, 1] * a[2, 2] - a[1, 2] * a[2, 1], a[1, 2] * a[2, 0] - a[1, 0] * a[2, 2]
    m02 = a[1, 0] * a[2, 1] - a[1, 1] * a[2, 0]
    det = a[0, 0] * m00 + a[0, 1] * m01 + a[0, 2] * m02
    out[0, 0], out[1, 0], out[2, 0] = m00 / det, m01 / det, m02 / det
    out[0, 1] = (a[0, 2] * a[2, 1] - a[0, 1] * a[2, 2]) / det
    out[1, 1] = (a[0, 0] * a[2, 2] - a[0, 2] * a[2, 0]) / det
    out[2, 1] = (a[0, 1] * a[2, 0] - a[0, 0] * a[2, 1]) / det
    out[0, 2] = (a[0, 1] * a[1, 2] - a[0, 2] * a[1, 1]) / det
    out[1, 2] = (a[0, 2] * a[1, 0] - a[0, 0] * a[1, 2]) / det
    out[2, 2] = (a[0, 0] * a[1, 1] - a[0, 1] * a[1, 0]) / det
    return det


@kernel()
def add_product(out, factor, first, second):
    """out (n, m) += factor first (n, k) second (k, m), in place; `out` is part of neither."""
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            total = out[i, j]
            for m in range(first.shape[1]):
                total += factor * first[i, m] * second[m, j]
            out[i, j] = total


# standard deviations the filter starts with, far beyond any human motion: m, m/s, m/s^2
START_SIGMA = (1.0, 60.0, 2000.0)

# between two measurements nothing else holds back the acceleration: standard deviation in m/s^2, that of an arm or leg that
# moves fast, and the time after which it is another one
GAP_ACCELERATION, GAP_ACCELERATION_S = 30.0, 0.1
# rows of the state that a measurement, and a time step without one, bear on
_POSITION, _ACCELERATION = 0, 6


@kernel()
def _forward(matrix, dt):
    """matrix (9, 9) <- F matrix, F the transition over dt."""
    half = 0.5 * dt * dt
    for j in range(matrix.shape[1]):
        for i in range(3):
            matrix[i, j] += dt * matrix[3 + i, j] + half * matrix[6 + i, j]
            matrix[3 + i, j] += dt * matrix[6 + i, j]


@kernel()
def _backward(matrix, dt):
    """matrix (9, m) <- F^T matrix."""
    half = 0.5 * dt * dt
    for j in range(matrix.shape[1]):
        for i in range(3):
            matrix[6 + i, j] += half * matrix[i, j] + dt * matrix[3 + i, j]
            matrix[3 + i, j] += dt * matrix[i, j]


@kernel()
def _add_process(cov, dt, q):
    d2 = dt * dt
    for i in range(3):
        cov[i, i] += q * d2 * d2 * dt / 20.0
        cov[i, 3 + i] += q * d2 * d2 / 8.0
        cov[3 + i, i] += q * d2 * d2 / 8.0
        cov[i, 6 + i] += q * d2 * dt / 6.0
        cov[6 + i, i] += q * d2 * dt / 6.0
        cov[3 + i, 3 + i] += q * d2 * dt / 3.0
        cov[3 + i, 6 + i] += q * d2 / 2.0
        cov[6 + i, 3 + i] += q * d2 / 2.0
        cov[6 + i, 6 + i] += q * dt


@kernel()
def _filter(t, z, noise, measured, q, xs, covs, gains, inverses, innovations):
    """Predictions of every time step and the innovations of the measurements."""
    x, cov, s = np.zeros((9, 1)), np.zeros((9, 9)), np.empty((3, 3))
    for i in range(3):
        x[i, 0] = z[0, i]
        for block in range(3):
            cov[3 * block + i, 3 * block + i] = START_SIGMA[block] ** 2
    for step in range(len(t)):
        if step > 0:
            dt = t[step] - t[step - 1]
            _forward(x, dt)
            _forward(cov, dt)
            _forward(cov.T, dt)
            _add_process(cov, dt, q)
        xs[step], covs[step] = x[:, 0], cov
        row = _POSITION if measured[step] else _ACCELERATION
        for i in range(3):
            innovations[step, i, 0] = (z[step, i] if measured[step] else 0.0) - x[row + i, 0]
            for j in range(3):
                s[i, j] = cov[row + i, row + j]
                if measured[step]:
                    s[i, j] += noise[step, i, j]
            if not measured[step]:
                s[i, i] += GAP_ACCELERATION**2 * max(1.0, 2.0 * GAP_ACCELERATION_S / (t[step + 1] - t[step - 1]))
        inverse3(s, inverses[step])
        add_product(gains[step], 1.0, cov[:, row : row + 3], inverses[step])
        add_product(x, 1.0, gains[step], innovations[step])
        add_product(cov, -1.0, gains[step], covs[step, row : row + 3])
        for i in range(9):
            for j in range(i):
                cov[i, j] = cov[j, i]


@kernel()
def _absorb(gain, inverse, innovation, row, lam, big):
    """Adjoint state of a time step after a measurement of state rows row..row+2 -> before it: lam (9, 1), big (9, 9) in place."""
    pull, u, w = np.zeros((3, 1)), np.zeros((3, 9)), inverse.copy()
    add_product(pull, 1.0, gain.T, lam)
    add_product(pull, 1.0, inverse, innovation)
    lam[row : row + 3] -= pull
    add_product(u, 1.0, gain.T, big)
    add_product(w, 1.0, u, gain)
    for i in range(3):
        for j in range(9):
            big[row + i, j] -= u[i, j]
            big[j, row + i] -= u[i, j]
    for i in range(3):
        for j in range(3):
            big[row + i, row + j] += w[i, j]
    # rounding that is not symmetric would grow from step to step
    for i in range(9):
        for j in range(i):
            big[i, j] = big[j, i] = 0.5 * (big[i, j] + big[j, i])


@kernel()
def smooth_run(t, z, noise, measured, q, mean, cov):
    """Smooth one uninterrupted run: t (T,) s, z (T, 3) m, noise (T, 3, 3), measured (T,) bool, the first one True.

    Fills mean (T, 3) and cov (T, 3, 3).
    """
    count = len(t)
    xs, covs, gains = np.empty((count, 9)), np.empty((count, 9, 9)), np.zeros((count, 9, 3))
    inverses, innovations = np.empty((count, 3, 3)), np.empty((count, 3, 1))
    _filter(t, z, noise, measured, q, xs, covs, gains, inverses, innovations)
    lam, big, half = np.zeros((9, 1)), np.zeros((9, 9)), np.empty((3, 9))
    for back in range(count):
        step = count - 1 - back
        row = _POSITION if measured[step] else _ACCELERATION
        _absorb(gains[step], inverses[step], innovations[step], row, lam, big)
        p = covs[step]
        mean[step], cov[step], half[:] = xs[step, :3], p[:3, :3], 0.0
        add_product(mean[step : step + 1].T, -1.0, p[:3], lam)
        add_product(half, 1.0, p[:3], big)
        add_product(cov[step], -1.0, half, p[:, :3])
        if step > 0:
            dt = t[step] - t[step - 1]
            _backward(lam, dt)
            _backward(big, dt)
            _backward(big.T, dt)


@kernel()
def smooth_point(t, z, noise, measured, q, max_gap, mean, cov):
    """Smooth all runs of one point; a wait of more than max_gap between measurements ends a run. NaN outside runs."""
    mean[:], cov[:] = np.nan, np.nan
    first, last = -1, -1
    for step in range(len(t) + 1):
        here = step < len(t) and measured[step]
        if first >= 0 and (step == len(t) or (here and t[step] - t[last] > max_gap)):
            run = slice(first, last + 1)
            smooth_run(t[run], z[run], noise[run], measured[run], q, mean[run], cov[run])
            first = -1
        if here:
            if first < 0:
                first = step
            last = step
