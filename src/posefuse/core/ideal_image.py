"""The real lens: an ideal image that covers the field of view of the lens, and the map that distorts it.

OpenGL draws ideal pinhole images only. A `SourceView` is such an image in the plane x/z, y/z of the camera; every
pixel of the wanted image is looked up in it at `Camera.norm_from_px` of its centre. Pixel centres are at integers, so a
image of w px covers -0.5 ... w - 0.5.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .arrays import Array
from .camera import Camera
from .errors import ConfigError

_WIDEST_DEG = 78.0
_LARGEST_PX = 4096
_MARGIN_PX = 2
_MOST_MAGNIFIED = 2.0
_SQUARE = 1e-9


@dataclass(frozen=True)
class SourceView:
    """An ideal image with square pixels.

    Attributes:
        left, top: x/z and y/z of its outer top left corner. step: x/z from one pixel to the next.
        width, height: in px.
    """

    left: float
    top: float
    step: float
    width: int
    height: int

    def px_from_norm(self, xy_norm: Array) -> Array:
        """Pixels (..., 2) of this image, centres at integers, of x/z, y/z (..., 2)."""
        return np.asarray((xy_norm - [self.left, self.top]) / self.step - 0.5)

    def cut(self, column: int, row: int, width: int, height: int) -> SourceView:
        """The part of it that begins at pixel (column, row)."""
        return SourceView(self.left + column * self.step, self.top + row * self.step, self.step, width, height)


@dataclass(frozen=True, eq=False)
class IdealOptics:
    """How a camera's image is made from an ideal image.

    Attributes:
        view: the ideal image.
        map_px: (H, W, 2) float32 place of every image pixel in it, NaN where the lens shows nothing; None: they are equal.
    """

    view: SourceView
    map_px: Array | None


def optics_of(camera: Camera) -> IdealOptics:
    """Source image and map; raises ConfigError when the lens sees further aside than can be rendered."""
    width, height = camera.size_wh
    fx, fy, skew = camera.K[0, 0], camera.K[1, 1], camera.K[0, 1]
    if not camera.distortion.any() and camera.model == "pinhole" and abs(fx - fy) < _SQUARE * fx and skew == 0:
        view = SourceView((-0.5 - camera.K[0, 2]) / fx, (-0.5 - camera.K[1, 2]) / fx, 1 / fx, width, height)
        return IdealOptics(view, None)
    columns, rows = np.meshgrid(np.arange(width), np.arange(height))
    norm = camera.norm_from_px(np.stack([columns, rows], axis=-1))
    seen = np.isfinite(norm).all(axis=-1)
    if not seen.any():
        raise ConfigError(f"camera {camera.name}: the lens model has no inverse anywhere in the image; check distortion and K")
    low, high = norm[seen].min(axis=0), norm[seen].max(axis=0)
    widest_deg = np.rad2deg(np.arctan(np.abs([low, high]).max()))
    if widest_deg > _WIDEST_DEG:
        raise ConfigError(
            f"camera {camera.name}: its lens sees {widest_deg:.0f} deg off the optical axis; the simulator renders up to "
            f"{_WIDEST_DEG:.0f} deg: use a longer focal length, a smaller image, or less distortion"
        )
    step = _finest_step(norm, max(fx, fy))
    step = max(step, float((high - low).max()) / (_LARGEST_PX - 2 * _MARGIN_PX - 1))
    size = np.ceil((high - low) / step).astype(int) + 1 + 2 * _MARGIN_PX
    # never of the image's own size, so that no person takes one for the other
    size[0] += tuple(size) == camera.size_wh
    first = low - (_MARGIN_PX + 0.5) * step
    view = SourceView(float(first[0]), float(first[1]), step, int(size[0]), int(size[1]))
    return IdealOptics(view, view.px_from_norm(norm).astype(np.float32))


def has_lens(camera: Camera) -> bool:
    """Whether its images differ from those of a pinhole camera of straight axes."""
    return bool(camera.distortion.any()) or camera.model != "pinhole" or bool(camera.K[0, 1] != 0)


def drawn_camera(camera: Camera) -> Camera:
    """The camera that a renderer without lenses is asked to draw for `camera`: the same one where it has no lens to speak of,
    else a pinhole camera, of another image size, whose image is the ideal image.

    Raises:
        ConfigError: see `optics_of`.
    """
    if not has_lens(camera):
        return replace(camera, distortion=np.zeros(0), readout_s=0.0)
    view = optics_of(camera).view
    K = np.array([[1 / view.step, 0, -view.left / view.step - 0.5], [0, 1 / view.step, -view.top / view.step - 0.5], [0, 0, 1]])
    size = (view.width, view.height)
    return Camera(name=camera.name, size_wh=size, K=K, cam_from_world=camera.cam_from_world, distortion=np.zeros(0))


def _finest_step(norm: Array, focal_px: float) -> float:
    """Step of x/z at which the source is nowhere coarser than the image, within reason."""
    steps = np.concatenate([np.abs(np.diff(norm[..., 0], axis=1)).ravel(), np.abs(np.diff(norm[..., 1], axis=0)).ravel()])
    finest = float(np.nanmin(np.where(steps > 0, steps, np.nan)))
    return max(finest, 1 / (focal_px * _MOST_MAGNIFIED))
