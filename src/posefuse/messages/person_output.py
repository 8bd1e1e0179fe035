"""What robots follow of each person: poses and velocities of head, wrists and hands, where the person is, and a model of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from posefuse.core import SE3, Pose3D
from posefuse.core.arrays import Array
from posefuse.core.skeleton import pick_keypoints

from . import topics
from .bodies import LINKS, POINTS, Bodies
from .body_messages import point_stamped, pose_stamped, pose_with_covariance, twist_stamped
from .parts import PARTS, PartPoses, parts_from_pose
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
        outlet: where to. world_frame: of position and velocity, and of the parts where there is no other frame.
        base_frame: frame the parts are expressed in; empty: the world.
        base_from_world: where the world is in that frame; None while no one knows: no parts are published.
    """

    outlet: Outlet
    world_frame: str
    base_frame: str = ""
    base_from_world: SE3 | None = None
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
        wanted = [one for one in ids if any(self._wanted(one, f"{part}/{what}") for part in PARTS for what in topics.PART_TOPICS)]
        if wanted:
            self._show_parts(pose, ids)

    def _wanted(self, one: str, part: str) -> bool:
        return self.outlet.wanted(topics.body(one, part))

    def _show_whereabouts(self, pose: Pose3D, bodies: Bodies, ids: Sequence[str]) -> None:
        if not any(self._wanted(one, what) for one in ids for what in ("position", "velocity")):
            return
        places = bodies.world_from_link[:, [_BODY]]
        rates = self._body_rates.step(pose.t_ns, pose.person_id.tolist(), packed_poses(places), pose_difference)
        for n, one in enumerate(ids):
            if np.isfinite(places.xyz[n]).all() and self._wanted(one, "position"):
                msg = point_stamped(pose.t_ns, self.world_frame, places.xyz[n, 0])
                self.outlet.publish(topics.body(one, "position"), msg, pose.t_ns)
            if np.isfinite(rates[n]).all() and self._wanted(one, "velocity"):
                self.outlet.publish(topics.body(one, "velocity"), twist_stamped(pose.t_ns, self.world_frame, rates[n]), pose.t_ns)

    def _show_parts(self, pose: Pose3D, ids: Sequence[str]) -> None:
        if self.base_frame and self.base_from_world is None:
            return
        parts = parts_from_pose(pose)
        packed = packed_poses(parts.world_from_part)
        rates = self._part_rates.step(pose.t_ns, pose.person_id.tolist(), packed, pose_difference)
        frame = self.base_frame or self.world_frame
        there = self.base_from_world or SE3.identity()
        for n, one in enumerate(ids):
            for p, part in enumerate(PARTS):
                self._show_part(pose.t_ns, f"{part}/", (one, frame, there), parts, (n, p), rates[n].reshape(-1, 6)[p])

    def _show_part(
        self, t_ns: int, part: str, to: tuple[str, str, SE3], parts: PartPoses, place: tuple[int, int], rate: Array
    ) -> None:
        one, frame, base_from_world = to
        part_world = parts.world_from_part[place]
        if not np.isfinite(part_world.wxyz).all():
            return
        pose, turn = base_from_world @ part_world, base_from_world.matrix()
        if self._wanted(one, f"{part}pose"):
            self.outlet.publish(topics.body(one, f"{part}pose"), pose_stamped(t_ns, frame, pose), t_ns)
        cov, topic = parts.cov[place], topics.body(one, f"{part}pose_with_covariance")
        if np.isfinite(cov).all() and self.outlet.wanted(topic):
            both = np.kron(np.eye(2), turn)
            self.outlet.publish(topic, pose_with_covariance(t_ns, frame, pose, both @ cov @ both.T), t_ns)
        topic = topics.body(one, f"{part}twist")
        if np.isfinite(rate).all() and self.outlet.wanted(topic):
            turned = np.concatenate([turn @ rate[:3], turn @ rate[3:]])
            self.outlet.publish(topic, twist_stamped(t_ns, frame, turned), t_ns)

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
