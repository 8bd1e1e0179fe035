"""A video whose size is not the calibrated one: cut out of it, or resampled?"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from posefuse.core import CalibrationError, Camera
from posefuse.core.arrays import Array

# black bars in compressed video are not quite 0
_BLACK = 16.0
_ROUNDING_PX = 1.0
# resampling and compression blur the edge of a bar over this much
_BLUR_PX = 3


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
        CalibrationError: no interpretation, or an impossible statement; the message has both sizes and how to state the resizing.
    """
    if crop is not None and scale:
        raise CalibrationError(f"{_sizes(camera, size_wh)}: expected crop or scale, got both")
    if crop is not None:
        return _cropped(camera, size_wh, crop)
    if size_wh == camera.size_wh:
        return camera
    if scale or _same_proportions(camera.size_wh, size_wh):
        return camera.scaled(size_wh)
    padded = None if image is None else _letterboxed(camera, size_wh, black_bars(image))
    if padded is not None:
        return padded
    turned = "; the video looks turned by 90 degrees: turn it back" if size_wh == camera.size_wh[::-1] else ""
    raise CalibrationError(
        f"{_sizes(camera, size_wh)}, which may be a cut-out or a resampling{turned}; "
        f"state which for camera {camera.name}: crop = [left, top] in px of the calibrated image, or scale = true"
    )


def rescaled_cameras(
    cameras: Sequence[Camera], size_wh: Mapping[str, tuple[int, int]]
) -> tuple[tuple[Camera, ...], tuple[str, ...]]:
    """Cameras as they apply to images of other sizes in the calibrated proportions, and a note on each that was changed.

    Args:
        size_wh: (width, height) of the images by camera name. Sizes in other proportions change nothing.
    """
    fitted, notes = [], []
    for camera in cameras:
        width, height = wanted = size_wh.get(camera.name, camera.size_wh)
        if wanted != camera.size_wh and _same_proportions(camera.size_wh, wanted):
            calibrated = f"{camera.size_wh[0]}x{camera.size_wh[1]} px"
            notes.append(f"{camera.name}: its calibration of {calibrated} was rescaled to images of {width}x{height} px")
            camera = camera.scaled(wanted)
        fitted.append(camera)
    return tuple(fitted), tuple(notes)


def black_bars(image: Array) -> tuple[int, int, int, int]:
    """Width in px of the black bars at the left, top, right and bottom of an (H, W, 3) uint8 image."""
    grey = np.asarray(image, np.float64).mean(axis=-1)
    columns, rows = np.median(grey, axis=0), np.median(grey, axis=1)
    return _bar(columns), _bar(rows), _bar(columns[::-1]), _bar(rows[::-1])


def _bar(profile: Array) -> int:
    """How many entries from the start are black; the edge is where half the brightness behind it is reached."""
    bright = np.flatnonzero(profile > _BLACK)
    if len(bright) == 0 or bright[0] == 0:
        return 0
    behind = float(np.median(profile[bright[0] + _BLUR_PX : bright[0] + 3 * _BLUR_PX + 1]))
    return int(np.argmax(profile > max(_BLACK, behind / 2)))


def _letterboxed(camera: Camera, size_wh: tuple[int, int], bars: tuple[int, int, int, int]) -> Camera | None:
    """The camera if what lies between the bars is the whole calibrated image, resampled; None if it is not."""
    left, top, right, bottom = bars
    inner = (size_wh[0] - left - right, size_wh[1] - top - bottom)
    if inner == size_wh or min(inner) <= 0 or not _same_proportions(camera.size_wh, inner):
        return None
    # the side without bars gives the factor exactly, the other only to whole px
    factors = [inner[axis] / camera.size_wh[axis] for axis in (0, 1)]
    factor = factors[0] if left + right == 0 else factors[1] if top + bottom == 0 else sum(factors) / 2
    offset = []
    for axis, (before, after) in enumerate(((left, right), (top, bottom))):
        centred = (size_wh[axis] - factor * camera.size_wh[axis]) / 2
        offset.append(centred if abs(before - after) <= _ROUNDING_PX else before)
    matrix = camera.K.copy()
    matrix[:2] *= factor
    matrix[:2, 2] = (camera.K[:2, 2] + 0.5) * factor - 0.5 + offset
    return replace(camera, K=matrix, size_wh=size_wh)


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
