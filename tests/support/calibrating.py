"""What several tests of the calibration do: run its commands, compare rigs."""

from dataclasses import replace
from typing import Any

import cv2
import numpy as np

from bench.faults.sessions import scale_of
from posefuse.calibration.extrinsics.self_checks import camera_differences
from posefuse.calibration.geometry import Poses, poses_of
from posefuse.calibration.targets.kinds import dictionary_of
from posefuse.cli.command_line import parse
from posefuse.cli.terminal import Terminal
from posefuse.core import Camera, Rig


def run(*words: str) -> dict[str, Any]:
    """The figures of a `posefuse calibrate` command."""
    found = parse(["calibrate", *words])
    assert found is not None
    return dict(found.run(Terminal(as_json=True)))


def marker_page(number: int = 3) -> np.ndarray:
    """(120, 160, 3) a white page with one marker."""
    page = np.full((120, 160, 3), 255, np.uint8)
    page[30:90, 50:110] = cv2.aruco.generateImageMarker(dictionary_of("DICT_4X4_50"), number, 60)[..., None]
    return page


def refined(image: np.ndarray, guess: np.ndarray, half_px: int) -> np.ndarray:
    """(Q, 2) corners of an RGB image near these (Q, 2), found in windows of 2 `half_px` + 1."""
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 60, 1e-3)
    grey, near = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), guess.astype(np.float32).reshape(-1, 1, 2).copy()
    return cv2.cornerSubPix(grey, near, (half_px, half_px), (-1, -1), stop)[:, 0]


def differences(a: Rig, b: Rig, scaled: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Distance (C,) in m and angle (C,) in rad of each camera, up to where the world is, and up to scale on request."""
    one, other = poses_of(a), poses_of(b)
    return camera_differences(one, Poses(other.R, other.t * scale_of(one, other)) if scaled else other)


def zoomed(rig: Rig, camera: int, factor: float) -> tuple[Camera, ...]:
    """Cameras of the rig, one of them with other focal lengths."""
    cameras, wrong = list(rig), rig.cameras[camera]
    cameras[camera] = replace(wrong, K=wrong.K * np.array([[factor, 1, 1], [1, factor, 1], [1, 1, 1]]))
    return tuple(cameras)
