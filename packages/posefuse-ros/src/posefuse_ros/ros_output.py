"""Everything posefuse shows in ROS: bodies after REP-155, tf, markers, cameras, diagnostics.

And what robots follow of each person: poses and velocities of head, wrists and hands, and the person as URDF.
docs/reference/messages.md lists the topics.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any, NamedTuple
from xml.sax.saxutils import quoteattr

import numpy as np

from posefuse.core import SE3, Camera, JointAngles, Pose3D, Rig
from posefuse.core.arrays import Array
from posefuse.core.skeleton import LIMB_ENDS, pick_keypoints
from posefuse.foundation.parsing import ros_name

from . import topics
from .bodies import (
    ENDS,
    LINKS,
    PARTS,
    POINTS,
    Bodies,
    Velocities,
    angle_difference,
    bodies_from_pose,
    covariance_of_parts,
    packed_poses,
    parts_from_pose,
    pose_difference,
)
from .camera_messages import info_from_camera
from .markers import camera_markers, person_markers
from .messages import (
    WORLD,
    Stages,
    header,
    joint_state,
    keypoints_seen,
    message_from_pose,
    messages_from_joints,
    optical_frame,
    point_stamped,
    pose_stamped,
    pose_with_covariance,
    region_of_interest,
    skeleton2d,
    transform,
    transforms_of_children,
    twist_stamped,
)
from .topics import Outlet, Topic
from .types import message

CAMERA_MARKERS = Topic("/posefuse/cameras", "visualization_msgs/msg/MarkerArray", depth=1, latched=True)

_BODY = LINKS.index("body")
_FORGOTTEN_AFTER_NS = 3_000_000_000
# topics of a body that are made of its links
_OF_LINKS = [part for part in topics.BODY_PARTS if part not in ("skeleton2d", "roi", "joint_angles", "urdf")]
# so often at most what viewers draw is made: eyes need less than robots
SHOWN_NS = 1_000_000_000 // 30


def body_id(person_id: int) -> str:
    """REP-155 id of a person: short, and valid as part of a ROS name."""
    return ros_name(f"p{person_id}")


class ShownTimes:
    """When to make what viewers draw: at due times, which do not move with the poses that happen to come."""

    def __init__(self) -> None:
        self._due_ns: int | None = None

    def due(self, t_ns: int) -> bool:
        """Whether it is time again at `t_ns`; then it is not before a period has passed."""
        due_ns = self._due_ns
        if due_ns is None or not -SHOWN_NS <= t_ns - due_ns < SHOWN_NS:
            due_ns = t_ns
        # a pose that comes a little early counts: due times are no more exact than the clock that poses come by
        if t_ns < due_ns - SHOWN_NS // 20:
            return False
        self._due_ns = due_ns + SHOWN_NS
        return True


class RosOutput:
    """Publishes poses to an outlet (ROS 2 node, ROS 1 node, recording), only what is wanted.

    Attributes:
        outlet: where to.
        rig: cameras to show; None when unknown. `skeleton2d` and `roi` give the view of the first.
        epoch_offset_ns: Unix epoch minus session clock, added to every stamp.
    """

    def __init__(self, outlet: Outlet, rig: Rig | None = None, epoch_offset_ns: int = 0) -> None:
        self.outlet, self.rig, self.epoch_offset_ns = outlet, rig, epoch_offset_ns
        self._tracked: tuple[str, ...] | None = None
        # bodies that are not there, whose topics still are: since when
        self._left_ns: dict[str, int] = {}
        self._markers = ShownTimes()
        self._joint_rates, self._part_rates, self._body_rates = Velocities(), Velocities(), Velocities()
        # of each body how often it was seen whole, and its mean lengths; and those of the model that is published
        self._sizes: dict[str, tuple[int, Array]] = {}
        self._models: dict[str, Array] = {}

    def start(self, t_ns: int) -> None:
        """Publish what does not change: where the cameras are and how they see."""
        if self.rig is None:
            return
        t_ns += self.epoch_offset_ns
        poses = [transform(t_ns, WORLD, optical_frame(c.name), c.cam_from_world.inverse()) for c in self.rig]
        self.outlet.publish(topics.TF_STATIC, message("tf2_msgs/msg/TFMessage", transforms=poses), t_ns)
        for camera in self.rig:
            self.outlet.publish(topics.camera_info(camera.name), info_from_camera(camera, t_ns), t_ns)
        self.outlet.publish(CAMERA_MARKERS, camera_markers(self.rig, t_ns), t_ns)

    def step(self, pose: Pose3D, joints: JointAngles | None = None, stages: Stages | None = None) -> None:
        """Publish what is subscribed to, of one time step. `joints`, if any, are of the same people; the last one is shown."""
        t_ns = pose.t_ns + self.epoch_offset_ns
        moved = {name: stage_ns + self.epoch_offset_ns for name, stage_ns in (stages or {}).items()}
        shifted = pose if t_ns == pose.t_ns else replace(pose, t_ns=t_ns)
        ids = tuple(body_id(int(person)) for person in pose.person_id)
        self._show_tracked(ids, t_ns)
        if self.outlet.wanted(topics.POSE):
            self.outlet.publish(topics.POSE, message_from_pose(shifted, moved), t_ns)
        self._show_bodies(shifted, joints, ids)
        if joints is not None and self._wanted(ids, "joint_angles"):
            for msg in messages_from_joints(joints, t_ns):
                self.outlet.publish(topics.body(body_id(msg.person_id), "joint_angles"), msg, t_ns)
        for n, one in enumerate(ids):
            if self.rig is not None and self._wanted([one], "skeleton2d", "roi"):
                self._show_view(one, shifted, n, self.rig.cameras[0])
        if self.outlet.wanted(topics.MARKERS) and self._markers.due(t_ns):
            self.outlet.publish(topics.MARKERS, person_markers(shifted), t_ns)

    def _wanted(self, ids: Sequence[str], *parts: str) -> bool:
        """Whether any of these topics of any of these bodies is wanted."""
        return any(self.outlet.wanted(topics.body(one, part)) for one in ids for part in parts)

    def _show_bodies(self, pose: Pose3D, joints: JointAngles | None, ids: Sequence[str]) -> None:
        """Frames of links and segments, the joints of the REP-155 model, and what robots follow."""
        self._show_models(pose, ids)
        frames = self.outlet.wanted(topics.TF)
        if not (frames or self._wanted(ids, *_OF_LINKS)):
            return
        bodies = bodies_from_pose(pose)
        if self._wanted(ids, "joint_states"):
            self._show_joints(pose, bodies.position_rad, ids)
        if self._wanted(ids, "position", "velocity"):
            self._show_whereabouts(pose, bodies, ids)
        if self._wanted(ids, *topics.OF_PARTS):
            self._show_parts(pose, bodies, ids)
        if not frames:
            return
        transforms = self._frames(pose, joints, ids, bodies.world_from_link)
        if transforms:
            self.outlet.publish(topics.TF, message("tf2_msgs/msg/TFMessage", transforms=transforms), pose.t_ns)

    def _show_joints(self, pose: Pose3D, positions_rad: Array, ids: Sequence[str]) -> None:
        rates = self._joint_rates.step(pose.t_ns, pose.person_id.tolist(), positions_rad, angle_difference)
        for one, position_rad, rate in zip(ids, positions_rad, rates, strict=True):
            topic = topics.body(one, "joint_states")
            if self.outlet.wanted(topic):
                self.outlet.publish(topic, joint_state(one, position_rad, rate, pose.t_ns), pose.t_ns)

    def diagnose(self, t_ns: int, status: Sequence[Any]) -> None:
        """Publish the state of cameras and stages, each a `messages.diagnostic_status`."""
        t_ns += self.epoch_offset_ns
        msg = message("diagnostic_msgs/msg/DiagnosticArray", header=header(t_ns, ""), status=list(status))
        self.outlet.publish(topics.DIAGNOSTICS, msg, t_ns)

    def _show_tracked(self, ids: tuple[str, ...], t_ns: int) -> None:
        if ids != self._tracked:
            self._left_ns |= dict.fromkeys(set(self._tracked or ()) - set(ids), t_ns)
            self._tracked = ids
            self.outlet.publish(topics.TRACKED, message("hri_msgs/msg/IdsList", header=header(t_ns, ""), ids=list(ids)), t_ns)
        # who is lost for a moment keeps the topics: making them again takes longer than that
        for one, left_ns in list(self._left_ns.items()):
            if one in ids:
                del self._left_ns[one]
            elif not 0 <= t_ns - left_ns < _FORGOTTEN_AFTER_NS:
                del self._left_ns[one]
                self._sizes.pop(one, None)
                self._models.pop(one, None)
                for part in topics.BODY_PARTS:
                    self.outlet.forget(topics.body(one, part).name)

    def _frames(self, pose: Pose3D, joints: JointAngles | None, ids: Sequence[str], world_from_link: SE3) -> list[Any]:
        """Transforms of everybody's links, then of everybody's segments; all are children of the body."""
        places = {} if joints is None else {person: n for n, person in enumerate(joints.person_id.tolist())}
        links, segments = [], []
        for n, (one, person) in enumerate(zip(ids, pose.person_id.tolist(), strict=True)):
            root = world_from_link[n, _BODY]
            if not np.isfinite(root.xyz).all():
                continue
            body, own, wxyz, xyz = f"body_{one}", places.get(person), [world_from_link.wxyz[n, 1:]], [world_from_link.xyz[n, 1:]]
            link_names, segment_names = _frame_names(one, () if joints is None or own is None else joints.segments)
            if joints is not None and own is not None:
                wxyz.append(joints.world_from_segment.wxyz[-1, own])
                xyz.append(joints.world_from_segment.xyz[-1, own])
            world_from_child = SE3(np.concatenate(wxyz), np.concatenate(xyz))
            back = root.inverse()
            # a batch of one body against all its children
            body_from_world = SE3(*(np.broadcast_to(a, (*world_from_child.batch, a.size)) for a in (back.wxyz, back.xyz)))
            body_from_child, count = body_from_world @ world_from_child, len(link_names)
            links.append(transform(pose.t_ns, WORLD, body, root))
            links += transforms_of_children(pose.t_ns, body, link_names, body_from_child[:count])
            segments += transforms_of_children(pose.t_ns, body, segment_names, body_from_child[count:])
        return links + segments

    def _show_whereabouts(self, pose: Pose3D, bodies: Bodies, ids: Sequence[str]) -> None:
        places = bodies.world_from_link[:, [_BODY]]
        rates = np.full((len(ids), 6), np.nan)
        if self._wanted(ids, "velocity"):
            rates = self._body_rates.step(pose.t_ns, pose.person_id.tolist(), packed_poses(places), pose_difference)
        for n, one in enumerate(ids):
            if np.isfinite(places.xyz[n]).all() and self._wanted([one], "position"):
                msg = point_stamped(pose.t_ns, WORLD, places.xyz[n, 0])
                self.outlet.publish(topics.body(one, "position"), msg, pose.t_ns)
            if np.isfinite(rates[n]).all() and self._wanted([one], "velocity"):
                self.outlet.publish(topics.body(one, "velocity"), twist_stamped(pose.t_ns, WORLD, rates[n]), pose.t_ns)

    def _show_parts(self, pose: Pose3D, bodies: Bodies, ids: Sequence[str]) -> None:
        parts = parts_from_pose(pose, bodies)
        rates, cov = np.full((*parts.batch, 6), np.nan), np.full((*parts.batch, 6, 6), np.nan)
        if self._wanted(ids, *(f"{part}/twist" for part in PARTS)):
            rates = self._part_rates.step(pose.t_ns, pose.person_id.tolist(), packed_poses(parts), pose_difference)
            rates = rates.reshape(*parts.batch, 6)
        if self._wanted(ids, *(f"{part}/pose_with_covariance" for part in PARTS)):
            cov = covariance_of_parts(pose, parts)
        t_ns = pose.t_ns
        sure, moving = np.isfinite(cov).all(axis=(-1, -2)), np.isfinite(rates).all(axis=-1)
        for n, p in np.argwhere(np.isfinite(parts.xyz).all(axis=-1)).tolist():
            in_pose, in_cov, in_twist = (topics.body(ids[n], f"{PARTS[p]}/{what}") for what in topics.PART_TOPICS)
            here = parts[n, p]
            if self.outlet.wanted(in_pose):
                self.outlet.publish(in_pose, pose_stamped(t_ns, WORLD, here), t_ns)
            if sure[n, p] and self.outlet.wanted(in_cov):
                self.outlet.publish(in_cov, pose_with_covariance(t_ns, WORLD, here, cov[n, p]), t_ns)
            if moving[n, p] and self.outlet.wanted(in_twist):
                self.outlet.publish(in_twist, twist_stamped(t_ns, WORLD, rates[n, p]), t_ns)

    def _show_models(self, pose: Pose3D, ids: Sequence[str]) -> None:
        """A model of a person is latched, so it is made whether or not there are subscribers now."""
        lengths = sizes_from_points(pick_keypoints(pose.xyz_world, pose.skeleton, POINTS))
        for one, new in zip(ids, lengths, strict=True):
            if not np.isfinite(new).all():
                continue
            count, mean = self._sizes.get(one, (0, np.zeros(len(new))))
            count = min(count + 1, _SIZE_MEMORY)
            mean = mean + (new - mean) / count
            self._sizes[one] = count, mean
            if count < _SEEN_FOR_MODEL:
                continue
            before = self._models.get(one)
            if before is None or np.abs(mean - before).max() > _MODEL_CHANGED_M:
                self._models[one] = mean
                text = message("std_msgs/msg/String", data=urdf_text(one, Sizes(*mean.tolist())))
                self.outlet.publish(topics.body(one, "urdf"), text, pose.t_ns)

    def _show_view(self, one: str, pose: Pose3D, n: int, camera: Camera) -> None:
        xy, inside = keypoints_seen(pose, n, camera)
        skeleton, box = topics.body(one, "skeleton2d"), topics.body(one, "roi")
        if self.outlet.wanted(skeleton):
            self.outlet.publish(skeleton, skeleton2d(xy, inside, camera, pose.t_ns), pose.t_ns)
        if self.outlet.wanted(box):
            self.outlet.publish(box, region_of_interest(xy[inside], camera, pose.t_ns), pose.t_ns)


@lru_cache(maxsize=256)
def _frame_names(one: str, segments: tuple[str, ...]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """tf names of the links of a body, the root excepted, and of its segments."""
    links = tuple(f"{name}_{one}" for name in LINKS if name != LINKS[_BODY])
    return links, tuple(f"segment_{ros_name(name)}_{one}" for name in segments)


_LIMIT = '<limit lower="-6.2832" upper="6.2832" effort="10" velocity="50"/>'
_RADIUS_M = 0.04
# a model is published when a person was seen whole so often, and again when a length has changed
_SEEN_FOR_MODEL, _MODEL_CHANGED_M, _SIZE_MEMORY = 30, 0.02, 300


def _ends(*pairs: tuple[str, str]) -> Array:
    """(n, 2) places of the ends in `ENDS`."""
    return np.array([[ENDS.index(part) for part in pair] for pair in pairs])


# ends of the lengths of `Sizes`: between the middles of both sides, between the sides, and on each side
_TRUNK = _ends(("shoulder", "hip"), ("ear", "shoulder"))
_ACROSS = [ENDS.index("shoulder"), ENDS.index("hip")]
_LIMBS = _ends(*LIMB_ENDS.values())


class Sizes(NamedTuple):
    """Lengths of a person in metres.

    Attributes:
        torso: middle of the hips to the middle of the shoulders. head: from there up to the middle of the ears.
        shoulder, hip: half the distance of both. upper_arm, forearm, thigh, shank: between the joints.
    """

    torso: float
    head: float
    shoulder: float
    hip: float
    upper_arm: float
    forearm: float
    thigh: float
    shank: float


def sizes_from_points(points: Array) -> Array:
    """(N, 8) lengths in the order of `Sizes` from keypoints (N, len(POINTS), 3); both sides' mean, NaN where not seen."""
    sides = points[:, : 2 * len(ENDS)].reshape(-1, len(ENDS), 2, 3)
    left, right = sides[:, :, 0], sides[:, :, 1]
    middle = (left + right) / 2
    trunk = middle[:, _TRUNK[:, 0]] - middle[:, _TRUNK[:, 1]]
    limbs = sides[:, _LIMBS[:, 0]] - sides[:, _LIMBS[:, 1]]
    across = left[:, _ACROSS] - right[:, _ACROSS]
    lengths = np.linalg.norm(np.concatenate([trunk, across, limbs[:, :, 0], limbs[:, :, 1]], axis=1), axis=-1)
    # a half of what is across, and the mean of both sides
    both = (lengths[:, 4:8] + lengths[:, 8:]) / 2
    return np.concatenate([lengths[:, :2], lengths[:, 2:4] / 2, both], axis=-1)


