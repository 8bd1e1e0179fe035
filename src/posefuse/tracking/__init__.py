"""Pose3D over time: recorded data smoothed, gaps bridged, bones held to one length."""

from .bones import bone_lengths
from .centred_views import views_at_joint_centres
from .joint_centres import at_joint_centres, from_joint_centres, to_joint_centres
from .learnt_lengths import LearntLengths
from .proportions import usual_lengths
from .sides import sides_like, steady_sides
from .smooth import SmoothSettings, cutoff_hz, smooth

__all__ = [
    "LearntLengths", "SmoothSettings", "at_joint_centres", "bone_lengths", "cutoff_hz", "from_joint_centres",
    "sides_like", "smooth", "steady_sides",
    "to_joint_centres", "usual_lengths", "views_at_joint_centres",
]  # fmt: skip
