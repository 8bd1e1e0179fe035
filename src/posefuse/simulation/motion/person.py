"""One body in motion: its exact state at any time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from posefuse.core import SE3
from posefuse.core.arrays import Array
from posefuse.simulation.body import SimulatedBody

from .gait import walking
from .points import from_result, from_trc
from .posture import BodyPosture, bones_of
from .retarget import retargeted
from .routes import route
from .settings import MotionSettings, StandSettings, WalkSettings
from .standing import standing_motion

_READERS = {"bvh": retargeted, "trc": from_trc, "result": from_result}


@dataclass(frozen=True, eq=False)
class PersonState:
    """A person at T times; what follows from the bones is computed when it is first asked for.

    Attributes:
        world_from_bone: (T, B, 4, 4).
    """

    body: SimulatedBody
    world_from_bone: Array

    @cached_property
    def keypoints_world(self) -> Array:
        """(T, 23, 3) of `ANATOMICAL23`."""
        return self.body.keypoints(self.world_from_bone)

    @cached_property
    def world_from_segment(self) -> SE3:
        """Batch (T, S) of `simulation.body.SEGMENTS`."""
        return self.body.segments(self.world_from_bone)

    @cached_property
    def angle_rad(self) -> Array:
        """(T, J, 3) of `simulation.body.JOINTS`."""
        return self.body.angles(self.world_from_bone)


@dataclass(frozen=True, eq=False)
class MovingPerson:
    """A body with a motion, made by `build_person`. Exact and repeatable at any time, before 0 as well."""

    body: SimulatedBody
    posture: Callable[[Array], BodyPosture]

    def at(self, t_s: Any) -> PersonState:
        """State at times (T,) in seconds, in any order."""
        return PersonState(self.body, bones_of(self.body, self.posture(np.atleast_1d(np.asarray(t_s, np.float64)))))


def build_person(body: SimulatedBody, motion: MotionSettings, seed: int) -> MovingPerson:
    """Put a motion into a body; the same seed gives the same bytes.

    Raises:
        ConfigError: a path that cannot be walked, or that a hand cannot reach. InputError: a motion file that cannot be used.
    """
    if isinstance(motion, StandSettings):
        return MovingPerson(body, standing_motion(body, motion, seed))
    if isinstance(motion, WalkSettings):
        return MovingPerson(body, walking(body, route(motion.path, motion.speed_mps, seed), motion.speed_mps).posture)
    return MovingPerson(body, _READERS[motion.kind](body, motion).posture)
