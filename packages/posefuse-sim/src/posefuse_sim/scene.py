"""Scene files: everything a simulated session consists of, each key with its unit and default; and the folder that keeps one."""

from __future__ import annotations

import dataclasses
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal, cast

import yaml
from annotated_types import Ge, Gt, Le
from pydantic import Field

from posefuse.core import ConfigError
from posefuse.core.errors import choices
from posefuse.foundation.parsing import plain
from posefuse.foundation.settings import read_settings, settings

from .body import BodyShapeSettings
from .cameras import CameraSettings, placed_cameras
from .motion import MotionSettings
from .motion.settings import check_motion
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

    Motion files are looked for from the scene file's folder.
    """
    scene = with_motion_files(read_settings(path, Scene), lambda _, file: str(path.parent / file))
    try:
        check_scene(scene)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from None
    return scene


def with_motion_files(scene: Scene, moved: Callable[[int, str], str]) -> Scene:
    """The scene with the motion file of each person, where there is one, replaced by `moved(place of the person, file)`."""
    people = []
    for i, person in enumerate(scene.people):
        file = getattr(person.motion, "file", None)
        motion = person.motion if file is None else replace(cast(Any, person.motion), file=moved(i, file))
        people.append(replace(person, motion=motion))
    return replace(scene, people=tuple(people))


def motion_files(scene: Scene) -> tuple[Path, ...]:
    """The motion files and folders that the scene is made from."""
    files = [getattr(person.motion, "file", None) for person in scene.people]
    return tuple(Path(file) for file in files if file is not None)


def check_scene(scene: Scene) -> None:
    """Raise ConfigError for names that are taken twice, and settings of other kinds, before it is built."""
    _check_unique("cameras: name", [camera.name for camera in placed_cameras(scene.cameras)])
    _check_unique("props: name", [prop.name for prop in scene.props])
    for i, person in enumerate(scene.people):
        check_motion(person.motion, f"people.{i}.motion")


def _check_unique(what: str, names: list[str]) -> None:
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ConfigError(f"{what}: used twice: {choices(twice)}; give each its own")


SCENE_FILE = "scene.yaml"


def write_scene(scene: Scene, folder: Path) -> None:
    """Write scene.yaml, every setting in it, and copy the motion files: the folder holds all it was made from."""
    (folder / SCENE_FILE).write_text(scene_text(scene), encoding="utf-8")
    with_motion_files(scene, lambda i, file: _copied(Path(file), folder / _motion_name(i, file)))


def scene_text(scene: Scene) -> str:
    """The content of scene.yaml: every setting, motion files as the session holds them."""
    return yaml.safe_dump(plain_settings(with_motion_files(scene, _motion_name)), sort_keys=False)


def _motion_name(person: int, file: str) -> str:
    return f"motion/{person}-{Path(file).name}"


def _copied(file: Path, into: Path) -> str:
    """Copy a motion file or folder, so that the session holds all it was made from."""
    into.parent.mkdir(exist_ok=True)
    if file.is_dir():
        shutil.copytree(file, into, dirs_exist_ok=True)
    else:
        shutil.copyfile(file, into)
    return str(into)


def plain_settings(settings: Any) -> Any:
    """Settings as plain values for YAML: mappings, lists, numbers, text."""
    return plain(dataclasses.asdict(settings))
