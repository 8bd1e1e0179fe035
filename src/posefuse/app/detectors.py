"""The 2D estimator that the config names, made for this machine and rig."""

from __future__ import annotations

from posefuse.app.config import DetectorChoice
from posefuse.app.plugins import build_plugin
from posefuse.core import Detector, Rig


def build_detector(choice: DetectorChoice, rig: Rig) -> Detector:
    """Build the detector plug-in."""
    return build_plugin("detectors", choice.name, choice.options)
