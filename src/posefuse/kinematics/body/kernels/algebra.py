"""Dense algebra of 50 to 100 unknowns."""

from __future__ import annotations

import math

import numpy as np

from posefuse.foundation.compiled import kernel

# own loops for the dense algebra: at these sizes (50 to 100) as quick as BLAS, whose threads fight those of a live session
_DENSE = {"fastmath": True}


@kernel(**_DENSE)
def times_transposed(a, b):
    """a @ b^T of C-contiguous (n, k) and (m, k)."""
    out = np.empty((a.shape[0], b.shape[0]))
    for i in range(a.shape[0]):
        for j in range(b.shape[0]):
            total = 0.0
            for k in range(a.shape[1]):
                total += a[i, k] * b[j, k]
            out[i, j] = total
    return out


@kernel(**_DENSE)
def cholesky(a):
    """Lower factor of a symmetric positive definite matrix."""
    n = a.shape[0]
    lower = np.zeros((n, n))
    for i in range(n):
        for j in range(i + 1):
            total = a[i, j]
            for k in range(j):
                total -= lower[i, k] * lower[j, k]
            lower[i, j] = math.sqrt(total) if i == j else total / lower[j, j]
    return lower


@kernel(**_DENSE)
def solve_rows(a, rows):
    """(m, n) whose every row x solves a x = row, for a symmetric positive definite (n, n)."""
    lower = cholesky(a)
    upper = np.ascontiguousarray(lower.T)
    out = np.empty(rows.shape)
    n = a.shape[0]
    for r in range(rows.shape[0]):
        x = out[r]
        for i in range(n):
            total = rows[r, i]
            for k in range(i):
                total -= lower[i, k] * x[k]
            x[i] = total / lower[i, i]
        for i in range(n - 1, -1, -1):
            total = x[i]
            for k in range(i + 1, n):
                total -= upper[i, k] * x[k]
            x[i] = total / lower[i, i]
    return out


@kernel()
def inverse(a):
    """Inverse of a symmetric positive definite matrix, symmetric to the last bit."""
    out = solve_rows(a, np.eye(a.shape[0]))
    return 0.5 * (out + out.T)
