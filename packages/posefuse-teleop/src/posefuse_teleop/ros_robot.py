"""A real robot over ROS 2: the same limited motion as messages of usual controllers.

| command | message | for |
|---|---|---|
| pose | geometry_msgs/PoseStamped | Cartesian controllers, MoveIt Servo (``pose_target_cmds``) |
| joints | trajectory_msgs/JointTrajectory; cmd_vel of a base | our own inverse kinematics |

Where the robot is comes from ``/joint_states`` (joints) or ``/tf`` (pose). While it is not known, or not where it was
commanded, the robot has a fault.
"""

from __future__ import annotations

import time
from collections.abc import Collection, Sequence
from contextlib import ExitStack, suppress
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from posefuse.core import SE3, ConfigError, MessageError, SourceError
from posefuse.core.arrays import Array
from posefuse.core.se3 import quaternion_product
from posefuse_ros.messages import header, ns_from_time, pose_stamped, twist, twist_stamped
from posefuse_ros.topics import TF, TF_STATIC, Topic
from posefuse_ros.types import decode, message

from .follower import FOLLOWS_M, FOLLOWS_RAD, Follower
from .joints import Joints
from .kinematics import Chain
from .mapping import rotvec_between
from .mujoco_robot import mujoco_model, placed
from .ros import NAMESPACE
from .settings import LimitSettings, RosPlan, TeleoperationSettings
from .values import RobotState

_MOST_FRAMES = 2000
# a quaternion shorter than this is a field that was left out, not a rotation
_LEAST_NORM = 0.5


class Frames:
    """The tree of frames received so far; a frame has one parent, the newest. Names count without a leading slash."""

    def __init__(self) -> None:
        self._parents: dict[str, tuple[str, SE3]] = {}

    def take(self, tf: Any) -> None:
        """One `geometry_msgs/TransformStamped`; raises MessageError for one that is not finite or has no rotation."""
        q, p = tf.transform.rotation, tf.transform.translation
        numbers = np.array([q.w, q.x, q.y, q.z, p.x, p.y, p.z])
        if not (np.isfinite(numbers).all() and np.linalg.norm(numbers[:4]) > _LEAST_NORM):
            raise MessageError(f"tf of {tf.child_frame_id}: expected finite numbers and a unit quaternion")
        self.add(tf.header.frame_id, tf.child_frame_id, SE3(numbers[:4], numbers[4:]))

    def add(self, parent: str, child: str, parent_from_child: SE3) -> None:
        """One transform."""
        child = child.lstrip("/")
        if child in self._parents or len(self._parents) < _MOST_FRAMES:
            self._parents[child] = parent.lstrip("/"), parent_from_child

    def find(self, target: str, source: str) -> SE3 | None:
        """target_from_source, or None where no chain of transforms joins them."""
        up, down = self._to_root(source.lstrip("/")), self._to_root(target.lstrip("/"))
        for frame, root_from_source in up.items():
            if frame in down:
                return down[frame].inverse() @ root_from_source
        return None

    def path(self, target: str, source: str) -> frozenset[str]:
        """The child frames of the transforms that join two frames."""
        return frozenset(self._upwards(source.lstrip("/"))) ^ frozenset(self._upwards(target.lstrip("/")))

    def _to_root(self, frame: str) -> dict[str, SE3]:
        """From a frame up: every frame on the path, and where the first one is in it."""
        found = {frame: SE3.identity()}
        for child, parent in pairwise(self._upwards(frame)):
            found[parent] = self._parents[child][1] @ found[child]
        return found

    def _upwards(self, frame: str) -> list[str]:
        """A frame, its parent and so on; a circle ends before it closes."""
        found = [frame]
        while frame in self._parents and (frame := self._parents[frame][0]) not in found:
            found.append(frame)
        return found


JOINT_STATES = "/joint_states"
_MOST_BYTES = 1_000_000
# the robot's own state may be so old, and the wait for the first one so long
_STATE_S, _FIRST_S = 0.2, 10.0
# another program that drives the robot is found on the network by then
_OTHERS_S = 1.0
# a node that leaves at once may take its last message with it
_SENT_S = 0.05
_ARM_RADIUS_M = 0.15
# a point of a trajectory lies so many control periods ahead, so that the next one comes in time
_AHEAD_PERIODS = 2
# and a trajectory so long, longer than any stop
_STAYS_S = 0.4


