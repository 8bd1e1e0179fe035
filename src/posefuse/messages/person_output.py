"""What robots follow of each person: poses and velocities of head, wrists and hands, where the person is, and a model of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from posefuse.core import Pose3D
from posefuse.core.arrays import Array
from posefuse.core.skeleton import pick_keypoints

from . import topics
from .bodies import LINKS, POINTS, Bodies
from .body_messages import point_stamped, pose_stamped, pose_with_covariance, twist_stamped
from .parts import PARTS, covariance_of_parts, parts_from_pose
from .topics import Outlet
from .types import message
from .urdf import Sizes, sizes_from_points, urdf_text
from .velocities import Velocities, packed_poses, pose_difference

# a model is published when a person was seen whole so often, and again when a length has changed
_SEEN_FOR_MODEL, _MODEL_CHANGED_M, _SIZE_MEMORY = 30, 0.02, 300
_BODY = LINKS.index("body")


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
    _models: dict[str, Sizes] = field(default_factory=dict)

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
            sizes, before = Sizes(*mean.tolist()), self._models.get(one)
            if before is None or sizes.differs(before, _MODEL_CHANGED_M):
                self._models[one] = sizes
                text = message("std_msgs/msg/String", data=urdf_text(one, sizes))
                self.outlet.publish(topics.body(one, "urdf"), text, pose.t_ns)
