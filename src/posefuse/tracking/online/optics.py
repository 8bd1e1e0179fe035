"""A camera's view as rays: raw pixels to ideal image points with their noise, fast enough for every frame."""

from __future__ import annotations

import numpy as np

from posefuse.core import Camera, Detections2D
from posefuse.core.arrays import Array
from posefuse.core.depth import keypoint_depth
from posefuse.tracking.settings import LiveMotion

from .kernels.rays import measure
from .kernels.state import KeypointRays

# of the table of ideal points: between its knots a lens bends by less than a few hundredths of a pixel
_SPACING_PX = 6.0
# keypoints may lie that far outside the image, as a share of its size
_MARGIN = 0.3
# chosen, not fitted: a stated sigma near 0 would let one view outweigh all others; networks err by 1 px or more
_LEAST_SIGMA_PX = 0.3


class Optics:
    """One camera, number c of the rig, with its lens as a table."""

    def __init__(self, camera: Camera, c: int, motion: LiveMotion) -> None:
        width, height = camera.size_wh
        self._corner = np.array([-_MARGIN * width, -_MARGIN * height])
        columns, rows = (int(np.ceil(size * (1 + 2 * _MARGIN) / _SPACING_PX)) + 2 for size in (width, height))
        at = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1) * _SPACING_PX + self._corner
        self._table = np.ascontiguousarray(camera.norm_from_px(at))
        self._readout_s, self._rows = camera.readout_s, max(height - 1, 1)
        self._c, self._motion = c, motion

    def rays(self, detections: Detections2D) -> tuple[KeypointRays, Array | None]:
        """Every keypoint (P, K, ...) that can be used: scored, finite, where the lens can be inverted.

        Returns:
            The rays, and (P, K, 2) depth of the keypoints and its standard deviation, NaN where unknown; None where nothing is.
        """
        xy = detections.xy_img.astype(np.float64)
        sigma = self._sigma_px(xy, detections.score, detections.sigma_px.astype(np.float64))
        z, white = np.empty(xy.shape), np.empty((*xy.shape, 2))
        measure(self._table, self._corner, _SPACING_PX, xy, sigma, z, white)
        late = self._readout_s * (np.clip(xy[..., 1] / self._rows, 0, 1) - 0.5) if self._readout_s else np.zeros(sigma.shape)
        return KeypointRays(self._c, z, white, late, sigma), _depth(detections, z)

    def _sigma_px(self, xy: Array, score: Array, sigma: Array) -> Array:
        """NaN where unusable; where the network states none, from the body's extent and the score."""
        usable = score >= self._motion.score_min
        missing = usable & ~(sigma > 0)
        if missing.any():
            seen = np.isfinite(xy)
            extent = np.where(seen, xy, -np.inf).max(axis=1) - np.where(seen, xy, np.inf).min(axis=1)
            full = np.maximum(self._motion.sigma_share * extent.max(axis=-1), 1.0)
            sigma = np.where(missing, full[:, None] / np.maximum(score, 1e-3), sigma)
        return np.where(usable, np.maximum(sigma, _LEAST_SIGMA_PX), np.nan)


def _depth(detections: Detections2D, z: Array) -> Array | None:
    if detections.depth_m is None or not np.isfinite(detections.depth_m).any():
        return None
    depth = keypoint_depth(detections.depth_m, z, detections.skeleton)
    # the kernels ask for a sigma > 0 only
    depth[..., 1] = np.where(np.isfinite(depth).all(axis=-1), depth[..., 1], np.nan)
    return np.ascontiguousarray(depth)
