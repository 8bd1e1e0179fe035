"""posefuse: several ordinary cameras + AI -> one accurate 3D human skeleton, live or recorded, with honest uncertainty.

import posefuse as pf
recording = pf.track("session/")
recording.joint_angles()["left_knee", "flexion"].deg
recording.save("result/", formats=("trc", "c3d"))
"""

from typing import TYPE_CHECKING

from .core.extras import lazy_names

__version__ = "0.2.0"

if TYPE_CHECKING:
    # from packages that an extra installs; their names say so where it is missing
    from posefuse_ros.nodes import camera_node, fusion_node
    from posefuse_sim.api import gazebo_world, plan, simulate
    from posefuse_teleop.api import teleoperate

    from .api.calibrate import calibrate_clocks, calibrate_extrinsics, calibrate_intrinsics, calibrate_person, verify
    from .api.compare import compare
    from .api.live import live
    from .api.live_run import track_live
    from .api.machine import doctor, models, plugins
    from .api.record import record, resume_recording
    from .api.recording import JointAngles, Recording, read
    from .api.rig_and_detector import Rig, detector, read_rig
    from .api.targets import print_target
    from .api.track import batch, demo_session, solve, track
    from .core import Camera, Detections2D, Observations, Pose3D, PosefuseError, PoseSequence, Progress, Skeleton
    from .fusion import triangulate
    from .pipeline.edits import Edits, Exclusion

__all__ = [
    "Camera", "Detections2D", "Edits", "Exclusion", "JointAngles", "Observations", "Pose3D", "PoseSequence",
    "PosefuseError", "Progress", "Recording", "Rig", "Skeleton", "__version__", "batch", "calibrate_clocks",
    "calibrate_extrinsics", "calibrate_intrinsics", "calibrate_person", "camera_node", "compare", "demo_session",
    "detector", "doctor", "fusion_node", "gazebo_world", "live", "models", "plan", "plugins", "print_target", "read",
    "read_rig", "record", "resume_recording", "simulate", "solve", "teleoperate", "track", "track_live",
    "triangulate", "verify",
]  # fmt: skip


__getattr__ = lazy_names(__name__, __file__)


def __dir__() -> list[str]:
    return sorted(__all__)
