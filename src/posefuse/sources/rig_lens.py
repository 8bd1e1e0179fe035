"""The lens of a rig's camera, applied to ideal images: simulators draw pinhole images only."""

from __future__ import annotations

import cv2
import numpy as np

from posefuse.core import Camera, SourceError
from posefuse.core.arrays import Array
from posefuse.core.ideal_image import drawn_camera, optics_of

# a simulator counts pixels from the edge of the image, not from the first one's centre: cx and cy half a pixel more
_CENTRE_PX, _FOCAL = 0.6, 1e-3


class RigLens:
    """What turns the images of `drawn_camera(camera)` into those of `camera`.

    Raises:
        ConfigError: the lens sees further aside than an ideal image can show.
    """

    def __init__(self, camera: Camera) -> None:
        self.camera = camera
        self.ideal_wh = drawn_camera(camera).size_wh
        map_px = optics_of(camera).map_px
        # outside what the lens shows the map is NaN, which is drawn black
        self._map_px = None if map_px is None else np.nan_to_num(map_px, nan=-10.0)

    def __call__(self, image: Array) -> Array:
        """The camera's image (H, W, 3) of an ideal one; one that has the camera's size already is the camera's.

        Raises:
            SourceError: it has neither size.
        """
        size = (image.shape[1], image.shape[0])
        if size == self.camera.size_wh:
            return image
        if size != self.ideal_wh or self._map_px is None:
            ideal = "" if self._map_px is None else f", or {_size(self.ideal_wh)} of an ideal camera"
            name, own = self.camera.name, _size(self.camera.size_wh)
            raise SourceError(f"camera {name}: expected images of {own} px{ideal}, got {_size(size)}")
        return np.asarray(cv2.remap(image, self._map_px[..., 0], self._map_px[..., 1], cv2.INTER_LINEAR))


def is_ideal_image_of(camera: Camera, other: Camera) -> bool:
    """Whether `other`, as a simulator states it, draws the ideal image of `camera`."""
    drawn = drawn_camera(camera)
    if other.size_wh != drawn.size_wh or other.distortion.any():
        return False
    focal_agrees = np.allclose(other.K[[0, 1], [0, 1]], drawn.K[[0, 1], [0, 1]], rtol=_FOCAL)
    return bool(focal_agrees and np.abs(other.K[:2, 2] - drawn.K[:2, 2]).max() < _CENTRE_PX)


def _size(size_wh: tuple[int, int]) -> str:
    return "{}x{}".format(*size_wh)
