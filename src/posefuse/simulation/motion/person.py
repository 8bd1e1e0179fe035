"""One body in motion: its exact state at any time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from posefuse.core import SE3
from posefuse.core.arrays import Array, frozen
from posefuse.simulation.body import SimulatedBody

from . import arms, daily, standing
from .gait import walking
from .points import from_result, from_trc
from .posture import BodyPosture, bones_of
from .retarget import retargeted
from .routes import route
from .settings import (
    BvhSettings,
    HandPathSettings,
    IdleSettings,
    MotionSettings,
    OverheadSettings,
    ReachSettings,
    ResultSettings,
    SitSettings,
    SquatSettings,
    TPoseSettings,
    TrcSettings,
    TurnSettings,
    WalkSettings,
    WaveSettings,
)


@dataclass(frozen=True, eq=False)
class PersonState:
    """A person at T times.

    Attributes:
        world_from_bone: (T, B, 4, 4). keypoints_world: (T, 23, 3) of `ANATOMICAL23`.
        world_from_segment: batch (T, S) of `simulation.body.SEGMENTS`.
        angle_rad: (T, J, 3) of `simulation.body.JOINTS`.
    """

    world_from_bone: Array
    keypoints_world: Array
    world_from_segment: SE3
    angle_rad: Array


@dataclass(frozen=True, eq=False)
class MovingPerson:
    """A body with a motion, made by `build_person`. Exact and repeatable at any time, before 0 as well."""

    body: SimulatedBody
    posture: Callable[[Array], BodyPosture]

    def at(self, t_s: Any) -> PersonState:
        """State at times (T,) in seconds, in any order."""
        bones = bones_of(self.body, self.posture(np.atleast_1d(np.asarray(t_s, np.float64))))
        return PersonState(
            frozen(bones, np.float64, "world_from_bone"),
            frozen(self.body.keypoints(bones), np.float64, "keypoints_world"),
            self.body.segments(bones),
            frozen(self.body.angles(bones), np.float64, "angle_rad"),
        )


def build_person(body: SimulatedBody, motion: MotionSettings, seed: int) -> MovingPerson:
    """Put a motion into a body; the same seed gives the same bytes.

    Raises:
        ConfigError: a path that cannot be walked, or that a hand cannot reach. InputError: a motion file that cannot be used.
    """
    match motion:
        case TPoseSettings():
            return MovingPerson(body, standing.tpose(body, motion))
        case IdleSettings():
            return MovingPerson(body, standing.idle(body, motion, seed))
        case WaveSettings():
            return MovingPerson(body, standing.wave(body, motion, seed))
        case SquatSettings():
            return MovingPerson(body, standing.squat(body, motion))
        case ReachSettings():
            return MovingPerson(body, arms.reach(body, motion, seed))
        case HandPathSettings():
            return MovingPerson(body, arms.hand_path(body, motion, seed))
        case OverheadSettings():
            return MovingPerson(body, daily.overhead(body, motion))
        case SitSettings():
            return MovingPerson(body, daily.sit(body, motion))
        case TurnSettings():
            return MovingPerson(body, daily.turning(body, motion))
        case WalkSettings():
            return MovingPerson(body, walking(body, route(motion.path, motion.speed_mps, seed), motion.speed_mps).posture)
        case BvhSettings():
            return MovingPerson(body, retargeted(body, motion).posture)
        case TrcSettings():
            return MovingPerson(body, from_trc(body, motion).posture)
        case ResultSettings():
            return MovingPerson(body, from_result(body, motion).posture)
