"""A robot of three spheres that is always exactly at its commanded position: limits and gate without joints."""

from __future__ import annotations

import numpy as np

from posefuse.core.arrays import Array
from posefuse.teleoperation.robots.protocol import Goal, Posture

# of a robot's body, counted from its end effector
_SPHERES = np.array([[0.0, 0.0, 0.0, 0.1], [0.25, 0.0, 0.1, 0.12], [0.5, 0.0, -0.2, 0.2]])


class ExactRobot:
    """End effectors at their commanded positions (`protocol.Robot`). fault: what it reports about itself."""

    def __init__(self, xyz: Array, wxyz: Array | None = None) -> None:
        self._xyz = np.atleast_2d(np.asarray(xyz, np.float64))
        self._wxyz = np.tile([1.0, 0.0, 0.0, 0.0], (len(self._xyz), 1)) if wxyz is None else wxyz
        self.fault = ""

    def posture(self) -> Posture:
        """See `Robot`."""
        spheres = _SPHERES + np.array([*self._xyz[0], 0.0])
        return Posture(
            xyz_world=self._xyz, wxyz=self._wxyz, measured_xyz_world=self._xyz, spheres_world=spheres, fault=self.fault
        )

    def pace(self) -> float:
        """See `Robot`."""
        return 1.0

    def move(self, goal: Goal, dt_s: float, left_out: int = 0) -> None:
        """See `Robot`."""
        self._xyz, self._wxyz = goal.xyz_world, goal.wxyz

    def close(self) -> None:
        """See `Robot`."""
