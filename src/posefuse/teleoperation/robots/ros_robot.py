"""A real robot over ROS 2 or ROS 1: the same limited goals as messages of usual controllers.

| command | message | for |
|---|---|---|
| pose | geometry_msgs/PoseStamped | Cartesian controllers, MoveIt Servo (``pose_target_cmds``) |
| twist | geometry_msgs/TwistStamped | MoveIt Servo (``delta_twist_cmds``) |
| joints | trajectory_msgs/JointTrajectory or std_msgs/Float64MultiArray; cmd_vel of a base | our own inverse kinematics |

Where the robot is comes from ``/joint_states`` (joints) or ``/tf`` (pose, twist). While it is not known the robot has a fault.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from posefuse.core import SE3, ConfigError, MessageError, SourceError
from posefuse.core.arrays import Array
from posefuse.core.se3 import quaternion_product
from posefuse.messages.body_messages import pose_stamped, twist, twist_stamped
from posefuse.messages.frames import Frames
from posefuse.messages.intake import decode
from posefuse.messages.messages import header
from posefuse.messages.topics import TF, TF_STATIC, Topic
from posefuse.messages.types import message
from posefuse.teleoperation.mapping import conjugate
from posefuse.teleoperation.settings import LimitSettings, TeleoperationSettings

from .chain import Chain
from .ik import WholeBodyIk
from .mujoco_robot import mujoco_model, placed
from .protocol import Goal, Posture
from .reports import RosPlan

_MOST_BYTES = 1_000_000
# the robot's own state may be so old, and the wait for the first one so long
_STATE_S, _FIRST_S = 0.2, 10.0
# joints may be so far from their commanded positions
_FOLLOWS_RAD = 0.35
_ARM_RADIUS_M = 0.15
# a point of a trajectory lies so many control periods ahead, so that the next one comes in time
_AHEAD_PERIODS = 2


def open_ros_robot(
    command: str, plan: RosPlan, model: Path | None, frames: Sequence[str], settings: TeleoperationSettings
) -> RosJoints | RosCartesian:
    """A robot whose first state has come.

    Raises:
        SourceError: no state comes. ConfigError: a model that does not fit. DependencyError: ROS 1 without rospy.
    """
    node = plan.node("posefuse_robot")
    place = placed(settings.robot.position_xy_m, settings.robot.heading_deg)
    robot: RosJoints | RosCartesian
    if command == "joints":
        if model is None:
            raise ConfigError(
                "--command joints: expected --robot FILE.xml, the model of the robot; there is no other way to know its joints"
            )
        robot = RosJoints(node, plan, Chain(mujoco_model(model, settings.hands), frames), settings.limits, place)
    else:
        robot = RosCartesian(node, plan, command, tuple(frames), place)
    end_s = time.monotonic() + _FIRST_S
    while not robot.known() and time.monotonic() < end_s:
        time.sleep(0.02)
    if not robot.known():
        robot.close()
        raise SourceError(f"robot: nothing of {robot.needs} came within {_FIRST_S:g} s")
    return robot


class _Inbox:
    """Messages of one topic; what cannot be read is left out."""

    def __init__(self, node: Any, topic: Topic) -> None:
        self._reader, self._type = node.reader(topic), topic.type_name

    def take(self) -> list[Any]:
        found = []
        for sample in self._reader.take():
            try:
                found.append(decode(sample.raw, self._type, _MOST_BYTES))
            except MessageError:
                continue
        return found


class RosJoints:
    """Joint commands from our own inverse kinematics (`protocol.Robot`). needs: the topic with the joint states."""

    def __init__(self, node: Any, plan: RosPlan, chain: Chain, limits: LimitSettings, place: SE3) -> None:
        self._node, self._plan, self._place, self._back = node, plan, place, place.inverse()
        self.ik, self.needs = WholeBodyIk(chain, limits), plan.joint_states
        self._states = _Inbox(node, Topic(plan.joint_states, "sensor_msgs/msg/JointState", depth=5))
        arm_type = (
            "std_msgs/msg/Float64MultiArray" if plan.controller.endswith("/commands") else "trajectory_msgs/msg/JointTrajectory"
        )
        self._arm = Topic(plan.controller, arm_type, depth=1)
        vel_type = "geometry_msgs/msg/TwistStamped" if plan.stamped else "geometry_msgs/msg/Twist"
        self._base = Topic(plan.cmd_vel, vel_type, depth=1) if plan.cmd_vel else None
        if not chain.arm.all() and self._base is None:
            raise ConfigError("--command joints: the model has a mobile base; expected --cmd-vel TOPIC for it")
        self._measured, self._received_s, self._found = chain.home.copy(), 0.0, True
        self._begun = False

    def known(self) -> bool:
        """Whether all joints of the arm have been reported; the first report is the start position of the robot."""
        self._listen()
        if self._received_s and not self._begun:
            self.ik.begin(self._measured)
            self._begun = True
        return self._begun

    def posture(self) -> Posture:
        """See `Robot`."""
        self._listen()
        chain = self.ik.chain
        chain.place(self._measured)
        measured = np.array([chain.end_effector(h)[0] for h in range(chain.hands)])
        chain.place(self.ik.q)
        ends = [chain.end_effector(h) for h in range(chain.hands)]
        spheres = chain.spheres()
        spheres[:, :3] = self._place @ spheres[:, :3]
        return Posture(
            xyz_world=self._place @ np.array([xyz for xyz, _ in ends]),
            wxyz=quaternion_product(self._place.wxyz, np.array([wxyz for _, wxyz in ends])),
            measured_xyz_world=self._place @ measured,
            q=self.ik.q,
            spheres_world=spheres,
            fault=self._fault(),
        )

    def pace(self) -> float:
        """See `Robot`."""
        return self.ik.pace()

    def reaches(self, goal: Goal, dt_s: float) -> bool:
        """See `Robot`."""
        self._found = self.ik.solve(self._back @ goal.xyz_world, quaternion_product(conjugate(self._place.wxyz), goal.wxyz), dt_s)
        return self._found and self.ik.follows

    def carry_out(self, goal: Goal, dt_s: float) -> None:
        """See `Robot`."""
        step = self.ik.take() if self._found and not goal.stands else self.ik.rest()
        t_ns, arm = time.time_ns(), self.ik.chain.arm
        self._node.publish(self._arm, self._arm_message(step[arm] / dt_s, dt_s, t_ns), t_ns)
        if self._base is not None:
            velocity, rate = _base_velocity(self.ik.q[~arm], step[~arm] / dt_s)
            both = np.concatenate([velocity, rate])
            base = twist_stamped(t_ns, self._plan.base_frame, both) if self._plan.stamped else twist(both)
            self._node.publish(self._base, base, t_ns)

    def close(self) -> None:
        """See `Robot`."""
        self._node.close()

    def _arm_message(self, rates: Array, dt_s: float, t_ns: int) -> Any:
        chain = self.ik.chain
        q = self.ik.q[chain.arm]
        if self._arm.type_name == "std_msgs/msg/Float64MultiArray":
            layout = message("std_msgs/msg/MultiArrayLayout", dim=[], data_offset=0)
            return message(self._arm.type_name, layout=layout, data=q)
        ahead_s = _AHEAD_PERIODS * dt_s
        point = message(
            "trajectory_msgs/msg/JointTrajectoryPoint",
            positions=q + rates * (ahead_s - dt_s),
            velocities=rates,
            accelerations=np.zeros(0),
            effort=np.zeros(0),
            time_from_start=message("builtin_interfaces/msg/Duration", sec=0, nanosec=round(ahead_s * 1e9)),
        )
        names = [name for name, arm in zip(chain.names, chain.arm, strict=True) if arm]
        return message(self._arm.type_name, header=header(t_ns, ""), joint_names=names, points=[point])

    def _listen(self) -> None:
        names, newest = self.ik.chain.names, self._measured.copy()
        for msg in self._states.take():
            places = dict(zip(msg.name, msg.position, strict=False))
            needed = [name for name, arm in zip(names, self.ik.chain.arm, strict=True) if arm]
            if not all(name in places and np.isfinite(places[name]) for name in needed):
                continue
            for i, name in enumerate(names):
                newest[i] = places.get(name, newest[i])
            self._received_s = time.monotonic()
        self._measured = newest

    def _fault(self) -> str:
        if time.monotonic() - self._received_s > _STATE_S:
            return f"nothing on {self.needs} for {_STATE_S:g} s"
        arm = self.ik.chain.arm
        off = float(np.abs(self._measured - self.ik.q)[arm].max())
        return f"a joint is {off:.2f} rad from its commanded position" if off > _FOLLOWS_RAD else ""


class RosCartesian:
    """Poses or twists for a controller with its own inverse kinematics (`protocol.Robot`). needs: the source of its position."""

    def __init__(self, node: Any, plan: RosPlan, command: str, frames: tuple[str, ...], place: SE3) -> None:
        self._node, self._plan, self._frames, self._place = node, plan, frames, place
        self._back, self._tree, self._received_s = place.inverse(), Frames(), 0.0
        self.needs = f"{TF.name} from {plan.base_frame} to {', '.join(frames)}"
        self._inboxes = [_Inbox(node, TF), _Inbox(node, TF_STATIC)]
        kind = "PoseStamped" if command == "pose" else "TwistStamped"
        name = "target" if command == "pose" else "twist"
        root = plan.namespace.rstrip("/")
        self._topics = [Topic(f"{root}/{frame}/{name}", f"geometry_msgs/msg/{kind}", depth=1) for frame in frames]
        self._twists = command == "twist"
        self._goal: Goal | None = None

    def known(self) -> bool:
        """Whether tf has the poses of all end effectors."""
        return self._ends() is not None

    def posture(self) -> Posture:
        """See `Robot`: commanded is where it was sent last, and where it is before that."""
        ends = self._ends()
        if ends is None:
            raise SourceError(f"robot: {self.needs} is not known")
        measured, wxyz = ends
        goal = self._goal
        fault = f"nothing new on {TF.name} for {_STATE_S:g} s" if time.monotonic() - self._received_s > _STATE_S else ""
        return Posture(
            xyz_world=measured if goal is None else goal.xyz_world,
            wxyz=wxyz if goal is None else goal.wxyz,
            measured_xyz_world=measured,
            spheres_world=np.concatenate([_row_of_spheres(self._place.xyz, end) for end in measured]),
            fault=fault,
        )

    def pace(self) -> float:
        """See `Robot`: singularities are the controller's business."""
        return 1.0

    def reaches(self, goal: Goal, dt_s: float) -> bool:
        """See `Robot`."""
        return True

    def carry_out(self, goal: Goal, dt_s: float) -> None:
        """See `Robot`."""
        self._goal = goal
        t_ns, turn = time.time_ns(), self._back.matrix()
        for h, topic in enumerate(self._topics):
            if self._twists:
                rates = np.concatenate([turn @ goal.velocity_world[h], turn @ goal.turn_rate_world[h]])
                msg = twist_stamped(t_ns, self._plan.base_frame, rates)
            else:
                wxyz = quaternion_product(self._back.wxyz, goal.wxyz[h])
                msg = pose_stamped(t_ns, self._plan.base_frame, SE3(wxyz, self._back @ goal.xyz_world[h]))
            self._node.publish(topic, msg, t_ns)

    def close(self) -> None:
        """See `Robot`."""
        self._node.close()

    def _ends(self) -> tuple[Array, Array] | None:
        """(H, 3) and (H, 4) of the end effectors in the world; None while tf does not have them."""
        for inbox in self._inboxes:
            for msg in inbox.take():
                for tf in msg.transforms:
                    with suppress(MessageError):
                        self._tree.take(tf)
                self._received_s = time.monotonic()
        places = [self._tree.find(self._plan.base_frame, frame) for frame in self._frames]
        known = [self._place @ place for place in places if place is not None]
        if len(known) != len(places):
            return None
        return np.array([place.xyz for place in known]), np.array([place.wxyz for place in known])


def _base_velocity(q: Array, rates: Array) -> tuple[Array, Array]:
    """Velocity of a planar base (x, y, yaw) in its own axes: (3,) m/s and (3,) rad/s."""
    c, s = np.cos(q[2]), np.sin(q[2])
    return np.array([c * rates[0] + s * rates[1], c * rates[1] - s * rates[0], 0.0]), np.array([0.0, 0.0, rates[2]])


def _row_of_spheres(base: Array, end: Array) -> Array:
    """A thick line from base to end effector: without a model no more is known of the robot's body."""
    share = np.linspace(0.0, 1.0, 12)[:, None]
    return np.concatenate([base + share * (end - base), np.full((12, 1), _ARM_RADIUS_M)], axis=1)