def urdf_text(body: str, sizes: Sizes) -> str:
    """The model of the body with id `body`, e.g. ``p3``."""
    s = sizes
    parts = [_link("body", body), _joint("waist", body, "body", "torso", (0, 0, s.torso), (0, 0, 1)), _link("torso", body)]
    up = (0.0, 0.0, s.torso + s.head)
    parts += _chain(body, "body", "head", up, (("r_head", (1, 0, 0)), ("y_head", (0, 0, 1)), ("p_head", (0, -1, 0))), 0.0)
    for side, sign in (("l", 1.0), ("r", -1.0)):
        arm, leg = ((0, 0, -sign), (sign, 0, 0), (0, 0, sign)), ((0, 0, -1), (sign, 0, 0), (0, -1, 0))
        for upper, lower, end, xyz, axes, upper_m, lower_m in (
            ("shoulder", "elbow", "wrist", (0, sign * s.shoulder, s.torso), arm, s.upper_arm, s.forearm),
            ("hip", "knee", "ankle", (0, sign * s.hip, 0), leg, s.thigh, s.shank),
        ):
            turns = tuple((f"{side}_{turn}_{upper}", axis) for turn, axis in zip("ypr", axes, strict=True))
            above, below, last = (f"{side}_{name}" for name in (upper, lower, end))
            parts += _chain(body, "body", above, xyz, turns, upper_m)
            parts += [
                _joint(below, body, above, below, (0, 0, -upper_m), (0, -1, 0)),
                _link(below, body, lower_m),
                _joint(f"{last}_fixed", body, below, last, (0, 0, -lower_m), None),
                _link(last, body),
            ]
    return f'<?xml version="1.0"?>\n<robot name={quoteattr(f"human_{body}")}>\n' + "\n".join(parts) + "\n</robot>\n"


