"""Dead-man's switches: each only reports; whether the robot moves is decided by the gate."""

from .opening import open_deadman
from .protocol import DeadMan, Pressed

__all__ = ["DeadMan", "Pressed", "open_deadman"]
