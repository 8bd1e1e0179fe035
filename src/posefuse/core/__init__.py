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

__getattr__ = lazy_names(__name__, __file__)
