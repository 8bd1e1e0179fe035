"""Meshes of the people of a live session, as messages: made and moved only while a page shows them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from posefuse.core import JointAngles, Pose3D
from posefuse.kinematics.skin import MovingSkin

from .scene.messages import PlacedBody, bodies_message, mesh_message

# a person who is lost for a moment keeps the mesh
_KEPT_NS = 5_000_000_000
_REVISIONS = 2**16


@dataclass
class _Body:
    slot: int
    skin: MovingSkin = field(default_factory=MovingSkin)
    made: int = 0
    revision: int = 0
    seen_ns: int = 0


class LiveBodies:
    """A mesh per person, in as few slots as there are people at a time."""

    def __init__(self) -> None:
        self._bodies: dict[int, _Body] = {}
        self._revision = 0

    def step(
        self, t_s: float, pose: Pose3D, joints: JointAngles, rgba: Sequence[Sequence[int]]
    ) -> tuple[dict[int, bytes], bytes]:
        """Messages of one time step: meshes that are new, by slot, and where the bodies are.

        Args:
            pose: N people. joints: their angles (T = 1). rgba: (N, 4) colours.
        """
        self._forget(pose.t_ns)
        meshes, placed = {}, []
        for n, person in enumerate(pose.person_id.tolist()):
            body = self._body_of(person, pose.t_ns)
            matrices = body.skin.step(pose.people(np.array([n])), joints.of(person))
            if body.skin.skin is not None and body.made != body.skin.revision:
                self._revision = (self._revision + 1) % _REVISIONS
                body.made, body.revision = body.skin.revision, self._revision
                meshes[body.slot] = mesh_message(body.slot, body.revision, body.skin.skin)
            if matrices is not None:
                placed.append(
                    PlacedBody(person=person, slot=body.slot, revision=body.revision, world_from_mesh=matrices, rgba=rgba[n])
                )
        return meshes, bodies_message(t_s, placed)

    def _body_of(self, person: int, t_ns: int) -> _Body:
        if person not in self._bodies:
            taken = {body.slot for body in self._bodies.values()}
            self._bodies[person] = _Body(next(slot for slot in range(len(taken) + 1) if slot not in taken))
        body = self._bodies[person]
        body.seen_ns = t_ns
        return body

    def _forget(self, now_ns: int) -> None:
        self._bodies = {person: body for person, body in self._bodies.items() if now_ns - body.seen_ns < _KEPT_NS}
