"""Pose3D to JointAngles: segment frames (ISB axes) and joint angles, live and recorded."""

from typing import TYPE_CHECKING

from posefuse.core.extras import lazy_names

if TYPE_CHECKING:
    from .definitions import JOINT_NAMES, JOINTS, SEGMENT_NAMES, SEGMENTS, undefined_segments
    from .joints import JointTracker, joints_from_poses
    from .settings import JointSettings
    from .side_clues import check_sides, facing_votes

__getattr__ = lazy_names(__name__, __file__)
