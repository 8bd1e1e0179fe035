"""The values that every package shares. Needs numpy only and imports no other package."""

from typing import TYPE_CHECKING

from .extras import lazy_names

if TYPE_CHECKING:
    from .arrays import Array
    from .camera import Camera
    from .errors import (
        CalibrationError,
        ConfigError,
        DependencyError,
        DiskFullError,
        InputError,
        MessageError,
        ModelError,
        PosefuseError,
        ShapeError,
        SourceError,
        choices,
    )
    from .frames import Frame
    from .joint_angles import AngleSeries, JointAngles
    from .joint_centres import JointCentres
    from .live_messages import (
        CameraHealth,
        LiveDetections,
        LiveExpected,
        LiveHealth,
        LiveJointCentres,
        LiveMessage,
        LiveNames,
        LivePose,
        LivePreview,
        LiveStart,
        OutputHealth,
    )
    from .observations import DetectionBatch, LookKind, Observations
    from .poses import Kind, Pose3D, PoseSequence
    from .protocols import Closing, Detector, LiveOutput, LiveOutputConfig, Progress, Sink, Source, silent
    from .recording import Recording
    from .rig import Rig
    from .se3 import SE3
    from .skeleton import PAPER14, SKELETONS, Skeleton, pick_keypoints
    from .truth import CameraTruth, Truth
    from .values import Detections2D, Region, Views
    from .view_sequences import ViewSequence, views_over_time

# for `mypy --strict` of a program: what an installed package only imports, it does not offer
__all__ = [
    "PAPER14", "SE3", "SKELETONS", "AngleSeries", "Array", "CalibrationError", "Camera", "CameraHealth",
    "CameraTruth", "Closing", "ConfigError", "DependencyError", "DetectionBatch", "Detections2D", "Detector",
    "DiskFullError", "Frame", "InputError", "JointAngles", "JointCentres", "Kind", "LiveDetections", "LiveExpected",
    "LiveHealth", "LiveJointCentres", "LiveMessage", "LiveNames", "LiveOutput", "LiveOutputConfig", "LivePose",
    "LivePreview", "LiveStart", "LookKind", "MessageError", "ModelError", "Observations", "OutputHealth", "Pose3D",
    "PoseSequence", "PosefuseError", "Progress", "Recording", "Region", "Rig", "ShapeError", "Sink", "Skeleton",
    "Source", "SourceError", "Truth", "ViewSequence", "Views", "choices", "pick_keypoints", "silent",
    "views_over_time",
]  # fmt: skip

__getattr__ = lazy_names(__name__, __file__)
