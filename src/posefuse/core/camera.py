"""One calibrated camera: world points to raw pixels and raw pixels to rays."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from . import lens
from .arrays import Array, FrozenArrays, frozen
from .errors import CalibrationError
from .se3 import SE3

LENS_MODELS = ("pinhole", "fisheye")
# far above what the inverse of a lens is exact to, far below any two rays that share a pixel
_SAME_RAY_NORM = 1e-4


@dataclass(frozen=True, eq=False, kw_only=True)
class Camera(FrozenArrays):
    """Intrinsics, lens and pose of one camera. OpenCV optical axes: x right, y down, z forward; pixel centres at integers.

    Attributes:
        name: unique within its rig.
        size_wh: (width, height) in px of the images the intrinsics belong to.
        K: (3, 3) intrinsic matrix in px; skew is allowed.
        cam_from_world: pose, metres.
        distortion: 0, 4, 5, 8, 12 or 14 coefficients in OpenCV's order (always 4 for ``fisheye``); see `core.lens`.
        model: ``pinhole`` or ``fisheye``.
        readout_s: rolling-shutter time from first to last row in seconds; 0 is a global shutter.

    Raises:
        CalibrationError: anything above that does not hold, naming the camera.
    """

    name: str
    size_wh: tuple[int, int]
    K: Array
    cam_from_world: SE3
    distortion: Array = field(default_factory=lambda: np.zeros(0))
    model: str = "pinhole"
    readout_s: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "size_wh", (int(self.size_wh[0]), int(self.size_wh[1])))
        object.__setattr__(self, "K", frozen(self.K, np.float64, f"camera {self.name}: K"))
        object.__setattr__(self, "distortion", frozen(self.distortion, np.float64, f"camera {self.name}: distortion"))
        problem = self._problem()
        if problem:
            raise CalibrationError(f"camera {self.name}: {problem}")

    def __repr__(self) -> str:
        return f"Camera({self.name}, {self.size_wh[0]}x{self.size_wh[1]} px, {self.model})"

    def _problem(self) -> str | None:
        if not self.name:
            return "expected a name, got an empty one"
        if min(self.size_wh) < 1:
            return f"expected an image size of at least 1x1 px, got {self.size_wh[0]}x{self.size_wh[1]}"
        if self.K.shape != (3, 3) or not np.isfinite(self.K).all():
            return f"K: expected a finite 3x3 matrix, got {self.K.tolist()}"
        if self.K[0, 0] <= 0 or self.K[1, 1] <= 0 or not np.allclose(self.K[[1, 2, 2, 2], [0, 0, 1, 2]], [0, 0, 0, 1]):
            return f"K: expected [[fx, s, cx], [0, fy, cy], [0, 0, 1]] with fx, fy > 0, got {self.K.tolist()}"
        if self.model not in LENS_MODELS:
            return f"lens model: expected one of {', '.join(LENS_MODELS)}, got {self.model!r}"
        counts = (lens.FISHEYE_COUNT,) if self.model == "fisheye" else lens.PINHOLE_COUNTS
        if self.distortion.ndim != 1 or len(self.distortion) not in counts:
            return f"distortion ({self.model}): expected {', '.join(map(str, counts))} coefficients, got {self.distortion.size}"
        if not np.isfinite(self.distortion).all():
            return "distortion: expected finite coefficients, got NaN or infinity"
        pose = self.cam_from_world
        if pose.batch != () or not (np.isfinite(pose.wxyz).all() and np.isfinite(pose.xyz).all()):
            return "pose: expected one finite transform, got NaN or several"
        if not (np.isfinite(self.readout_s) and self.readout_s >= 0):
            return f"readout_s: expected >= 0 s, got {self.readout_s}"
        return None

    @cached_property
    def centre_world(self) -> Array:
        """(3,) optical centre in world metres."""
        return self.cam_from_world.inverse().xyz

    def projection(self) -> Array:
        """(3, 4) matrix K [R | t] from world metres to undistorted homogeneous px."""
        return np.asarray(self.K @ self.cam_from_world.matrix4()[:3])

    def project(self, xyz_world: Any) -> Array:
        """Raw (distorted) pixels (..., 2) of world points (..., 3); NaN behind the camera."""
        xyz_cam = self.cam_from_world @ np.asarray(xyz_world, np.float64)
        depth = np.where(xyz_cam[..., 2:] > 0, xyz_cam[..., 2:], np.nan)
        return self.px_from_norm(xyz_cam[..., :2] / depth)

    def sees(self, xyz_world: Any) -> Array:
        """Whether world points (..., 3) lie in the image (...): on the ray of the pixel that `project` gives; False for NaN.

        Lens models bend rays from far outside the image back into it.
        """
        xy_img = self.project(xyz_world)
        inside = np.asarray((xy_img >= -0.5).all(axis=-1) & (xy_img < np.array(self.size_wh) - 0.5).all(axis=-1))
        if not self.distortion.any() and self.model == "pinhole":
            return inside
        xyz_cam = self.cam_from_world @ np.asarray(xyz_world, np.float64)[inside]
        off_norm = self.norm_from_px(xy_img[inside]) - xyz_cam[..., :2] / xyz_cam[..., 2:]
        inside[inside] = (np.abs(off_norm) < _SAME_RAY_NORM).all(axis=-1)
        return inside

    def depth(self, xyz_world: Any) -> Array:
        """Distance (...) along the optical axis in metres; negative behind the camera."""
        return np.asarray((self.cam_from_world @ np.asarray(xyz_world, np.float64))[..., 2])

    def px_from_norm(self, xy_norm: Any) -> Array:
        """Raw pixels (..., 2) of ideal image-plane points x/z, y/z (..., 2)."""
        bent = lens.distort(np.asarray(xy_norm, np.float64), self.distortion, self.model)
        return np.asarray(bent @ self.K[:2, :2].T + self.K[:2, 2])

    def norm_from_px(self, xy_img: Any) -> Array:
        """Ideal image-plane points (..., 2) of raw pixels (..., 2): exact inverse; NaN where the lens has none."""
        centred = np.asarray(xy_img, np.float64) - self.K[:2, 2]
        bent = centred @ np.linalg.inv(self.K[:2, :2]).T
        return np.asarray(lens.undistort(bent, self.distortion, self.model))

    def undistort(self, xy_img: Any) -> Array:
        """Pixels (..., 2) an ideal pinhole camera with the same K would have seen."""
        return np.asarray(self.norm_from_px(xy_img) @ self.K[:2, :2].T + self.K[:2, 2])

    def rays_world(self, xy_img: Any) -> Array:
        """Unit directions (..., 3) in world axes through raw pixels (..., 2); they start at `centre_world`."""
        xy = self.norm_from_px(xy_img)
        xyz_cam = np.concatenate([xy, np.ones_like(xy[..., :1])], axis=-1)
        directions = xyz_cam @ self.cam_from_world.matrix()
        return np.asarray(directions / np.linalg.norm(directions, axis=-1, keepdims=True))

    def cropped(self, left_px: float, top_px: float, size_wh: tuple[int, int]) -> Camera:
        """The same camera seen through a cut-out whose first pixel is (left_px, top_px)."""
        shifted = self.K.copy()
        shifted[:2, 2] -= [left_px, top_px]
        return replace(self, K=shifted, size_wh=size_wh)

    def scaled(self, size_wh: tuple[int, int]) -> Camera:
        """The same camera with its whole image resampled to `size_wh`; corners stay corners, not pixel centres."""
        sx, sy = size_wh[0] / self.size_wh[0], size_wh[1] / self.size_wh[1]
        resampled = self.K.copy()
        resampled[0, :2] *= sx
        resampled[1, 1] *= sy
        resampled[0, 2] = (self.K[0, 2] + 0.5) * sx - 0.5
        resampled[1, 2] = (self.K[1, 2] + 0.5) * sy - 0.5
        return replace(self, K=resampled, size_wh=size_wh)
