"""Pose3D over time: recorded data smoothed, gaps bridged, bones held to one length."""

from typing import TYPE_CHECKING

from posefuse.core.lazy_names import lazy_names

if TYPE_CHECKING:
    from .bones import bone_lengths
    from .centred_views import ViewsAtJointCentres
    from .joint_centres import LandmarksInParts, LearntLengths, at_joint_centres, to_joint_centres
    from .segments import usual_lengths
    from .settings import SmoothSettings
    from .sides import sides_like, steady_sides
    from .smoothing import cutoff_hz, smooth, smooth_in_place

__all__ = [
    "LandmarksInParts", "LearntLengths", "SmoothSettings", "ViewsAtJointCentres", "at_joint_centres", "bone_lengths", "cutoff_hz",
    "sides_like", "smooth", "smooth_in_place", "steady_sides", "to_joint_centres", "usual_lengths",
]  # fmt: skip
__getattr__ = lazy_names(__name__, __file__)
