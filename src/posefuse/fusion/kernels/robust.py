"""Robust fusion of a group: one person at one time step, K keypoints seen by C cameras.

A view that is an outlier by its residual is not used (`USED`). Noise that is stated too small or too large is rescaled by the
residuals of the whole group. Where the views of a group contradict each other everywhere, the rig is taken to be wrong: no view
is then blamed, sigma grows until they agree.
"""

from __future__ import annotations

import math

import numpy as np

from .cameras import fast_kernel
from .point import invert, look, normal_system, refine, squared_depth, squared_residual
from .start import GATE, consensus, depth_point, linear_start

USED = 28.0  # weight (KNEE / s)^2 of 0.1: beyond it a view no longer counts as used
# squared residual of a linear start beyond which not all views show one point. It saves work: of eight cameras with three or four
# wrong, 44 and 114 views are looked at per point, else 90 and 294, for the same points
FAR = 20.0 * USED
PRIOR_DOF = 8.0  # how many residuals the stated sigma is worth when residuals contradict it
# squared ratio of seen to stated noise from which the stated sigma is taken as wrong. Four simulated cameras whose noise is
# stated five times too small: 9.5 mm and every point; as stated, 15.5 mm and a quarter of the points missing
RESCALE = 2.0
MIN_POINTS = 5  # of three or more views, to judge the stated sigma by
ATTEMPTS = 5  # chosen, not fitted
# chosen, not fitted: stated noise is taken as too large by a factor of 4 at most; without outliers, half or twice of it changes
# neither points nor, as `inflate` has a floor, their covariances. Stated three times too large, with a tenth of outliers, four
# cameras: 10.8 mm, and 13.3 mm if it is not lowered
MIN_SCALE = 0.25
# of 1.5 % of a body: a third of it, beyond which views do not show the same one, and the stated sigma counts. Three cameras, one
# of them wrong: 68 mm; if sigma grew to this and stayed, 291 mm
MAX_SCALE = 20.0


@fast_kernel()
def robust_point(cams, views, n, p, other, work, planes=None):
    """Minimum of the robust loss over n views into p; returns the loss, infinity when they define no point."""
    best = math.inf
    if planes is not None and n == 1:
        return refine(cams, views, n, p, work, planes) if depth_point(cams, views, 0, planes, p) else math.inf
    linear = linear_start(cams, views, n, p, work[0])
    # far from some views, the start is rarely near the minimum, and to refine it takes longest
    near = linear and (n == 2 or worst_residual(cams, views, n, p) < FAR)
    if near:
        best = refine(cams, views, n, p, work, planes)
        if worst_residual(cams, views, n, p) < GATE and (planes is None or worst_depth(cams, views, n, p, planes) < GATE):
            return best
    if n > 2 and consensus(cams, views, n, other, work[2]) < math.inf:
        found = refine(cams, views, n, other, work, planes)
        if linear and not near and 2 * agreeing(cams, views, n, other) < n:
            best = refine(cams, views, n, p, work, planes)
        if found < best:
            p[:] = other
            best = found
    elif linear and not near:
        best = refine(cams, views, n, p, work, planes)
    if planes is not None:
        for i in range(n):
            if not depth_point(cams, views, i, planes, other):
                continue
            found = refine(cams, views, n, other, work, planes)
            if found < best:
                p[:] = other
                best = found
    return best


@fast_kernel()
def worst_depth(cams, views, n, p, planes):
    """Largest squared residual of a point in the depths of n views."""
    worst = 0.0
    for i in range(n):
        worst = max(worst, squared_depth(cams, views, i, p, planes))
    return worst


@fast_kernel()
def worst_residual(cams, views, n, p):
    """Largest squared residual of a point in n views."""
    worst = 0.0
    for i in range(n):
        worst = max(worst, squared_residual(cams, views, i, p))
    return worst


@fast_kernel()
def agreeing(cams, views, n, p):
    """How many of n views a point fits."""
    count = 0
    for i in range(n):
        count += squared_residual(cams, views, i, p) < USED
    return count


@fast_kernel()
def gather_views(ideal, white, scale, k, views, depth=None, planes=None):
    """Usable views of keypoint k, and their depths (C, K, 2), into the first rows of `views`, `planes`; returns how many."""
    n = 0
    for c in range(len(ideal)):
        if look(ideal[c, k], white[c, k], scale, c, views, n):
            if depth is not None:
                known = depth[c, k, 0] > 0.0 and 0.0 < depth[c, k, 1] < math.inf
                planes[n, 0] = depth[c, k, 0] if known else 0.0
                planes[n, 1] = 1.0 / depth[c, k, 1] if known else 0.0
            n += 1
    return n


