"""Robots behind one protocol: one in MuJoCo with real physics, and real ones by ROS messages."""

from .driver import Robot

__all__ = ["Robot"]
