"""The pose of a flat patch from one view: two solutions, both kept until other views decide.

Method: Collins and Bartoli, "Infinitesimal plane-based pose estimation" (2014), in OpenCV.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from posefuse.calibration.solving.projection import Lenses
from posefuse.calibration.solving.rotations import Poses
from posefuse.core.arrays import Array

from .snapshots import Snapshots

_CLEAR_RATIO = 6.0
_LEAST_POINTS = 4


@dataclass(frozen=True, eq=False)
class PlanarViews:
    """One row per patch seen in an image.

    Attributes:
        camera, time step, patch: (D,).
        cam_from_patch: (D, 2), the better solution first; NaN where the second is ruled out by its error.
        error_norm: (D, 2) rms on the ideal image plane; inf where ruled out.
        rows: (D, 2) first and last + 1 row in the snapshots.
    """

    camera: Array
    time_step: Array
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
    error, middle = np.full((len(starts), 2), np.inf), np.zeros((len(starts), 3))
    finite, shapes = np.asarray(np.isfinite(norm).all(axis=1)), _Shapes(corners)
    for d, (first, end) in enumerate(zip(starts, ends, strict=True)):
        flat, middle[d] = shapes.of(int(seen.patch[first]), seen.corner[first:end])
        if flat is not None and finite[first:end].all():
            for h, (rotation, shift, off) in enumerate(_two_poses(flat, norm[first:end])):
                R[d, h], t[d, h], error[d, h] = rotation, shift, off
    t -= (R @ middle[:, None, :, None])[..., 0]
    clear = error[:, 1] > _CLEAR_RATIO * error[:, 0]
    R[clear, 1], t[clear, 1], error[clear, 1] = np.nan, np.nan, np.inf
    good = np.isfinite(error[:, 0])
    return PlanarViews(
        seen.camera[starts][good], seen.time_step[starts][good], seen.patch[starts][good], Poses(R[good], t[good]), error[good],
        np.stack([starts, ends], axis=1)[good],
    )  # fmt: skip


class _Shapes:
    """Corners about their middle, worked out once for every set of corners that is met; corners: (M, n, 3)."""

    def __init__(self, corners: Array) -> None:
        self._corners = corners
        self._known: dict[tuple[int, bytes], tuple[Array | None, Array]] = {}

    def of(self, patch: int, corner: Array) -> tuple[Array | None, Array]:
        """Corners (n, 3) of a patch about their middle, None where they lie on a line; and the middle (3,)."""
        key = patch, corner.tobytes()
        if key not in self._known:
            xyz = self._corners[patch, corner]
            middle = xyz.mean(axis=0)
            flat = xyz - middle
            on_line = np.linalg.matrix_rank(flat[:, :2], tol=1e-9) < 2
            self._known[key] = (None if on_line else flat), middle
        return self._known[key]


def _two_poses(flat: Array, norm: Array) -> list[tuple[Array, Array, float]]:
    """Rotation, shift of the middle and rms of the poses that put all corners in front of the camera, the better first."""
    count, rotations, shifts, errors = cv2.solvePnPGeneric(flat, norm, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
    poses = []
    for i in range(min(count, 2)):
        rotation, shift = cv2.Rodrigues(rotations[i])[0], shifts[i].ravel()
        # a pose that is not finite is not in front either
        if (flat @ rotation[2]).min() + shift[2] > 0:
            poses.append((rotation, shift, float(np.ravel(errors[i])[0])))
    return poses
