"""Scene files: everything a simulated session consists of, each key with its unit and default."""

from __future__ import annotations

import dataclasses
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import yaml
from annotated_types import Ge, Gt, Le
from pydantic import Field

from posefuse.core import ConfigError
from posefuse.foundation.parsing import plain
from posefuse.foundation.settings import read_settings, settings

from .body import BodyShapeSettings
from .cameras import CameraSettings
from .motion import MotionSettings
from .motion.settings import RecordedSettings, check_motion
from .props import PropSettings
from .surroundings import OccluderSettings, RoomSettings


@settings
class PersonSettings:
    """One person: a body and how it moves."""

    body: BodyShapeSettings = BodyShapeSettings()
    motion: MotionSettings


@settings
class H264Settings:
    """One H.264 video per camera.

    Attributes:
        crf: x264's constant rate factor; 18 looks lossless, 28 is small.
    """

    kind: Literal["h264"]
    crf: Annotated[int, Ge(0), Le(51)] = 23


@settings
class JpegSettings:
    """One folder of JPEG images per camera, with a table of times.

    Attributes:
        quality: 1 to 100.
    """

    kind: Literal["jpeg"]
    quality: Annotated[int, Ge(1), Le(100)] = 92


RecordSettings = Annotated[H264Settings | JpegSettings, Field(discriminator="kind")]


@settings
class Scene:
    """A whole scene.

    Attributes:
        duration_s: how long. start_s: session time at which it begins.
        rate_hz: frames per second of cameras without a rate of their own, and of the truth.
        seed: of everything random that has no seed of its own.
        record: how the cameras' frames are stored.
    """

    duration_s: Annotated[float, Gt(0), Le(7200)]
    start_s: Annotated[float, Ge(0)] = 0.0
    rate_hz: Annotated[float, Gt(0), Le(1000)] = 30.0
    seed: Annotated[int, Ge(0)] = 0
    cameras: CameraSettings
    people: tuple[PersonSettings, ...] = ()
    occluders: tuple[OccluderSettings, ...] = ()
    props: tuple[PropSettings, ...] = ()
    room: RoomSettings = RoomSettings()
    record: RecordSettings = H264Settings(kind="h264")


def read_scene(path: Path) -> Scene:
    """Read a scene file (YAML or TOML); raises ConfigError in one line naming file, key, expected and got.

    Motion files are looked for from the scene file's folder; the scene has their whole paths.
    """
    scene = _with_motion_files(read_settings(path, Scene), path.absolute().parent)
    try:
        check_motions(scene)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from None
    return scene


def check_motions(scene: Scene) -> None:
    """Raise ConfigError for a person's setting that belongs to another kind of motion."""
    for i, person in enumerate(scene.people):
        check_motion(person.motion, f"people.{i}.motion")


def _with_motion_files(scene: Scene, folder: Path) -> Scene:
    people = []
    for person in scene.people:
        if isinstance(person.motion, RecordedSettings):
            person = replace(person, motion=replace(person.motion, file=str(folder / person.motion.file)))
        people.append(person)
    return replace(scene, people=tuple(people))


def motion_files(scene: Scene) -> tuple[Path, ...]:
    """The motion files and folders that the scene is made from."""
    motions = [person.motion for person in scene.people]
    return tuple(Path(motion.file) for motion in motions if isinstance(motion, RecordedSettings))


SCENE_FILE = "scene.yaml"


def scene_text(scene: Scene) -> str:
    """The content of scene.yaml: every setting."""
    return yaml.safe_dump(plain_settings(scene), sort_keys=False)


def plain_settings(settings: Any) -> Any:
    """Settings as plain values for YAML: mappings, lists, numbers, text."""
    return plain(dataclasses.asdict(settings))
