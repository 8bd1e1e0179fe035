"""The pose of a flat patch from one view: two solutions, both kept until other views decide.

Method: Collins and Bartoli, "Infinitesimal plane-based pose estimation" (2014), in OpenCV.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from posefuse.core.arrays import Array

from .projection import Lenses
from .rotations import Poses
from .snapshots import Snapshots

_CLEAR_RATIO = 6.0
_LEAST_POINTS = 4


@dataclass(frozen=True, eq=False)
class PlanarViews:
    """One row per patch seen in an image.

    Attributes:
        camera, instant, patch: (D,).
        cam_from_patch: (D, 2), the better solution first; NaN where the second is ruled out by its error.
        error_norm: (D, 2) rms on the ideal image plane; inf where ruled out.
        rows: (D, 2) first and last + 1 row in the snapshots.
    """

    camera: Array
    instant: Array
    patch: Array
    cam_from_patch: Poses
    error_norm: Array
    rows: Array


def planar_views(seen: Snapshots, corners: Array, lenses: Lenses) -> PlanarViews:
    """Both poses of every patch in every image; patches with fewer than 4 corners there are left out."""
    starts = seen.group_starts()
    ends = np.append(starts[1:], len(seen.group))
    big = ends - starts >= _LEAST_POINTS
    starts, ends = starts[big], ends[big]
    norm = lenses.norm_from_px(seen.camera, seen.xy_img)
    R, t = np.full((len(starts), 2, 3, 3), np.nan), np.full((len(starts), 2, 3), np.nan)
    error = np.full((len(starts), 2), np.inf)
    for d, (first, end) in enumerate(zip(starts, ends, strict=True)):
        xyz = corners[seen.patch[first], seen.corner[first:end]]
        for h, (rotation, shift, off) in enumerate(_two_poses(xyz, norm[first:end])):
            R[d, h], t[d, h], error[d, h] = rotation, shift, off
    clear = error[:, 1] > _CLEAR_RATIO * error[:, 0]
    R[clear, 1], t[clear, 1], error[clear, 1] = np.nan, np.nan, np.inf
    good = np.isfinite(error[:, 0])
    return PlanarViews(
        seen.camera[starts][good], seen.instant[starts][good], seen.patch[starts][good], Poses(R[good], t[good]), error[good],
        np.stack([starts, ends], axis=1)[good],
    )  # fmt: skip


def _two_poses(xyz: Array, norm: Array) -> list[tuple[Array, Array, float]]:
    if not np.isfinite(norm).all():
        return []
    flat = xyz - xyz.mean(axis=0)
    if np.linalg.matrix_rank(flat[:, :2], tol=1e-9) < 2:
        return []
    count, rotations, shifts, errors = cv2.solvePnPGeneric(flat, norm, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
    poses = []
    for i in range(min(count, 2)):
        rotation = cv2.Rodrigues(rotations[i])[0]
        shift = np.ravel(shifts[i]) - rotation @ xyz.mean(axis=0)
        if np.isfinite(rotation).all() and (flat @ rotation.T + np.ravel(shifts[i]))[:, 2].min() > 0:
            poses.append((rotation, shift, float(np.ravel(errors)[i])))
    return poses
