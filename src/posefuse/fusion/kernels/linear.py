"""Weighted least squares of a group with weights that are given, as the paper has it; one linear solve per point."""

from __future__ import annotations

import math

import numpy as np

from .lens import FX, FY, R20, R21, R22, SKEW, TZ, fast_kernel, straighten_group
from .point import invert, look, solve3, squared_px
from .robust import inflate
from .start import add_row, depth_rows


@fast_kernel()
def linear_point(cams, views, weights, n, p, work, cov):
    """Weighted least squares of the paper's rows (u m3 - m1), (v m3 - m2) in undistorted px into p.

    Its covariance, by error propagation of the pixel noise, into cov. Returns the sum of squared whitened residuals and
    what it is expected to be: 2n - 3 for the best weights, more for others. NaN when the rays define no point.
    """
    system, spread, best = work[0], work[1], work[2]
    for i in range(9):
        system[i] = spread[i] = best[i] = 0.0
    for i in range(n):
        a0, a1, a2, a3, b0, b1, b2, b3 = depth_rows(cams, views, i)
        c = int(views[i, 6])
        fx, skew, fy = cams[c, FX], cams[c, SKEW], cams[c, FY]
        w = weights[i]
        add_row(system, w, fx * a0 + skew * b0, fx * a1 + skew * b1, fx * a2 + skew * b2, fx * a3 + skew * b3)
        add_row(system, w, fy * b0, fy * b1, fy * b2, fy * b3)
    if not (solve3(system, 0.0, p) and invert(system, cov)):
        return math.nan, math.nan
    total = 0.0
    for i in range(n):
        a0, a1, a2, a3, b0, b1, b2, b3 = depth_rows(cams, views, i)
        c = int(views[i, 6])
        fx, skew, fy = cams[c, FX], cams[c, SKEW], cams[c, FY]
        w0, w1, w2, w3 = views[i, 2], views[i, 3], views[i, 4], views[i, 5]
        depth = cams[c, R20] * p[0] + cams[c, R21] * p[1] + cams[c, R22] * p[2] + cams[c, TZ]
        if not depth > 1e-6:
            return math.nan, math.nan
        iz = 1.0 / depth
        rx, ry = (a0 * p[0] + a1 * p[1] + a2 * p[2] + a3) * iz, (b0 * p[0] + b1 * p[1] + b2 * p[2] + b3) * iz
        total += (w0 * rx + w1 * ry) ** 2 + (w2 * rx + w3 * ry) ** 2
        add_row(best, 1.0, (w0 * a0 + w1 * b0) * iz, (w0 * a1 + w1 * b1) * iz, (w0 * a2 + w1 * b2) * iz, 0.0)
        add_row(best, 1.0, (w2 * a0 + w3 * b0) * iz, (w2 * a1 + w3 * b1) * iz, (w2 * a2 + w3 * b2) * iz, 0.0)
        # noise of the two rows: depth * K J^-1 * sigma, the inverse of the whitening matrix
        gain = weights[i] * depth / (w0 * w3 - w1 * w2)
        n0, n1 = (fx * w3 - skew * w2) * gain, (skew * w0 - fx * w1) * gain
        n2, n3 = -fy * w2 * gain, fy * w0 * gain
        u0, u1, u2 = fx * a0 + skew * b0, fx * a1 + skew * b1, fx * a2 + skew * b2
        add_row(spread, 1.0, u0 * n0 + fy * b0 * n2, u1 * n0 + fy * b1 * n2, u2 * n0 + fy * b2 * n2, 0.0)
        add_row(spread, 1.0, u0 * n1 + fy * b0 * n3, u1 * n1 + fy * b1 * n3, u2 * n1 + fy * b2 * n3, 0.0)
    return total, 2.0 * n - 6.0 + _sandwich(cov, spread, best)


@fast_kernel()
def _sandwich(cov, spread, information):
    """cov <- cov spread cov, the middle as six upper entries; returns the trace of information times that."""
    c00, c01, c02, c11, c12, c22 = cov[0, 0], cov[0, 1], cov[0, 2], cov[1, 1], cov[1, 2], cov[2, 2]
    for i in range(3):
        c0, c1, c2 = (c00, c01, c02) if i == 0 else ((c01, c11, c12) if i == 1 else (c02, c12, c22))
        h0 = c0 * spread[0] + c1 * spread[1] + c2 * spread[2]
        h1 = c0 * spread[1] + c1 * spread[3] + c2 * spread[4]
        h2 = c0 * spread[2] + c1 * spread[4] + c2 * spread[5]
        cov[i, 0] = h0 * c00 + h1 * c01 + h2 * c02
        cov[i, 1] = h0 * c01 + h1 * c11 + h2 * c12
        cov[i, 2] = h0 * c02 + h1 * c12 + h2 * c22
    diagonal = information[0] * cov[0, 0] + information[3] * cov[1, 1] + information[5] * cov[2, 2]
    return diagonal + 2.0 * (information[1] * cov[0, 1] + information[2] * cov[0, 2] + information[4] * cov[1, 2])


@fast_kernel()
def solve_linear(cams, xy_img, sigma, weight, xyz, cov, reproj, n_views):
    """Paper's weighted least squares of groups: weight (G, C, K), 0 leaves a view out; the rest as in `solve_robust`."""
    groups, count, keypoints = sigma.shape
    views, work, weights = np.empty((count, 7)), np.empty((3, 9)), np.empty(count)
    chi2, dof = np.empty(keypoints), np.empty(keypoints)
    ideal, last, p = np.empty((count, 6, keypoints)), np.empty(keypoints), np.empty(3)
    for g in range(groups):
        straighten_group(cams, xy_img[g], ideal, last)
        chi2[:], dof[:] = 0.0, 0.0
        xyz[g], cov[g], reproj[g], n_views[g] = math.nan, math.nan, math.nan, 0
        for k in range(keypoints):
            n = 0
            for c in range(count):
                if weight[g, c, k] > 0.0 and look(cams, c, ideal, k, sigma[g, c, k], views, n):
                    weights[n] = weight[g, c, k]
                    n += 1
            if n < 2:
                continue
            total, expected = linear_point(cams, views, weights, n, p, work, cov[g, k])
            if not math.isfinite(total):
                cov[g, k] = math.nan
                continue
            px2 = 0.0
            for i in range(n):
                c = int(views[i, 6])
                px2 += squared_px(cams, c, xy_img[g, c, k, 0], xy_img[g, c, k, 1], p)
            xyz[g, k, 0], xyz[g, k, 1], xyz[g, k, 2] = p[0], p[1], p[2]
            reproj[g, k], n_views[g, k] = math.sqrt(px2 / n), n
            chi2[k], dof[k] = total, expected
        inflate(cov[g], chi2, dof, 1.0)
