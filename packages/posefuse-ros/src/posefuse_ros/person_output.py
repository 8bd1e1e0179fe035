"""What robots follow of each person: poses and velocities of head, wrists and hands, and the person as URDF."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple
from xml.sax.saxutils import quoteattr

import numpy as np

from posefuse.core import Pose3D
from posefuse.core.arrays import Array
from posefuse.core.skeleton import LIMB_ENDS, pick_keypoints

from . import topics
from .bodies import LINKS, POINTS, Bodies
from .bodies import PARTS as ENDS
from .body_messages import point_stamped, pose_stamped, pose_with_covariance, twist_stamped
from .parts import PARTS, Velocities, covariance_of_parts, packed_poses, parts_from_pose, pose_difference
from .topics import Outlet
from .types import message

_LIMIT = '<limit lower="-6.2832" upper="6.2832" effort="10" velocity="50"/>'
_RADIUS_M = 0.04
# a model is published when a person was seen whole so often, and again when a length has changed
_SEEN_FOR_MODEL, _MODEL_CHANGED_M, _SIZE_MEMORY = 30, 0.02, 300
_BODY = LINKS.index("body")


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


@dataclass
class PersonOutput:
    """Publishes to an outlet, only what is wanted.

    Attributes:
        outlet: where to. world_frame: what all is expressed in.
    """

    outlet: Outlet
    world_frame: str
    _part_rates: Velocities = field(default_factory=Velocities)
    _body_rates: Velocities = field(default_factory=Velocities)
    _sizes: dict[str, tuple[int, Array]] = field(default_factory=dict)
    _models: dict[str, Array] = field(default_factory=dict)

    def forget(self, one: str) -> None:
        """A body has left."""
        self._sizes.pop(one, None)
        self._models.pop(one, None)

    def step(self, pose: Pose3D, bodies: Bodies, ids: Sequence[str]) -> None:
        """One pose, its outgoing stamp, and the bodies derived from it."""
        self._show_whereabouts(pose, bodies, ids)
        if any(self._parts_wanted(ids, what) for what in topics.PART_TOPICS):
            self._show_parts(pose, bodies, ids)

    def _wanted(self, one: str, part: str) -> bool:
        return self.outlet.wanted(topics.body(one, part))

    def _parts_wanted(self, ids: Sequence[str], what: str) -> bool:
        return any(self._wanted(one, f"{part}/{what}") for one in ids for part in PARTS)

    def _show_whereabouts(self, pose: Pose3D, bodies: Bodies, ids: Sequence[str]) -> None:
        if not any(self._wanted(one, what) for one in ids for what in ("position", "velocity")):
            return
        places = bodies.world_from_link[:, [_BODY]]
        rates = np.full((len(ids), 6), np.nan)
        if any(self._wanted(one, "velocity") for one in ids):
            rates = self._body_rates.step(pose.t_ns, pose.person_id.tolist(), packed_poses(places), pose_difference)
        for n, one in enumerate(ids):
            if np.isfinite(places.xyz[n]).all() and self._wanted(one, "position"):
                msg = point_stamped(pose.t_ns, self.world_frame, places.xyz[n, 0])
                self.outlet.publish(topics.body(one, "position"), msg, pose.t_ns)
            if np.isfinite(rates[n]).all() and self._wanted(one, "velocity"):
                self.outlet.publish(topics.body(one, "velocity"), twist_stamped(pose.t_ns, self.world_frame, rates[n]), pose.t_ns)

    def _show_parts(self, pose: Pose3D, bodies: Bodies, ids: Sequence[str]) -> None:
        parts = parts_from_pose(pose, bodies)
        rates, cov = np.full((*parts.batch, 6), np.nan), np.full((*parts.batch, 6, 6), np.nan)
        if self._parts_wanted(ids, "twist"):
            rates = self._part_rates.step(pose.t_ns, pose.person_id.tolist(), packed_poses(parts), pose_difference)
            rates = rates.reshape(*parts.batch, 6)
        if self._parts_wanted(ids, "pose_with_covariance"):
            cov = covariance_of_parts(pose, parts)
        frame, t_ns = self.world_frame, pose.t_ns
        sure, moving = np.isfinite(cov).all(axis=(-1, -2)), np.isfinite(rates).all(axis=-1)
        for n, p in np.argwhere(np.isfinite(parts.xyz).all(axis=-1)).tolist():
            in_pose, in_cov, in_twist = (topics.body(ids[n], f"{PARTS[p]}/{what}") for what in topics.PART_TOPICS)
            here = parts[n, p]
            if self.outlet.wanted(in_pose):
                self.outlet.publish(in_pose, pose_stamped(t_ns, frame, here), t_ns)
            if sure[n, p] and self.outlet.wanted(in_cov):
                self.outlet.publish(in_cov, pose_with_covariance(t_ns, frame, here, cov[n, p]), t_ns)
            if moving[n, p] and self.outlet.wanted(in_twist):
                self.outlet.publish(in_twist, twist_stamped(t_ns, frame, rates[n, p]), t_ns)

    def show_models(self, pose: Pose3D, ids: Sequence[str]) -> None:
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