@fast_kernel()
def middle_residual(squares, n):
    """Middle one of n squared residuals (sorted in place), in units of what it is when the stated sigma is right.

    At least the third: any two rays nearly meet, so the two smallest carry little information. Unlike a sum it stays among the
    good views when half of eight are wrong.
    """
    for i in range(1, n):
        value = squares[i]
        j = i
        while j > 0 and squares[j - 1] > value:
            squares[j] = squares[j - 1]
            j -= 1
        squares[j] = value
    middle = max(3, (n + 1) // 2)
    return squares[middle - 1] / (-2.0 * math.log(1.0 - middle / (n + 1.0)) * (1.0 - 1.5 / n))


@fast_kernel()
def inflate(cov, chi2, dof, floor):
    """Scale covariances (K, 3, 3) by how much larger the residuals are than the stated sigma explains.

    Shrunk twice: the group's ratio towards 1 (and never below `floor`), each keypoint's towards its group's.
    """
    group = max(floor, (PRIOR_DOF + chi2.sum()) / (PRIOR_DOF + dof.sum()))
    for k in range(len(cov)):
        scale = (PRIOR_DOF * group + chi2[k]) / (PRIOR_DOF + dof[k])
        for i in range(3):
            for j in range(3):
                cov[k, i, j] *= scale


@fast_kernel()
def finish_robust(cams, views, n, p, work, cov, planes=None):
    """Covariance and figures of a robust point: (n_used, chi2, its degrees of freedom); n_used 0 when it is none.

    The views that are used are the first rows then. A single view defines a point only with depth, and only where no other
    view contradicts it.
    """
    used, chi2, depths = 0, 0.0, 0
    for i in range(n):
        s = squared_residual(cams, views, i, p)
        if s < USED:
            chi2 += s
            if planes is not None:
                far = squared_depth(cams, views, i, p, planes)
                if planes[i, 1] > 0.0 and far < USED:
                    chi2 += far
                    depths += 1
                planes[used, 0], planes[used, 1] = planes[i, 0], planes[i, 1]
            for j in range(7):
                views[used, j] = views[i, j]
            used += 1
    if used < 2 and not (n == 1 and depths == 1):
        return 0, 0.0, 0.0
    normal_system(cams, views, used, p, work[0], planes)
    if not invert(work[0], cov):
        return 0, 0.0, 0.0
    return used, chi2, 2.0 * used + depths - 3.0


@fast_kernel()
def has_rival(cams, views, n, p, rest, q, other, work):
    """Whether the views that p leaves out agree in at least the same number on another point q: then the answer is ambiguous."""
    left = 0
    for i in range(n):
        if not squared_residual(cams, views, i, p) < USED:
            for j in range(7):
                rest[left, j] = views[i, j]
            left += 1
    if left < 2 or 2 * left < n:
        return False
    # where all of them must agree, they do so near the point where all their rays meet
    if (
        2 * left == n
        and left > 2
        and not (linear_start(cams, rest, left, q, work[0]) and worst_residual(cams, rest, left, q) < FAR)
    ):
        return False
    if robust_point(cams, rest, left, q, other, work) == math.inf:
        return False
    agree = agreeing(cams, rest, left, q)
    return agree >= 2 and agree >= n - left


@fast_kernel()
def solve_robust(cams, ideal, white, xyz, cov, used, depth=None):
    """Robust fusion of groups: ideal points (G, C, K, 2) and their whitening (G, C, K, 2, 2), NaN where unusable.

    Filled in: xyz (G, K, 3), cov (G, K, 3, 3), and which views are used (G, C, K). Missing points are NaN, without a view, and
    so are those that have a rival: nothing decides which of the two is right.
    depth (G, C, K, 2): that of the keypoints and its standard deviation in m, NaN where unknown.
    """
    groups, count, keypoints = used.shape
    views, rest, work, q = np.empty((count, 7)), np.empty((count, 7)), np.empty((3, 9)), np.empty(3)
    pool, squares, p, other = np.empty(keypoints), np.empty(count), np.empty(3), np.empty(3)
    chi2, dof, rival = np.empty(keypoints), np.empty(keypoints), np.empty(keypoints, np.bool_)
    planes = None if depth is None else np.empty((count, 2))
    for g in range(groups):
        scale, attempt = 1.0, 0
        deep = None if depth is None else depth[g]
        while True:
            many = 0
            chi2[:], dof[:], rival[:] = 0.0, 0.0, False
            xyz[g], cov[g], used[g] = math.nan, math.nan, False
            for k in range(keypoints):
                n = gather_views(ideal[g], white[g], scale, k, views, deep, planes)
                least = 2 if planes is None else 1
                if n < least or robust_point(cams, views, n, p, other, work, planes) == math.inf:
                    continue
                if n > 2:
                    for i in range(n):
                        squares[i] = squared_residual(cams, views, i, p)
                    pool[many] = middle_residual(squares, n)
                    many += 1
                rival[k] = has_rival(cams, views, n, p, rest, q, other, work)
                n, chi2[k], dof[k] = finish_robust(cams, views, n, p, work, cov[g, k], planes)
                xyz[g, k] = p
                if n == 0:
                    xyz[g, k], cov[g, k] = math.nan, math.nan
                for i in range(n):
                    used[g, int(views[i, 6]), k] = True
            attempt += 1
            ratio = np.median(pool[:many]) if many >= MIN_POINTS else 1.0
            better = max(MIN_SCALE, scale * math.sqrt(ratio))
            if attempt > ATTEMPTS or 1.0 / RESCALE < ratio < RESCALE or better == scale:
                break
            if better < MAX_SCALE and attempt < ATTEMPTS:
                scale = better
            elif better >= MAX_SCALE and scale != 1.0:
                # no scale makes them agree: back to the stated sigma
                scale, attempt = 1.0, ATTEMPTS
            else:
                break
        inflate(cov[g], chi2, dof, 1.0 / (scale * scale))
        for k in range(keypoints):
            if rival[k]:
                xyz[g, k], cov[g, k], used[g, :, k] = math.nan, math.nan, False