def open_ros_robot(
    command: str, plan: RosPlan, model: Path | None, frames: Sequence[str], settings: TeleoperationSettings
) -> RosJoints | RosCartesian:
    """A robot whose first state has come.

    Raises:
        SourceError: no state comes, or another program drives it. ConfigError: a model that does not fit.
    """
    place = placed(settings.robot.position_xy_m, settings.robot.heading_deg)
    # refused before anything of it is on the network
    chain = _chain(model, frames, settings) if command == "joints" else None
    robot: RosJoints | RosCartesian
    with ExitStack() as refused:
        node = plan.node("posefuse_robot")
        refused.callback(node.close)
        if chain is not None:
            robot = RosJoints(node, plan, chain, settings.limits, place)
        else:
            robot = RosCartesian(node, plan, tuple(frames), place)
        begun_s = time.monotonic()
        while time.monotonic() < begun_s + (_OTHERS_S if robot.known() else _FIRST_S):
            time.sleep(0.02)
        if not robot.known():
            raise SourceError(f"robot: nothing of {robot.needs} came within {_FIRST_S:g} s")
        for topic in robot.commands & set(node.topics()):
            raise SourceError(f"robot: another program sends {topic}; end it first, a robot cannot follow two")
        refused.pop_all()
    return robot


def _chain(model: Path | None, frames: Sequence[str], settings: TeleoperationSettings) -> Chain:
    if model is None:
        raise ConfigError("--command joints: expected --robot FILE.xml, the model by which its joints are known")
    return Chain(mujoco_model(model, settings.hands), frames, settings.limits.collision_m)


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


class _Renewals:
    """When each sender last reported something new: a message with the stamp of the one before does not count.

    Messages without a stamp (0) cannot be compared: each counts.
    """

    def __init__(self) -> None:
        self._stamps: dict[str, int] = {}
        self._new_s: dict[str, float] = {}
        # stamp less this computer's clock
        self._off_s: dict[str, float] = {}

    def take(self, name: str, stamp: Any) -> None:
        """One message's stamp."""
        stamp_ns = ns_from_time(stamp)
        if stamp_ns == 0 or stamp_ns != self._stamps.get(name):
            self._stamps[name], self._new_s[name] = stamp_ns, time.monotonic()
            if stamp_ns:
                self._off_s[name] = (stamp_ns - time.time_ns()) / 1e9

    def fault(self, names: Collection[str], words: str) -> str:
        """What is wrong with the newest reports of `names`; empty: nothing.

        Args:
            words: where they come from.
        """
        known = [self._new_s[name] for name in names if name in self._new_s]
        if not known or time.monotonic() - min(known) > _STATE_S:
            return f"nothing new of {words} for {_STATE_S:g} s"
        # of several the one that agrees best: some programs stamp transforms for later
        off_s = min((self._off_s[name] for name in names if name in self._off_s), key=abs, default=0.0)
        if abs(off_s) > _STATE_S:
            way = "ahead of" if off_s > 0 else "behind"
            return f"stamps of {words} are {abs(off_s):.1f} s {way} this computer's clock: set both clocks by NTP or PTP"
        return ""


