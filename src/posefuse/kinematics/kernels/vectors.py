"""Vectors of three, written out: calls into BLAS would cost more than they compute."""

from __future__ import annotations

import math

import numpy as np

from posefuse.foundation.compiled import kernel


@kernel()
def vector_between_midpoints(points, from_pair, to_pair):
    """From the middle of one pair of points to that of another."""
    out = np.empty(3)
    for i in range(3):
        out[i] = 0.5 * (points[to_pair[0], i] + points[to_pair[1], i] - points[from_pair[0], i] - points[from_pair[1], i])
    return out


@kernel()
def dot(a, b):
    """a . b"""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel()
def cross(a, b):
    """a x b"""
    out = np.empty(3)
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]
    return out


@kernel()
def normal_to(v, unit):
    """Unit vector along the part of v normal to `unit`, and the length of that part."""
    out = v - dot(v, unit) * unit
    norm = math.sqrt(dot(out, out))
    return out / norm, norm


@kernel()
def variance(cov, direction):
    """Along a direction of any length: direction^T cov direction."""
    out = 0.0
    for i in range(3):
        for j in range(3):
            out += direction[i] * cov[i, j] * direction[j]
    return out
