"""Dead-man's switches: each only reports; whether the robot moves is decided by the gate."""

from .protocol import DeadMan, Pressed, open_deadman

__all__ = ["DeadMan", "Pressed", "open_deadman"]
