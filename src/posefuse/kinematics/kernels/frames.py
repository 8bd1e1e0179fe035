"""Landmarks to segment frames, and how a frame errs when its points do."""

from __future__ import annotations

import math

import numpy as np

from posefuse.foundation.compiled import kernel

# Vectors of three, written out: calls into BLAS would cost more than they compute.


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


_ROUNDING = 1e-6


@kernel()
def gather_landmarks(xyz, cov, pairs, default_var, points, points_cov):
    """Landmarks (P, 3) and covariances (P, 3, 3) as means of keypoint pairs; unknown covariance becomes `default_var`."""
    for p in range(pairs.shape[0]):
        a, b = pairs[p, 0], pairs[p, 1]
        if a < 0:
            points[p] = np.nan
            points_cov[p] = np.nan
            continue
        points[p] = 0.5 * (xyz[a] + xyz[b])
        if a == b:
            points_cov[p] = cov[a]
        else:
            points_cov[p] = 0.25 * (cov[a] + cov[b])
        if math.isnan(points_cov[p, 0, 0]):
            points_cov[p] = 0.0
            for i in range(3):
                points_cov[p, i, i] = default_var


@kernel()
def free_frame(points, pairs, first_axis, second_axis, rotation, by_first, by_second):
    """Frame (3, 3, columns are axes) of a first and a second vector, and omega's derivatives by both."""
    first = vector_between_midpoints(points, pairs[1], pairs[2])
    second = vector_between_midpoints(points, pairs[3], pairs[4])
    length = math.sqrt(dot(first, first))
    u = first / length
    w, breadth = normal_to(second, u)
    k = cross(u, w)
    sign = 1.0 if second_axis == (first_axis + 1) % 3 else -1.0
    along = dot(second, u)
    for i in range(3):
        rotation[i, first_axis] = u[i]
        rotation[i, second_axis] = w[i]
        rotation[i, 3 - first_axis - second_axis] = sign * k[i]
        for j in range(3):
            by_first[i, j] = (k[i] * w[j] - w[i] * k[j] - along / breadth * u[i] * k[j]) / length
            by_second[i, j] = u[i] * k[j] / breadth


@kernel()
def upper_frame(points, pairs, plane, rotation, by_first, by_second):
    """Frame of a limb's upper segment, turned by `plane`; returns the variance of the turn not due to these points."""
    free_frame(points, pairs, 1, 0, rotation, by_first, by_second)
    y = rotation[:, 1].copy()
    z, _ = normal_to(plane[:3], y)
    x = cross(y, z)
    share = min(1.0, plane[3] / plane[4]) if plane[4] > 0.0 else 1.0
    if not plane[4] < np.inf:
        share = 0.0
    length = vector_between_midpoints(points, pairs[1], pairs[2])
    inverse = 1.0 / math.sqrt(dot(length, length))
    for i in range(3):
        rotation[i, 0], rotation[i, 2] = x[i], z[i]
    for j in range(3):
        # the turn follows the seen plane only by its share of the estimate
        first, second = 0.0, 0.0
        if share > 0.0:
            for i in range(3):
                first += y[i] * by_first[i, j]
                second += y[i] * by_second[i, j]
        for i in range(3):
            by_first[i, j] = (x[i] * z[j] - z[i] * x[j]) * inverse + share * first * y[i]
            by_second[i, j] = share * second * y[i]
    return max(0.0, plane[3] - share * share * plane[5]) if share > 0.0 else plane[3]


