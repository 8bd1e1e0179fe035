"""The 2D estimator that the config names, made for this machine and rig."""

from __future__ import annotations

from posefuse.core import Detector, Rig
from posefuse.foundation.plugins import build_plugin
from posefuse.pipeline.config import DetectorChoice
from posefuse.tracking import JointCentres, read_joint_centres


def build_detector(choice: DetectorChoice, rig: Rig) -> Detector:
    """Build the detector plug-in; one that takes `up_rad` is told where up is in each camera's picture."""
    from . import up_angle_rad

    known = {"up_rad": {camera.name: up_angle_rad(camera) for camera in rig}}
    detector: Detector = build_plugin("detectors", choice.name, choice.options, known)
    return detector


def joint_centres_of(detector: Detector) -> JointCentres | None:
    """How joint centres lie beside its keypoints, where it knows; raises ConfigError for a table that is not right."""
    return read_joint_centres(detector.joint_centres_file) if detector.joint_centres_file else None