def _chain(body: str, parent: str, link: str, xyz: tuple[float, ...], turns: Turns, length_m: float) -> list[str]:
    """Three turning joints at one place, and the link that they turn."""
    found, above = [], parent
    for i, (name, axis) in enumerate(turns):
        last = i == len(turns) - 1
        below = link if last else f"{name}_link"
        found += [
            _joint(name, body, above, below, xyz if i == 0 else (0, 0, 0), axis),
            _link(below, body, length_m if last else 0.0),
        ]
        above = below
    return found


Turns = tuple[tuple[str, tuple[float, float, float]], ...]


def _joint(name: str, body: str, parent: str, child: str, xyz: tuple[float, ...], axis: tuple[float, ...] | None) -> str:
    where = " ".join(f"{v:.4f}" for v in xyz)
    turning = f'<axis xyz="{" ".join(f"{v:g}" for v in axis)}"/>{_LIMIT}' if axis else ""
    return (
        f'<joint name="{name}_{body}" type="{"revolute" if axis else "fixed"}"><parent link="{parent}_{body}"/>'
        f'<child link="{child}_{body}"/><origin xyz="{where}" rpy="0 0 0"/>{turning}</joint>'
    )


def _link(name: str, body: str, length_m: float = 0.0) -> str:
    if not length_m:
        return f'<link name="{name}_{body}"/>'
    shape = f'<cylinder radius="{_RADIUS_M}" length="{length_m:.4f}"/>'
    middle = f'<origin xyz="0 0 {-length_m / 2:.4f}" rpy="0 0 0"/>'
    return f'<link name="{name}_{body}"><visual>{middle}<geometry>{shape}</geometry></visual></link>'