class RosJoints:
    """Joint commands from our own inverse kinematics (`follower.Robot`).

    Attributes:
        needs: the topic with the joint states. commands: names of topics that no other program may send.
    """

    def __init__(self, node: Any, plan: RosPlan, chain: Chain, limits: LimitSettings, place: SE3) -> None:
        self._node, self._plan = node, plan
        self.joints, self.needs = Joints(chain, limits, place), JOINT_STATES
        self._states = _Inbox(node, Topic(JOINT_STATES, "sensor_msgs/msg/JointState", depth=5))
        self._arm = Topic(plan.controller, "trajectory_msgs/msg/JointTrajectory", depth=1)
        # of a base there may be others, e.g. for navigation while the robot stands
        self.commands = {plan.controller}
        vel_type = "geometry_msgs/msg/TwistStamped" if plan.stamped else "geometry_msgs/msg/Twist"
        self._base = Topic(plan.cmd_vel, vel_type, depth=1) if plan.cmd_vel else None
        if not chain.arm.all() and self._base is None:
            raise ConfigError("--command joints: the model has a mobile base; expected --cmd-vel TOPIC for it")
        self._reported, self._renewals, self._begun = np.full(len(chain.home), np.nan), _Renewals(), False

    def known(self) -> bool:
        """Whether all joints of the arm have been reported; the first report is the start position of the robot."""
        self._listen()
        if np.isfinite(self._reported).any() and not self._begun:
            self.joints.begin(self._measured)
            self._begun = True
        return self._begun

    def state(self) -> RobotState:
        """See `Robot`."""
        self._listen()
        return self.joints.state(self._measured, self._renewals.fault([self.needs], self.needs))

    def move(self, wanted: Follower, dt_s: float, left_out: int = 0) -> None:
        """See `Robot`."""
        if left_out:
            # the arm followed its last trajectory meanwhile: one that began where that did would throw it back
            self.joints.coast(left_out, dt_s)
        q, rates = self.joints.follow(wanted, dt_s, 0), self.joints.step / dt_s
        t_ns, arm = time.time_ns(), self.joints.chain.arm
        self._node.publish(self._arm, self._arm_message(q[arm], rates[arm], dt_s, t_ns), t_ns)
        self._move_base(_base_velocity(q[~arm], rates[~arm]) if self._base is not None else np.zeros(6))

    def close(self) -> None:
        """See `Robot`; the base gets zero velocity, and the last trajectory ends at rest."""
        try:
            if self._begun:
                self._begun = False
                self._move_base(np.zeros(6))
                time.sleep(_SENT_S)
        finally:
            self._node.close()

    @property
    def _measured(self) -> Array:
        """(n,) joints; those that no message reports, e.g. of a base, count as commanded."""
        return np.where(np.isfinite(self._reported), self._reported, self.joints.q)

    def _move_base(self, rates: Array) -> None:
        if self._base is not None:
            t_ns = time.time_ns()
            base = twist_stamped(t_ns, self._plan.base_frame, rates) if self._plan.stamped else twist(rates)
            self._node.publish(self._base, base, t_ns)

    def _arm_message(self, q: Array, rates: Array, dt_s: float, t_ns: int) -> Any:
        chain, ahead_s = self.joints.chain, _AHEAD_PERIODS * dt_s
        ahead = q + rates * (ahead_s - dt_s)
        # a controller that gets nothing more stops there; those of ros2_control take no trajectory that ends in motion
        rest, steps = self.joints.resting()
        rest = rest[chain.arm] + rates * (ahead_s - dt_s)
        # and stays there, so that a message that comes late does not end in the past
        points = [_point(ahead, rates, ahead_s)]
        points += [_point(rest, np.zeros_like(rates), ahead_s + after_s) for after_s in (max(steps, 1) * dt_s, _STAYS_S)]
        names = [name for name, arm in zip(chain.names, chain.arm, strict=True) if arm]
        return message(self._arm.type_name, header=header(t_ns, ""), joint_names=names, points=points)

    def _listen(self) -> None:
        names = self.joints.chain.names
        needed = [name for name, arm in zip(names, self.joints.chain.arm, strict=True) if arm]
        for msg in self._states.take():
            places = dict(zip(msg.name, msg.position, strict=False))
            if not all(name in places and np.isfinite(places[name]) for name in needed):
                continue
            self._reported = np.array([places.get(name, np.nan) for name in names])
            self._renewals.take(self.needs, msg.header.stamp)


