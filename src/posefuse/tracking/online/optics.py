"""A camera's view as rays: ideal image points with their noise, the times of their rows, and depths."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from posefuse.core import Camera, Detections2D
from posefuse.core.arrays import Array
from posefuse.core.depth import keypoint_depth

from .kernels.state import KeypointRays

# keypoints may lie that far outside the image, as a share of its size
_MARGIN = 0.3
# ideal points (P, K, 2) of a view, what turns their errors into standard deviations (P, K, 2, 2), NaN where a keypoint cannot be
# used, and its standard deviation in px (P, K)
Whitened = Callable[[Detections2D], tuple[Array, Array, Array]]


def rays_of(view: Detections2D, camera: Camera, c: int, whitened: Whitened) -> tuple[KeypointRays, Array | None]:
    """Every keypoint (P, K, ...) that can be used, in a view of number c of the rig.

    Returns:
        The rays, and (P, K, 2) depth of the keypoints and its standard deviation, NaN where unknown; None where nothing is.
    """
    ideal, white, sigma = whitened(view)
    at = view.xy_img.astype(np.float64) / camera.size_wh
    usable = np.isfinite(white[..., 0, 0]) & (np.abs(at - 0.5) <= 0.5 + _MARGIN).all(axis=-1)
    z = np.where(usable[..., None], ideal, np.nan)
    row = view.xy_img[..., 1].astype(np.float64) / max(camera.size_wh[1] - 1, 1)
    return KeypointRays(c, z, white, camera.readout_s * (np.clip(row, 0, 1) - 0.5), sigma), _depth(view, z)


def _depth(detections: Detections2D, z: Array) -> Array | None:
    if detections.depth_m is None or not np.isfinite(detections.depth_m).any():
        return None
    depth = keypoint_depth(detections.depth_m, z, detections.skeleton)
    # the kernels ask for a sigma > 0 only
    depth[..., 1] = np.where(np.isfinite(depth).all(axis=-1), depth[..., 1], np.nan)
    return np.ascontiguousarray(depth)
