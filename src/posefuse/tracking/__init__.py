"""Pose3D over time: recorded data smoothed, gaps bridged, bones held to one length."""

from typing import TYPE_CHECKING

from posefuse.core.extras import lazy_names

if TYPE_CHECKING:
    from .body_directions import usual_lengths
    from .joint_centres import LandmarksInParts, LearntLengths, ViewsAtJointCentres, at_joint_centres, to_joint_centres
    from .settings import SmoothSettings
    from .sides import sides_like, steady_sides
    from .smoothing import bone_lengths, cutoff_hz, smooth, smooth_in_place

__getattr__ = lazy_names(__name__, __file__)
