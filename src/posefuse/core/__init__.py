"""The words everyone shares. Needs numpy only and knows no other room."""

from .camera import Camera
from .errors import (
    CalibrationError,
    ConfigError,
    DependencyError,
    InputError,
    MessageError,
    ModelError,
    PosefuseError,
    ShapeError,
    SourceError,
)
from .protocols import Detector, Sink, Source
from .rig import Rig
from .se3 import SE3
from .skeleton import SKELETONS, Skeleton
from .values import CameraTruth, Detections2D, Frame, Joints, Kind, Pose3D, PoseSequence, Recording, Region, Truth, Views

__all__ = [
    "SE3", "SKELETONS", "CalibrationError", "Camera", "CameraTruth", "ConfigError", "DependencyError", "Detections2D",
    "Detector", "Frame", "InputError", "Joints", "Kind", "MessageError", "ModelError", "Pose3D", "PoseSequence", "PosefuseError",
    "Recording", "Region", "Rig", "ShapeError", "Sink", "Skeleton", "Source", "SourceError", "Truth", "Views",
]  # fmt: skip
