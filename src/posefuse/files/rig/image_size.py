"""A video whose size is not the calibrated one: cut out of it, or resampled?"""

from __future__ import annotations

import numpy as np

from posefuse.core import CalibrationError, Camera
from posefuse.core.arrays import Array

# black bars in compressed video are not quite 0
_BLACK = 16.0
_ROUNDING_PX = 1.0


def fit_camera_to_video(
    camera: Camera,
    size_wh: tuple[int, int],
    *,
    crop: tuple[float, float] | None = None,
    scale: bool = False,
    image: Array | None = None,
) -> Camera:
    """The camera as it applies to images of `size_wh` px.

    Equal sizes need nothing. What is stated is done. Otherwise the one reading the data allow is taken:

    - both sides in the same proportion, within a pixel of rounding: the image was resampled;
    - black bars in `image`, and what lies between them has the calibrated proportions: resampled, then padded (the
      usual letterbox of a player or converter);
    - anything else may be a cut-out from anywhere: it must be stated.

    Args:
        camera: as calibrated.
        size_wh: (width, height) of the video.
        crop: stated: (left, top) px of the cut-out in the calibrated image.
        scale: stated: the calibrated image was resampled to `size_wh`.
        image: (H, W, 3) uint8, an image of the video (better: the brightest value of each pixel over several), the
            evidence for bars.

    Raises:
        CalibrationError: no reading, or a statement that cannot be; says both sizes and how to state what was done.
    """
    if crop is not None and scale:
        raise CalibrationError(f"{_sizes(camera, size_wh)}: expected crop or scale, got both")
    if crop is not None:
        return _cropped(camera, size_wh, crop)
    if size_wh == camera.size_wh:
        return camera
    if scale or _same_proportions(camera.size_wh, size_wh):
        return camera.scaled(size_wh)
    if image is not None:
        left, top, right, bottom = black_bars(image)
        inner = (size_wh[0] - left - right, size_wh[1] - top - bottom)
        if inner != size_wh and min(inner) > 0 and _same_proportions(camera.size_wh, inner):
            return camera.scaled(inner).cropped(-left, -top, size_wh)
    turned = "; the video looks turned by 90 degrees: turn it back" if size_wh == camera.size_wh[::-1] else ""
    raise CalibrationError(
        f"{_sizes(camera, size_wh)}, which may be a cut-out or a resampling{turned}; "
        f"state which for camera {camera.name}: crop = [left, top] in px of the calibrated image, or scale = true"
    )


def black_bars(image: Array) -> tuple[int, int, int, int]:
    """Width in px of the black bars at the left, top, right and bottom of an (H, W, 3) uint8 image."""
    grey = np.asarray(image, np.float64).max(axis=-1)
    columns = np.flatnonzero(np.percentile(grey, 90, axis=0) > _BLACK)
    rows = np.flatnonzero(np.percentile(grey, 90, axis=1) > _BLACK)
    if len(columns) == 0 or len(rows) == 0:
        return 0, 0, 0, 0
    height, width = grey.shape
    return int(columns[0]), int(rows[0]), int(width - 1 - columns[-1]), int(height - 1 - rows[-1])


def _cropped(camera: Camera, size_wh: tuple[int, int], crop: tuple[float, float]) -> Camera:
    left, top = crop
    room = (camera.size_wh[0] - size_wh[0], camera.size_wh[1] - size_wh[1])
    if not (0 <= left <= room[0] and 0 <= top <= room[1]):
        raise CalibrationError(
            f"{_sizes(camera, size_wh)}: crop = [{left:g}, {top:g}]: "
            f"expected left from 0 to {room[0]} and top from 0 to {room[1]}, so that the cut-out lies inside"
        )
    return camera.cropped(left, top, size_wh)


def _same_proportions(calibrated_wh: tuple[int, int], size_wh: tuple[int, int]) -> bool:
    """Whether one factor takes the calibrated size to `size_wh`, each side rounded to whole px."""
    least = max((side - _ROUNDING_PX) / full for side, full in zip(size_wh, calibrated_wh, strict=True))
    most = min((side + _ROUNDING_PX) / full for side, full in zip(size_wh, calibrated_wh, strict=True))
    return least <= most


def _sizes(camera: Camera, size_wh: tuple[int, int]) -> str:
    return (
        f"camera {camera.name}: video of {size_wh[0]}x{size_wh[1]} px, calibrated at {camera.size_wh[0]}x{camera.size_wh[1]} px"
    )
