"""What travels between the operator's side and the robot's side. Axis H: hands, in the order of the settings.

Times are ns of `time.monotonic_ns`, one clock for all processes of a machine.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from posefuse.core.arrays import Array, frozen_fields


def all_finite(*arrays: Array) -> bool:
    """Whether no number is NaN or infinite: a sum shows it, in a fraction of the time. Sums that overflow count as infinite."""
    with np.errstate(over="ignore", invalid="ignore"):
        return all(math.isfinite(float(array.sum())) for array in arrays)


class Phase(StrEnum):
    """State of the gate."""

    IDLE = "idle"  # something is missing, or the dead-man's switch must be let go first
    READY = "ready"  # a press engages
    ENGAGED = "engaged"  # the robot follows
    HOLD = "hold"  # the robot stands; continues by itself when all is well again soon
    STOPPED = "stopped"  # a fault of the robot or an emergency stop; only a reset leaves it


@dataclass(frozen=True, kw_only=True)
class CameraReport:
    """State of the cameras. t_ns: time of the report. healthy, total: numbers of cameras."""

    t_ns: int
    healthy: int
    total: int


@dataclass(frozen=True, eq=False, kw_only=True)
class Order:
    """What the operator's side sends to the robot's side, about 100 times a second.

    Attributes:
        seq: counts orders. sent_ns: when it was sent. phase: the robot moves in ENGAGED only, in every other it brakes.
        xyz_world, wxyz: (H, 3), (H, 4) target pose of each end effector. speed_mps: limit for all of them, at least 0.
        grip: (H,) bool, close the gripper. measured_ns: mid-exposure of the newest image behind the target; 0: none.
        reason: why it does not move at full speed, for people.
    """

    seq: int
    sent_ns: int
    phase: Phase
    xyz_world: Array
    wxyz: Array
    speed_mps: float
    grip: Array
    measured_ns: int = 0
    reason: str = ""

    def __post_init__(self) -> None:
        frozen_fields(self, {"xyz_world": "H 3", "wxyz": "H 4", "grip": "H"}, {"grip": np.bool_})

    @property
    def usable(self) -> bool:
        """Whether all numbers are finite and the quaternions of length 1; checked again by the receiver."""
        finite = all_finite(self.xyz_world, self.wxyz) and math.isfinite(self.speed_mps)
        return finite and self.speed_mps >= 0 and bool((np.abs((self.wxyz * self.wxyz).sum(axis=1) - 1) < 1e-3).all())


_ROBOT_AXES = {
    **dict.fromkeys(("xyz_world", "velocity_world", "turn_rate_world", "measured_xyz_world"), "H 3"),
    "wxyz": "H 4",
    "q_rad": "J",
    "spheres_world": "M 4",
}


@dataclass(frozen=True, eq=False, kw_only=True)
class RobotState:
    """How the robot is, and what its side answers once per control step.

    Attributes:
        xyz_world, wxyz: (H, 3), (H, 4) end effectors as commanded. velocity_world, turn_rate_world: (H, 3), (H, 3) of them.
        measured_xyz_world: (H, 3) end effectors as they are. q_rad: (J,) joints as commanded (base: metres).
        spheres_world: (M, 4) centre and radius of spheres that cover the robot. fault: why it cannot move; empty when it can.
        sent_ns: when. order_seq: of the order that was carried out last. order_measured_ns: its `measured_ns`.
        pace: share of the speed limit that the robot can use now, in 0..1: less near singularities.
        late: control steps that were. limited: what the robot's side slows down or stops for, for people.
    """

    xyz_world: Array
    wxyz: Array
    velocity_world: Array
    turn_rate_world: Array
    measured_xyz_world: Array
    q_rad: Array = field(default_factory=lambda: np.zeros(0))
    spheres_world: Array = field(default_factory=lambda: np.zeros((0, 4)))
    fault: str = ""
    sent_ns: int = 0
    order_seq: int = -1
    order_measured_ns: int = 0
    pace: float = 1.0
    late: int = 0
    limited: str = ""

    def __post_init__(self) -> None:
        frozen_fields(self, _ROBOT_AXES)

    @property
    def usable(self) -> bool:
        """Whether the numbers that the operator's side relies on are finite."""
        return all_finite(self.xyz_world, self.wxyz, self.velocity_world, self.spheres_world)


_VIEW_AXES = {
    **dict.fromkeys(("xyz_world", "other_xyz_world"), "H 3"),
    **dict.fromkeys(("sigma_m", "views", "measured", "forearm_m"), "H"),
    "body_xyz_world": "K 3",
    **dict.fromkeys(("body_sigma_m", "body_measured"), "K"),
}


@dataclass(frozen=True, eq=False, kw_only=True)
class OperatorView:
    """The operator as the newest pose shows them.

    Attributes:
        t_ns: what time the pose is for. measured_ns: mid-exposure of the newest image in it. person_id: -1: no person there.
        xyz_world: (H, 3) the hands; NaN where missing. sigma_m: (H,) standard deviation in the worst direction.
        views: (H,) cameras that saw the hand lately. measured: (H,) bool, False: only predicted.
        other_xyz_world: (H, 3) the wrist of the other arm. forearm_m: (H,) distance of elbow and wrist.
        body_xyz_world: (K, 3) keypoints. body_sigma_m: (K,). body_measured: (K,) bool.
    """

    t_ns: int
    measured_ns: int
    person_id: int
    xyz_world: Array
    sigma_m: Array
    views: Array
    measured: Array
    other_xyz_world: Array
    forearm_m: Array
    body_xyz_world: Array
    body_sigma_m: Array
    body_measured: Array

    def __post_init__(self) -> None:
        frozen_fields(self, _VIEW_AXES, {"views": np.int64, "measured": np.bool_, "body_measured": np.bool_})
