"""How well 3D poses explain detections, compiled: every pair of detections proposes a pose for every detection."""

from __future__ import annotations

import math

from posefuse.foundation.compiled import kernel


@kernel()
def agreement(rotation, translation, xy_norm, score, xyz, tolerance_m, mirror, swapped_share, support, share):
    """Support (H, D) and share of keypoints that agree (H, D) of every pose with every detection; both are filled.

    Args:
        rotation, translation: (D, 3, 3), (D, 3) cam_from_world. xy_norm: (D, K, 2) ideal points. score: (D, K), 0 missing.
        xyz: (H, K, 3) poses, NaN unknown. tolerance_m: (H,). mirror: (K,) left/right counterparts.
        swapped_share: support of a reading with left and right swapped counts this much of one as named.
    """
    for h in range(len(xyz)):
        for d in range(len(xy_norm)):
            support[h, d], share[h, d] = 0.0, 0.0
            for turn in range(2):
                gain, agree, both = 0.0, 0, 0
                for k in range(xyz.shape[1]):
                    # a pose read with left and right swapped
                    o = mirror[k] if turn == 1 else k
                    if not (score[d, k] > 0.0 and math.isfinite(xyz[h, o, 0])):
                        continue
                    both += 1
                    part = _gain(rotation[d], translation[d], xy_norm[d, k], xyz[h, o], tolerance_m[h])
                    if part > 0.0:
                        agree += 1
                        gain += part * score[d, k]
                if turn == 1:
                    gain *= swapped_share
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
