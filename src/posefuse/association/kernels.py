"""Compiled parts of association: where rays of several detections meet, and how well 3D poses explain detections."""

from __future__ import annotations

import math

import numpy as np

from posefuse.foundation.compiled import kernel

_PARALLEL = 1e-4  # squared sine of the angle between two rays that meet nowhere
_ROUNDS = 4


@kernel()
def pair_midpoints(direction, centre, score, pairs, middle, gap):
    """Midpoints (H, K, 3) and lengths (H, K) of common perpendiculars of the rays of pairs (H, 2); both are filled, NaN: none.

    Args:
        direction: (D, K, 3) unit rays. centre: (D, 3) where they start. score: (D, K), 0 missing.
    """
    for h in range(len(pairs)):
        a, b = pairs[h]
        for k in range(direction.shape[1]):
            middle[h, k], gap[h, k] = np.nan, np.nan
            if not (score[a, k] > 0.0 and score[b, k] > 0.0):
                continue
            cosine, along_a, along_b = 0.0, 0.0, 0.0
            for i in range(3):
                base = centre[b, i] - centre[a, i]
                cosine += direction[a, k, i] * direction[b, k, i]
                along_a += base * direction[a, k, i]
                along_b += base * direction[b, k, i]
            sine2 = 1.0 - cosine * cosine
            if not sine2 > _PARALLEL:
                continue
            s, t = (along_a - cosine * along_b) / sine2, (cosine * along_a - along_b) / sine2
            if not (s > 0.0 and t > 0.0):
                continue
            square = 0.0
            for i in range(3):
                end_a, end_b = centre[a, i] + s * direction[a, k, i], centre[b, i] + t * direction[b, k, i]
                middle[h, k, i] = (end_a + end_b) / 2.0
                square += (end_a - end_b) ** 2
            gap[h, k] = math.sqrt(square)


@kernel()
def joint_points(direction, centre, score, members, tolerance_m, xyz):
    """Points (K, 3) nearest to the rays of detections `members` (M,), filled; NaN where fewer than two see the keypoint.

    Least squares on the distances to the rays, weighted by squared score, re-weighted (Cauchy at a third of the tolerance).
    """
    count = len(members)
    weight, robust = np.empty(count), np.empty(count)
    information, target = np.empty((3, 3)), np.empty(3)
    for k in range(direction.shape[1]):
        xyz[k] = np.nan
        seen = 0
        for m in range(count):
            weight[m] = score[members[m], k] ** 2
            robust[m] = weight[m]
            seen += weight[m] > 0.0
        if seen < 2:
            continue
        for _ in range(_ROUNDS):
            information[:], target[:] = 0.0, 0.0
            for m in range(count):
                if robust[m] > 0.0:
                    _add(information, target, direction[members[m], k], centre[members[m]], robust[m])
            _solve(information, target, xyz[k])
            for m in range(count):
                if weight[m] > 0.0:
                    miss = _miss(direction[members[m], k], centre[members[m]], xyz[k])
                    robust[m] = weight[m] / (1.0 + (3.0 * miss / tolerance_m) ** 2)


@kernel()
def _add(information, target, d, c, weight):
    """The equations of one ray: (I - d d') x = (I - d d') c."""
    along = d[0] * c[0] + d[1] * c[1] + d[2] * c[2]
    for i in range(3):
        for j in range(3):
            information[i, j] += weight * ((1.0 if i == j else 0.0) - d[i] * d[j])
        target[i] += weight * (c[i] - along * d[i])


@kernel()
def _miss(d, c, x):
    along = 0.0
    for i in range(3):
        along += (x[i] - c[i]) * d[i]
    square = 0.0
    for i in range(3):
        square += (x[i] - c[i] - along * d[i]) ** 2
    return math.sqrt(square)


@kernel()
def _solve(a, b, x):
    """a x = b for a symmetric (3, 3), made a little stiffer: parallel rays leave one direction open."""
    a00, a11, a22 = a[0, 0] + 1e-9, a[1, 1] + 1e-9, a[2, 2] + 1e-9
    a01, a02, a12 = a[0, 1], a[0, 2], a[1, 2]
    c00, c01, c02 = a11 * a22 - a12 * a12, a02 * a12 - a01 * a22, a01 * a12 - a02 * a11
    c11, c12, c22 = a00 * a22 - a02 * a02, a01 * a02 - a00 * a12, a00 * a11 - a01 * a01
    determinant = a00 * c00 + a01 * c01 + a02 * c02
    x[0] = (c00 * b[0] + c01 * b[1] + c02 * b[2]) / determinant
    x[1] = (c01 * b[0] + c11 * b[1] + c12 * b[2]) / determinant
    x[2] = (c02 * b[0] + c12 * b[1] + c22 * b[2]) / determinant


@kernel()
def agreement(rotation, translation, xy_norm, score, xyz, tolerance_m, mirror, turned_share, support, share):
    """Support (H, D) and share of keypoints that agree (H, D) of every pose with every detection; both are filled.

    Args:
        rotation, translation: (D, 3, 3), (D, 3) cam_from_world. xy_norm: (D, K, 2) ideal points. score: (D, K), 0 missing.
        xyz: (H, K, 3) poses, NaN unknown. tolerance_m: (H,). mirror: (K,) left/right counterparts.
        turned_share: support of a reading with left and right exchanged counts this much of one as named.
    """
    for h in range(len(xyz)):
        for d in range(len(xy_norm)):
            support[h, d], share[h, d] = 0.0, 0.0
            for turn in range(2):
                gain, agree, both = 0.0, 0, 0
                for k in range(xyz.shape[1]):
                    # a pose read with left and right exchanged
                    o = mirror[k] if turn == 1 else k
                    if not (score[d, k] > 0.0 and math.isfinite(xyz[h, o, 0])):
                        continue
                    both += 1
                    part = _gain(rotation[d], translation[d], xy_norm[d, k], xyz[h, o], tolerance_m[h])
                    if part > 0.0:
                        agree += 1
                        gain += part * score[d, k]
                if turn == 1:
                    gain *= turned_share
                if gain > support[h, d]:
                    support[h, d], share[h, d] = gain, agree / both


@kernel()
def _gain(rotation, translation, xy, point, tolerance_m):
    """1 less the squared miss over the tolerance, measured at the depth of the point; negative or 0 where it does not agree."""
    x = rotation[0, 0] * point[0] + rotation[0, 1] * point[1] + rotation[0, 2] * point[2] + translation[0]
    y = rotation[1, 0] * point[0] + rotation[1, 1] * point[1] + rotation[1, 2] * point[2] + translation[1]
    z = rotation[2, 0] * point[0] + rotation[2, 1] * point[1] + rotation[2, 2] * point[2] + translation[2]
    if not z > 0.0:
        return 0.0
    return 1.0 - ((x - xy[0] * z) ** 2 + (y - xy[1] * z) ** 2) / (tolerance_m * tolerance_m)
