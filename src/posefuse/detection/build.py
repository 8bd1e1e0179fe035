"""The detector that the settings name, built for this machine and rig."""

from __future__ import annotations

from dataclasses import field
from typing import Any

from posefuse.core import Detector, Rig
from posefuse.foundation.plugins import build_plugin
from posefuse.foundation.settings import settings


@settings
class DetectorChoice:
    """Which detector, and its options (see `posefuse plugins`)."""

    name: str = "blazepose"
    options: dict[str, Any] = field(default_factory=dict)


def build_detector(choice: DetectorChoice, rig: Rig) -> Detector:
    """Build the detector plug-in; one that takes `up_rad` is told where up is in each camera's picture."""
    from . import up_angle_rad

    known = {"up_rad": {camera.name: up_angle_rad(camera) for camera in rig}}
    detector: Detector = build_plugin("detectors", choice.name, choice.options, known)
    return detector
