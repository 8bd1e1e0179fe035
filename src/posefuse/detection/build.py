"""The 2D estimator that the config names, made for this machine and rig."""

from __future__ import annotations

from posefuse.core import Detector, Rig, Skeleton
from posefuse.foundation.plugins import build_plugin
from posefuse.pipeline.config import DetectorChoice
from posefuse.tracking import JointCentres, proportional_joint_centres, read_joint_centres


def build_detector(choice: DetectorChoice, rig: Rig) -> Detector:
    """Build the detector plug-in; one that takes `up_rad` is told where up is in each camera's picture."""
    from . import up_angle_rad

    known = {"up_rad": {camera.name: up_angle_rad(camera) for camera in rig}}
    detector: Detector = build_plugin("detectors", choice.name, choice.options, known)
    return detector


def joint_centres_of(detector: Detector) -> JointCentres | None:
    """Where joint centres lie beside its keypoints: as fitted to it, else as people's proportions say.

    Raises:
        ConfigError: a table that is not right.
    """
    if detector.joint_centres_file:
        return read_joint_centres(detector.joint_centres_file)
    return proportional_joint_centres(detector.skeleton)


def joint_centres_of_files(skeleton: Skeleton) -> JointCentres | None:
    """The same for 2D poses of other tools: MediaPipe's are of the networks that come with us."""
    from . import default_cards

    if skeleton.name == "blazepose33":
        file = default_cards()[-1].joint_centres_file
        return read_joint_centres(file) if file else None
    return proportional_joint_centres(skeleton)
