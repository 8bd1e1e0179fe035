"""The simulated human body: its mesh, its joints, and the exact truth about both."""

from .angles import ANGLE_NAMES, JOINTS, SEGMENTS, rotation_of
from .body import Body, build_body
from .settings import BodySettings

__all__ = ["ANGLE_NAMES", "JOINTS", "SEGMENTS", "Body", "BodySettings", "build_body", "rotation_of"]
