"""A finished result with everything that it was made from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from .errors import ShapeError, choices
from .observations import Observations
from .poses import PoseSequence
from .rig import Rig
from .view_sequences import ViewSequence, ViewsInParts


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Recording:
    """A finished result: observations, poses, and provenance.

    Attributes:
        rig: the cameras used.
        poses: the 3D result; of a live session: what was published, at its output ticks.
        observations: every detection that it was made from, raw, with the people that `poses` has. Those of a recording
            have the poses' time steps; those of a live session have none.
        provenance: plain JSON values: version, rig id, config, inputs.

    Raises:
        ShapeError: other cameras, another skeleton or other time steps in the observations than in the rest.
    """

    rig: Rig
    poses: PoseSequence
    observations: Observations
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        seen = self.observations
        if seen.camera_names != self.rig.names:
            raise ShapeError(
                f"Recording: the rig has cameras {choices(self.rig.names)}, the observations {choices(seen.camera_names)}"
            )
        if seen.skeleton != self.poses.skeleton:
            raise ShapeError(
                f"Recording: skeleton {self.poses.skeleton.name} of the poses, observations have {seen.skeleton.name}"
            )
        if not (self.is_live or np.array_equal(seen.step_t_ns, self.poses.t_ns)):
            raise ShapeError(
                f"Recording: expected the observations' time steps to be the poses' {len(self.poses)}, or none (live), "
                f"got {len(seen.step_t_ns)}"
            )

    def __repr__(self) -> str:
        poses = self.poses
        return (
            f"Recording({len(self.rig)} cameras, {len(poses)} time steps, {len(poses.person_id)} people, "
            f"{poses.skeleton.name}, {len(self.observations)} detections)"
        )

    @property
    def person_names(self) -> tuple[str, ...]:
        """(N,) the people in words: their names where the settings have them (the first name is that of person 0), else
        ``person 0`` and so on."""
        config = self.provenance.get("config") or {}
        names = (config.get("names") or ()) if isinstance(config, Mapping) else ()
        return tuple(person_name(names, i) for i in self.poses.person_id.tolist())

    @property
    def is_live(self) -> bool:
        """Whether the poses are those of a live session: its observations belong to no time step."""
        return len(self.observations.step_t_ns) == 0

    @cached_property
    def views(self) -> ViewSequence:
        """What each camera saw of the people at the times of the poses, see `views_over_time`."""
        t_ns = self.poses.t_ns if self.is_live else None
        return ViewsInParts(self.observations, self.poses.person_id.tolist(), t_ns).part(slice(None))


def person_name(names: Sequence[str], person: int) -> str:
    """The name of a person by its id; ``person 3`` where there is none."""
    return names[person] if 0 <= person < len(names) else f"person {person}"
