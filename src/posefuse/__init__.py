"""posefuse: several ordinary cameras + AI -> one accurate 3D human skeleton, live or recorded, with honest uncertainty.

import posefuse as pf
recording = pf.track("session/")
recording.joint_angles()["left_knee", "flexion"].deg
recording.save("result/", formats=("trc", "c3d"))
"""

from typing import TYPE_CHECKING

from .core.lazy_names import lazy_names

__version__ = "0.2.0"

if TYPE_CHECKING:
    from .api.batch import batch
    from .api.calibrate import calibrate_clocks, calibrate_extrinsics, calibrate_intrinsics, calibrate_person, verify
    from .api.compare import compare
    from .api.detector import detector
    from .api.joint_angles import JointAngles
    from .api.live import live
    from .api.plan import plan
    from .api.recording import Recording, read
    from .api.recordings import recordings
    from .api.rig import Rig, read_rig
    from .api.simulate import gazebo_world, simulate
    from .api.teleoperate import teleoperate
    from .api.track import track
    from .core import Camera, Detections2D, Observations, Pose3D, PosefuseError, PoseSequence, Progress, Skeleton
    from .fusion import triangulate
    from .pipeline.edits import Edits, Exclusion

__all__ = [
    "Camera", "Detections2D", "Edits", "Exclusion", "JointAngles", "Observations", "Pose3D", "PoseSequence", "PosefuseError",
    "Progress", "Recording", "Rig", "Skeleton", "__version__", "batch", "calibrate_clocks", "calibrate_extrinsics",
    "calibrate_intrinsics", "calibrate_person", "compare", "detector", "gazebo_world", "live", "plan", "read", "read_rig",
    "recordings", "simulate", "teleoperate", "track", "triangulate", "verify",
]  # fmt: skip


__getattr__ = lazy_names(__name__, __file__)


def __dir__() -> list[str]:
    return sorted(__all__)
