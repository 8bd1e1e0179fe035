"""The simulated human body: its mesh, its joints, and the exact truth about both."""

from .anatomy import ANGLE_NAMES, JOINTS, SEGMENTS, rotation_of
from .body import SimulatedBody, build_body
from .mesh import BodyShapeSettings