class RosCartesian:
    """Poses for a controller with its own inverse kinematics (`follower.Robot`).

    Attributes:
        needs: the source of its position. commands: names of topics that no other program may send.

    Singularities are that controller's business: it may always be as fast as the limit.
    """

    def __init__(self, node: Any, plan: RosPlan, frames: tuple[str, ...], place: SE3) -> None:
        self._node, self._plan, self._frames, self._place = node, plan, frames, place
        self._back, self._tree, self._renewals = place.inverse(), Frames(), _Renewals()
        self.needs = f"{TF.name} from {plan.base_frame} to {', '.join(frames)}"
        self._inboxes = [_Inbox(node, TF), _Inbox(node, TF_STATIC)]
        self._topics = [Topic(f"{NAMESPACE}/{frame}/target", "geometry_msgs/msg/PoseStamped", depth=1) for frame in frames]
        self.commands = {topic.name for topic in self._topics}
        self._wanted: Follower | None = None
        self._joining = frozenset[str]()

    def known(self) -> bool:
        """Whether tf has the poses of all end effectors."""
        return self._ends() is not None

    def state(self) -> RobotState:
        """See `Robot`: commanded is where it was sent last; where it is before that."""
        ends = self._ends()
        if ends is None:
            raise SourceError(f"robot: {self.needs} is not known")
        measured, wanted = ends[0], self._wanted
        xyz, wxyz = ends if wanted is None else (wanted.xyz, wanted.wxyz)
        return RobotState(
            xyz_world=xyz,
            wxyz=wxyz,
            velocity_world=np.zeros_like(measured) if wanted is None else wanted.velocity,
            turn_rate_world=np.zeros_like(measured) if wanted is None else wanted.turn_rate,
            measured_xyz_world=measured,
            spheres_world=np.concatenate([_row_of_spheres(self._place.xyz, end) for end in measured]),
            fault=self._fault(*ends),
        )

    def move(self, wanted: Follower, dt_s: float, left_out: int = 0) -> None:
        """See `Robot`."""
        self._wanted, t_ns = wanted, time.time_ns()
        for topic, xyz, wxyz in zip(self._topics, wanted.xyz, wanted.wxyz, strict=True):
            place = SE3(quaternion_product(self._back.wxyz, wxyz), self._back @ xyz)
            self._node.publish(topic, pose_stamped(t_ns, self._plan.base_frame, place), t_ns)

    def close(self) -> None:
        """See `Robot`; the last pose is one to stay at."""
        self._node.close()

    def _fault(self, xyz: Array, wxyz: Array) -> str:
        if fault := self._renewals.fault(self._joining, self.needs):
            return fault
        wanted = self._wanted
        if wanted is None:
            return ""
        far_m = float(np.linalg.norm(wanted.xyz - xyz, axis=1).max())
        turned_rad = max(float(np.linalg.norm(rotvec_between(*turn))) for turn in zip(wxyz, wanted.wxyz, strict=True))
        if far_m > FOLLOWS_M or turned_rad > FOLLOWS_RAD:
            return f"the end effector is {far_m:.2f} m and {turned_rad:.2f} rad from where it was commanded"
        return ""

    def _ends(self) -> tuple[Array, Array] | None:
        """(H, 3) and (H, 4) of the end effectors in the world; None while tf does not have them."""
        moving = [tf for msg in self._inboxes[0].take() for tf in msg.transforms]
        fixed = [tf for msg in self._inboxes[1].take() for tf in msg.transforms]
        for tf in (*moving, *fixed):
            with suppress(MessageError):
                self._tree.take(tf)
        # the robot's own transforms only: others are on the same topic
        self._joining = frozenset[str]().union(*(self._tree.path(self._plan.base_frame, frame) for frame in self._frames))
        for tf in moving:
            if (child := tf.child_frame_id.lstrip("/")) in self._joining:
                self._renewals.take(child, tf.header.stamp)
        places = [self._tree.find(self._plan.base_frame, frame) for frame in self._frames]
        known = [self._place @ place for place in places if place is not None]
        if len(known) != len(places):
            return None
        return np.array([place.xyz for place in known]), np.array([place.wxyz for place in known])


def _point(positions: Array, velocities: Array, at_s: float) -> Any:
    """One point of a joint trajectory."""
    sec, nanosec = divmod(round(at_s * 1e9), 1_000_000_000)
    return message(
        "trajectory_msgs/msg/JointTrajectoryPoint",
        positions=positions,
        velocities=velocities,
        accelerations=np.zeros(0),
        effort=np.zeros(0),
        time_from_start=message("builtin_interfaces/msg/Duration", sec=sec, nanosec=nanosec),
    )


def _base_velocity(q: Array, rates: Array) -> Array:
    """(6,) velocity of a planar base (x, y, yaw) in its own axes: m/s and rad/s."""
    c, s = np.cos(q[2]), np.sin(q[2])
    return np.array([c * rates[0] + s * rates[1], c * rates[1] - s * rates[0], 0.0, 0.0, 0.0, rates[2]])


def _row_of_spheres(base: Array, end: Array) -> Array:
    """A thick line from base to end effector: without a model no more is known of the robot's body."""
    share = np.linspace(0.0, 1.0, 12)[:, None]
    return np.concatenate([base + share * (end - base), np.full((12, 1), _ARM_RADIUS_M)], axis=1)
