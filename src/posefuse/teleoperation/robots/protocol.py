"""What a robot must offer to be teleoperated."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from posefuse.core.arrays import Array
from posefuse.teleoperation.follower import STANDING

# joints, and orientations of end effectors, may be so far from the commanded ones
FOLLOWS_RAD = 0.35
# and end effectors: what the default speed limit covers in 0.3 s, more than a usual controller lags
FOLLOWS_M = 0.15


@dataclass(frozen=True, eq=False, kw_only=True)
class Goal:
    """Where the end effectors are to be at the end of a control step, already within all limits.

    Attributes:
        xyz_world, wxyz: (H, 3), (H, 4). velocity_world, turn_rate_world: (H, 3), (H, 3). grip: (H,) bool.
        brakes: the robot is to stop, or to stand: one with joints stops them in its own way.
    """

    xyz_world: Array
    wxyz: Array
    velocity_world: Array
    turn_rate_world: Array
    grip: Array
    brakes: bool

    @property
    def stands(self) -> bool:
        """Whether nothing is to move in this step."""
        return bool(np.abs(self.velocity_world).max() <= STANDING and np.abs(self.turn_rate_world).max() <= STANDING)


@dataclass(frozen=True, eq=False, kw_only=True)
class Posture:
    """How the robot is.

    Attributes:
        xyz_world, wxyz: (H, 3), (H, 4) end effectors as commanded, from the commanded joint positions.
        velocity_world, turn_rate_world: (H, 3), (H, 3) of them, as commanded.
        measured_xyz_world: (H, 3) as they are. q: (J,) joints as commanded, rad or m. spheres_world: (M, 4) that cover the robot.
        fault: why it cannot move; empty when it can.
    """

    xyz_world: Array
    wxyz: Array
    velocity_world: Array
    turn_rate_world: Array
    measured_xyz_world: Array
    q: Array = field(default_factory=lambda: np.zeros(0))
    spheres_world: Array = field(default_factory=lambda: np.zeros((0, 4)))
    fault: str = ""


class Robot(Protocol):
    """A robot whose end effectors follow goals; used by the robot process only."""

    def posture(self) -> Posture:
        """How the robot is now; raises PosefuseError where that cannot be known."""
        ...

    def pace(self) -> float:
        """Share of the speed limit that the robot can use now, in 0..1: less near singularities."""
        ...

    def move(self, goal: Goal, dt_s: float, left_out: int = 0) -> None:
        """Go there, as far as joints, their limits and collisions allow; called once per control step.

        Args:
            left_out: steps that were due before and never done, as the process was late.
        """
        ...

    def close(self) -> None:
        """Leave it standing; safe to call twice."""
        ...
