"""Images of what was refused: an image of each camera that a failed check names, with the target as it was found there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from posefuse.calibration.targets.coverage import coverage_picture
from posefuse.calibration.targets.detection import TargetDetector
from posefuse.calibration.targets.kinds import read_target
from posefuse.core import PosefuseError
from posefuse.core.arrays import Array
from posefuse.outputs.drawing import jpeg_of
from posefuse.sources import VideoConfig, VideoSeeker

from .calibrations import blamed_cameras, failed_checks

_LOOKS = 9
_WIDTH_PX, _QUALITY = 480, 80
_CORNER_RGB = (255, 40, 200)


def refusal_pictures(
    result: Mapping[str, Any], videos: Mapping[str, Path], target: Path, folder: Path, coverage: Mapping[str, Any]
) -> dict[str, Path]:
    """Write ``STEP-CAMERA.jpg`` into a folder for every camera that a failed check of a result names; returns them by camera.

    Each shows the image with most corners of the target among some of its video, these corners, and what was covered.

    Args:
        videos: by camera name. target: description file. coverage: of the recording, see `work.watch`.
    """
    blamed = dict.fromkeys(name for check in failed_checks(result) for name in blamed_cameras(check, tuple(videos)))
    if not blamed:
        return {}
    detector, made = TargetDetector(read_target(target)), {}
    folder.mkdir(exist_ok=True)
    cells = dict(zip(coverage.get("cameras", ()), coverage.get("cells", ()), strict=False))
    for camera in blamed:
        try:
            picture = _picture(videos[camera], camera, detector, cells.get(camera))
        except PosefuseError:
            # the check itself reports a video without any frame
            continue
        made[camera] = folder / f"{result['step']}-{camera}.jpg"
        made[camera].write_bytes(jpeg_of(picture, _QUALITY))
    return made


def _picture(video: Path, camera: str, detector: TargetDetector, cells: Sequence[Sequence[int]] | None) -> Array:
    image, corners = _best(VideoSeeker(VideoConfig(video, camera)), detector)
    scale = min(1.0, _WIDTH_PX / image.shape[1])
    size_wh = (round(image.shape[1] * scale), round(image.shape[0] * scale))
    small: Array = np.asarray(cv2.resize(image, size_wh, interpolation=cv2.INTER_AREA))
    if cells is not None:
        small = coverage_picture(np.asarray(cells), size_wh, small)
    drawn = np.ascontiguousarray(small)
    for x, y in np.round(corners * scale).astype(int).tolist():
        cv2.circle(drawn, (x, y), 4, _CORNER_RGB, 2, cv2.LINE_AA)
    text = f"{camera}: {len(corners)} corners found" if len(corners) else f"{camera}: no target found"
    cv2.rectangle(drawn, (0, 0), (size_wh[0], 30), (20, 28, 34), -1)
    cv2.putText(drawn, text, (10, 21), cv2.FONT_HERSHEY_SIMPLEX, 0.6, (255, 255, 255), 1, cv2.LINE_AA)
    return drawn


def _best(seeker: VideoSeeker, detector: TargetDetector) -> tuple[Array, Array]:
    """The image (H, W, 3) with most corners (n, 2) of those looked at; the middle one where there are none."""
    try:
        places = np.linspace(0, len(seeker.times_ns) - 1, _LOOKS + 2).round().astype(int)[1:-1]
        found = []
        for i in dict.fromkeys(places.tolist()):
            image = seeker.at(i).image
            found.append((image, detector.detect(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)).xy_img))
    finally:
        seeker.close()
    middle = len(found) // 2
    best = max(range(len(found)), key=lambda k: (len(found[k][1]), k == middle))
    return found[best]
