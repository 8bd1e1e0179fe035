"""Pose3D over time: recorded data smoothed, gaps bridged, bones held to one length."""

from .bones import bone_lengths
from .sequence import sequence_from_poses
from .sides import sides_like, steady_sides
from .smooth import SmoothSettings, cutoff_hz, smooth

__all__ = ["SmoothSettings", "bone_lengths", "cutoff_hz", "sequence_from_poses", "sides_like", "smooth", "steady_sides"]
