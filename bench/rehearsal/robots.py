"""The robots that the fault bench drives: a point, our own with one and two arms, and a fixed arm."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass
from typing import Any

import numpy as np

from posefuse.core.arrays import Array
from posefuse_teleop.follower import Follower, Robot
from posefuse_teleop.process import RobotPlan, built
from posefuse_teleop.settings import TeleoperationSettings
from posefuse_teleop.values import RobotState

# spheres of the point robot's body, counted from its end effector
_SPHERES = np.array([[0.0, 0.0, 0.0, 0.1], [0.25, 0.0, 0.1, 0.12], [0.5, 0.0, -0.2, 0.2]])


class ExactRobot:
    """End effectors always exactly at their commanded positions (`follower.Robot`): limits and gate without joints.

    Attributes:
        fault: what it reports about itself.
    """

    def __init__(self, xyz: Array, wxyz: Array | None = None) -> None:
        self._xyz = np.atleast_2d(np.asarray(xyz, np.float64))
        self._wxyz = np.tile([1.0, 0.0, 0.0, 0.0], (len(self._xyz), 1)) if wxyz is None else wxyz
        self.fault = ""
        self._rates = np.zeros_like(self._xyz), np.zeros_like(self._xyz)

    def state(self) -> RobotState:
        """See `Robot`."""
        spheres = _SPHERES + np.array([*self._xyz[0], 0.0])
        return RobotState(
            xyz_world=self._xyz,
            wxyz=self._wxyz,
            velocity_world=self._rates[0],
            turn_rate_world=self._rates[1],
            measured_xyz_world=self._xyz,
            spheres_world=spheres,
            fault=self.fault,
        )

    def move(self, wanted: Follower, dt_s: float, left_out: int = 0) -> None:
        """See `Robot`."""
        self._xyz, self._wxyz, self._rates = wanted.xyz, wanted.wxyz, (wanted.velocity, wanted.turn_rate)

    def close(self) -> None:
        """See `Robot`."""


@dataclass(frozen=True, kw_only=True)
class Stand:
    """A robot of the bench: hands that drive it, where its base stands and faces, and how it is made."""

    hands: tuple[str, ...] = ("right",)
    position_xy_m: tuple[float, float] = (0.0, 0.0)
    heading_deg: float = 0.0
    make: Callable[[TeleoperationSettings], Robot]


def _point(settings: TeleoperationSettings) -> Robot:
    return ExactRobot(np.array([1.9, -0.2, 0.9]))


def with_joints(settings: TeleoperationSettings, text: str | None = None) -> Any:
    """A `MujocoRobot` of an MJCF text; None: our own."""
    return built(RobotPlan(settings=settings, frames=tuple(f"{side}_hand" for side in settings.hands), scene=text))


def _fixed(settings: TeleoperationSettings) -> Robot:
    from .arms import fixed_arm

    return with_joints(settings, fixed_arm())


# all stand so that an operator at the origin is kept at a distance, and face the operator
STANDS = {
    "point": Stand(make=_point),
    "own": Stand(position_xy_m=(2.4, -0.2), heading_deg=180.0, make=with_joints),
    "fixed": Stand(position_xy_m=(2.3, -0.2), heading_deg=180.0, make=_fixed),
    "two arms": Stand(hands=("right", "left"), position_xy_m=(2.4, 0.0), heading_deg=180.0, make=with_joints),
}


def copied(robot: Any) -> Any:
    """The same robot, to go another way; models and scratch data are shared."""
    other = copy(robot)
    if hasattr(robot, "joints"):
        other.data, other.joints = copy(robot.data), copy(robot.joints)
        other.joints.ik = copy(robot.joints.ik)
    return other
