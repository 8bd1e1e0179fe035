"""What a scene stands for: people with their exact state at any time, boxes, props, the exact rig, every camera's shots."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from posefuse.core import SE3, ConfigError, Rig
from posefuse.core.arrays import Array, freeze_fields
from posefuse.core.skeleton import ANATOMICAL23

from .body import SimulatedBody, build_body
from .cameras import PlacedCamera, placed_cameras, rig_from_cameras
from .motion.gait import walking
from .motion.posture import BodyPosture, bones_of
from .motion.recorded import from_result, from_trc
from .motion.routes import route
from .motion.settings import MotionSettings, StandSettings, WalkSettings
from .motion.standing import standing_motion
from .props import Prop, poses_on_path, prop_from_settings
from .scene import Scene, check_motions
from .surroundings import Box, boxes_of

_ROOM_MARGIN_M = 1.0
_LEAST_ROOM_M = 8.0
_CHECK_STEP_S = 0.1

# keeps frames in order however strong the jitter
_JITTER_LIMIT_PERIODS = 0.45
_PURPOSE = {"jitter": 1, "drop": 3}


@dataclass(frozen=True, eq=False)
class Shots:
    """The frames one camera delivers.

    Attributes:
        camera: its name.
        seq: (F,) running number of each frame, gaps where frames were lost.
        t_ns: (F,) true mid-exposure (of the middle row) on the session clock.
        stamp_ns: (F,) the same moment as the camera's own clock has it.
    """

    camera: str
    seq: Array
    t_ns: Array
    stamp_ns: Array

    def __post_init__(self) -> None:
        freeze_fields(self, dict.fromkeys(("seq", "t_ns", "stamp_ns"), np.int64))

    def __len__(self) -> int:
        return len(self.t_ns)


def shots_of(scene: Scene, index: int, camera: PlacedCamera) -> Shots:
    """Frames of camera number `index` from the start to the end of a scene, the same for the same seed.

    Raises:
        ConfigError: no frame is left, or the camera's clock would show negative times.
    """
    sensor, start_s, seed = camera.sensor, scene.start_s, scene.seed
    rate_hz = sensor.rate_hz or scene.rate_hz
    # the camera counts its own seconds
    period_s = 1 / rate_hz / (1 + sensor.drift_ppm * 1e-6)
    count = max(0, int(np.ceil((scene.duration_s - sensor.phase_s) / period_s - 1e-9)))
    seq = np.arange(count)
    jitter_s = sensor.jitter_s * _rng(seed, "jitter", index).standard_normal(count)
    jitter_s = np.clip(jitter_s, -_JITTER_LIMIT_PERIODS * period_s, _JITTER_LIMIT_PERIODS * period_s)
    # nothing is exposed before the scene begins
    t_s = np.maximum(start_s + sensor.phase_s + seq * period_s + jitter_s, start_s)
    stamp_s = sensor.offset_s + t_s * (1 + sensor.drift_ppm * 1e-6)
    kept = _rng(seed, "drop", index).random(count) >= sensor.drop_fraction
    if not kept.any():
        raise ConfigError(
            f"camera {camera.name}: no frame is left between {start_s} s and {start_s + scene.duration_s} s; "
            "make duration_s longer, phase_s or drop_fraction smaller"
        )
    stamp_ns = np.round(stamp_s[kept] * 1e9).astype(np.int64)
    if stamp_ns[0] < 0:
        raise ConfigError(
            f"camera {camera.name}: its clock starts at {stamp_ns[0] / 1e9:.3f} s, and a video has no times before 0; "
            f"set start_s to at least {start_s - stamp_ns.min() / 1e9:.3f}"
        )
    return Shots(camera.name, seq[kept], np.round(t_s[kept] * 1e9), stamp_ns)


def _rng(seed: int, purpose: str, index: int) -> np.random.Generator:
    return np.random.default_rng([seed, _PURPOSE[purpose], index])


@dataclass(frozen=True, eq=False, kw_only=True)
class LiveScene:
    """What a scene file stands for. Times of all questions are seconds of session time.

    Attributes:
        scene: the settings. room_size_m: (x, y) of the floor.
        placed: cameras as set. rig: the exact cameras. shots: what each exposes when, in the order of the rig.
        people: N. boxes: occluders. props: P calibration objects.
    """

    scene: Scene
    room_size_m: tuple[float, float]
    placed: tuple[PlacedCamera, ...]
    rig: Rig
    shots: tuple[Shots, ...]
    people: tuple[MovingPerson, ...]
    boxes: tuple[Box, ...]
    props: tuple[Prop, ...]

    @property
    def t_ns(self) -> Array:
        """(T,) the nominal frame times, at which the truth is written."""
        count = max(1, int(np.ceil(self.scene.duration_s * self.scene.rate_hz - 1e-9)))
        t_s = self.scene.start_s + np.arange(count) / self.scene.rate_hz
        return np.round(t_s * 1e9).astype(np.int64)

    def bones(self, t_s: Array) -> list[Array]:
        """For each person how each bone moved from rest (T, B, 4, 4), in world axes."""
        return [person.at(self._since_start(t_s)).moved for person in self.people]

    def keypoints(self, t_s: Array) -> Array:
        """(T, N, K, 3) anatomical keypoints of all people in world metres."""
        seen = [person.at(self._since_start(t_s)).keypoints_world for person in self.people]
        return np.stack(seen, axis=1) if seen else np.zeros((len(t_s), 0, len(ANATOMICAL23), 3))

    def prop_poses(self, t_s: Array) -> list[SE3]:
        """For each prop its world poses (T,)."""
        since_start = self._since_start(t_s)
        return [poses_on_path(prop.path, since_start, self.scene.seed * 1000 + i) for i, prop in enumerate(self.props)]

    def _since_start(self, t_s: Array) -> Array:
        return np.asarray(t_s, np.float64) - self.scene.start_s


# a body takes seconds to build and never changes
_body = functools.lru_cache(maxsize=32)(build_body)


def live_scene(scene: Scene) -> LiveScene:
    """Build everything; raises ConfigError for what cannot be (camera outside the room, a path off the floor, no frame)."""
    check_motions(scene)
    placed = placed_cameras(scene.cameras)
    rig = rig_from_cameras(placed)
    shots = tuple(shots_of(scene, i, camera) for i, camera in enumerate(placed))
    people = tuple(
        build_person(_body(person.body), person.motion, scene.seed * 1000 + i) for i, person in enumerate(scene.people)
    )
    live = LiveScene(
        scene=scene,
        room_size_m=room_size(scene, rig),
        placed=placed,
        rig=rig,
        shots=shots,
        people=people,
        boxes=boxes_of(scene.occluders, scene.seed),
        props=tuple(prop_from_settings(prop) for prop in scene.props),
    )
    _check_places(live)
    return live


def room_size(scene: Scene, rig: Rig) -> tuple[float, float]:
    """(x, y) metres of the floor about the origin: as set, or what the cameras enclose and a margin."""
    if scene.room.size_m is not None:
        return scene.room.size_m
    reach = np.maximum(2 * (np.abs(rig.centres_world()[:, :2]).max(axis=0) + _ROOM_MARGIN_M), _LEAST_ROOM_M)
    return float(reach[0]), float(reach[1])


def _check_places(live: LiveScene) -> None:
    half = np.array(live.room_size_m) / 2
    t_s = live.scene.start_s + np.arange(0, live.scene.duration_s, _CHECK_STEP_S)
    keypoints = live.keypoints(t_s)
    for camera, centre in zip(live.rig, live.rig.centres_world(), strict=True):
        if live.scene.room.walls != "none" and (np.abs(centre[:2]) > half).any():
            raise ConfigError(
                f"camera {camera.name}: stands at {_point(centre)} m, outside the room of {_point(2 * half)} m; "
                "make room.size_m larger, or room.walls: none"
            )
    for i in range(keypoints.shape[1]):
        outside = (np.abs(keypoints[:, i, :, :2]) > half).any(axis=(1, 2))
        if outside.any():
            raise ConfigError(
                f"people.{i}: leaves the floor of {_point(2 * half)} m at {t_s[outside][0]:.1f} s; "
                "make room.size_m larger or the path smaller"
            )


def _point(values: Array) -> str:
    return "(" + ", ".join(f"{round(float(value), 2) + 0.0:.2f}" for value in values) + ")"


_READERS = {"trc": from_trc, "result": from_result}


@dataclass(frozen=True, eq=False)
class PersonState:
    """A person at T times; what follows from the bones is computed when it is first asked for.

    Attributes:
        moved: (T, B, 4, 4) the rigid motion of each bone from rest.
    """

    body: SimulatedBody
    moved: Array

    @cached_property
    def keypoints_world(self) -> Array:
        """(T, 23, 3) of `ANATOMICAL23`."""
        return self.body.keypoints(self.moved)

    @cached_property
    def world_from_segment(self) -> SE3:
        """Batch (T, S) of `simulation.body.SEGMENTS`."""
        return self.body.segments(self.moved)

    @cached_property
    def angle_rad(self) -> Array:
        """(T, J, 3) of `simulation.body.JOINTS`."""
        return self.body.angles(self.moved)


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
        ConfigError: a path that cannot be walked. InputError: a motion file that cannot be used.
    """
    if isinstance(motion, StandSettings):
        return MovingPerson(body, standing_motion(body, motion, seed))
    if isinstance(motion, WalkSettings):
        return MovingPerson(body, walking(body, route(motion.path, motion.speed_mps, seed), motion.speed_mps).posture)
    return MovingPerson(body, _READERS[motion.kind](body, motion))