@kernel()
def lower_frame(points, pairs, bend, upper, upper_by_first, upper_by_second, rotation, by_first, by_second):
    """Frame of a limb's lower segment: its Z is the upper one's, so its turn errs as that one's does."""
    first = vector_between_midpoints(points, pairs[1], pairs[2])
    length = math.sqrt(dot(first, first))
    y = first / length
    z, _ = normal_to(np.ascontiguousarray(upper[:, 2]), y)
    x = cross(y, z)
    for j in range(3):
        turn_first, turn_second = 0.0, 0.0
        for i in range(3):
            # the two segments are spanned by the same two vectors, in the other order
            turn_second += bend * y[i] * upper_by_first[i, j]
            turn_first -= bend * y[i] * upper_by_second[i, j]
        for i in range(3):
            by_first[i, j] = (x[i] * z[j] - z[i] * x[j]) / length + turn_first * y[i]
            by_second[i, j] = turn_second * y[i]
    for i in range(3):
        rotation[i, 0], rotation[i, 1], rotation[i, 2] = x[i], y[i], z[i]
    return dot(y, upper[:, 1]) ** 2


@kernel()
def segment_frames(points, planes, pairs, axes, raised, bends, rotation, by_first, by_second, turn_var):
    """All frames (S, 3, 3), the derivatives of their errors by both vectors, and the limbs' own turn variance (S,).

    raised (S,): by how much each frame is turned about its own Z in the end; errors of it in world axes stay what they are.
    """
    for s in range(pairs.shape[0]):
        limb = axes[s, 2]
        if limb < 0:
            free_frame(points, pairs[s], axes[s, 0], axes[s, 1], rotation[s], by_first[s], by_second[s])
            turn_var[s] = 0.0
            if raised[s] != 0.0:
                _raise(rotation[s], raised[s])
        elif axes[s, 3] == 0:
            turn_var[s] = upper_frame(points, pairs[s], planes[limb], rotation[s], by_first[s], by_second[s])
        else:
            # the lower segment stands right after the upper one in the table
            u = s - 1
            turn_var[s] = turn_var[u] * lower_frame(
                points, pairs[s], bends[limb], rotation[u], by_first[u], by_second[u], rotation[s], by_first[s], by_second[s]
            )
    for s in range(pairs.shape[0]):
        # points that coincide, or are too far away to be distinguished in floating point, span no frame
        if not _is_rotation(rotation[s]):
            rotation[s] = np.nan


@kernel()
def _raise(rotation, angle):
    x, y = rotation[:, 0].copy(), rotation[:, 1].copy()
    cosine, sine = math.cos(angle), math.sin(angle)
    for i in range(3):
        rotation[i, 0] = cosine * x[i] + sine * y[i]
        rotation[i, 1] = cosine * y[i] - sine * x[i]


@kernel()
def _is_rotation(r):
    """Whether the columns of (3, 3) are unit vectors at right angles; not where one is NaN."""
    for i in range(3):
        for j in range(i, 3):
            if not abs(dot(r[:, i], r[:, j]) - (1.0 if i == j else 0.0)) < _ROUNDING:
                return False
    return True


@kernel()
def quaternions(rotation, wxyz):
    """Unit quaternions (n, 4) of rotation matrices (n, 3, 3), w >= 0, by the largest divisor (Shepperd); NaN stays NaN."""
    for n in range(rotation.shape[0]):
        r = rotation[n]
        trace = r[0, 0] + r[1, 1] + r[2, 2]
        best = 0
        largest = trace
        for i in range(3):
            if 2.0 * r[i, i] - trace > largest:
                best, largest = i + 1, 2.0 * r[i, i] - trace
        if best == 0:
            wxyz[n, 0] = 1.0 + trace
            wxyz[n, 1], wxyz[n, 2], wxyz[n, 3] = r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]
        else:
            i = best - 1
            j, k = (i + 1) % 3, (i + 2) % 3
            wxyz[n, 0] = r[k, j] - r[j, k]
            wxyz[n, 1 + i] = 1.0 + 2.0 * r[i, i] - trace
            wxyz[n, 1 + j] = r[i, j] + r[j, i]
            wxyz[n, 1 + k] = r[i, k] + r[k, i]
        norm = math.sqrt(wxyz[n, 0] ** 2 + wxyz[n, 1] ** 2 + wxyz[n, 2] ** 2 + wxyz[n, 3] ** 2)
        sign = -1.0 if wxyz[n, 0] < 0.0 else 1.0
        for i in range(4):
            wxyz[n, i] *= sign / norm
