"""Images of what was refused: an image of each camera that a failed check names, with the target as it was found there."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np

from posefuse.calibration.targets.coverage import coverage_picture
from posefuse.calibration.targets.detection import TargetDetector
from posefuse.calibration.targets.kinds import Target
from posefuse.core import PosefuseError
from posefuse.core.arrays import Array
from posefuse.outputs.drawing import jpeg_of, shrunk_wh
from posefuse.sources import VideoConfig, VideoSeeker

from .calibrations import SeenTarget, Step, StepResult

_LOOKS = 9
_WIDTH_PX, _QUALITY = 480, 80
_CORNER_RGB = (255, 40, 200)


def refusal_pictures(
    result: StepResult, videos: Mapping[str, Path], target: Target, folder: Path, step: Step, seen: SeenTarget | None
) -> dict[str, Path]:
    """Write ``STEP-CAMERA.jpg`` into a folder for every camera that a failed check of a result names; returns them by camera.

    Each shows the image with most corners of the target among some of its video, these corners, and what was covered.
    """
    detector, made = TargetDetector(target), {}
    for camera in filter(result.blames, videos):
        cells = dict(zip(seen.cameras, seen.cells, strict=False)).get(camera) if seen is not None else None
        try:
            image = _drawn(videos[camera], camera, detector, None if cells is None else np.asarray(cells))
        except PosefuseError:
            # the check itself reports a video without any frame
            continue
        folder.mkdir(exist_ok=True)
        made[camera] = folder / f"{step}-{camera}.jpg"
        made[camera].write_bytes(jpeg_of(image, _QUALITY))
    return made


def _drawn(video: Path, camera: str, detector: TargetDetector, cells: Array | None) -> Array:
    image, corners = _best(VideoSeeker(VideoConfig(video, camera)), detector)
    size_wh = shrunk_wh((image.shape[1], image.shape[0]), _WIDTH_PX)
    drawn = np.ascontiguousarray(cv2.resize(image, size_wh, interpolation=cv2.INTER_AREA))
    if cells is not None:
        drawn = coverage_picture(cells, size_wh, drawn)
    for x, y in np.round(corners * size_wh[0] / image.shape[1]).astype(int).tolist():
        cv2.circle(drawn, (x, y), 4, _CORNER_RGB, 2, cv2.LINE_AA)
    text = f"{camera}: {len(corners)} corners found" if len(corners) else f"{camera}: no target found"
    cv2.rectangle(drawn, (0, 0), (size_wh[0], 30), (20, 28, 34), -1)
    cv2.putText(drawn, text, (10, 21), cv2.FONT_HERSHEY_SIMPLEX, 0.6, (255, 255, 255), 1, cv2.LINE_AA)
    return drawn


def _best(seeker: VideoSeeker, detector: TargetDetector) -> tuple[Array, Array]:
    """The image (H, W, 3) with most corners (n, 2) of those looked at; the middle one where there are none."""
    try:
        places = np.linspace(0, len(seeker.times_ns) - 1, _LOOKS + 2).round().astype(int)[1:-1]
        images = [seeker.at(i).image for i in dict.fromkeys(places.tolist())]
    finally:
        seeker.close()
    found = [(image, detector.detect(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)).xy_img) for image in images]
    middle = len(found) // 2
    return max(enumerate(found), key=lambda one: (len(one[1][1]), one[0] == middle))[1]
