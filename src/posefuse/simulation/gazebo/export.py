"""A scene as a folder that Gazebo opens: world, meshes with baked motion, bridge to ROS 2, and the exact truth.

DIR/world.sdf      everything that is seen, and the cameras
DIR/meshes/        people, things, floor and walls as COLLADA, with their images
DIR/bridge.yaml    clock, images and CameraInfo to ROS 2; DIR/launch.sh starts Gazebo and the bridge
DIR/rig.toml       the cameras, with their lenses, as the images are after intake
DIR/scene.yaml     every setting
DIR/truth/         `formats.truth` at simulation times, loop.json: when the motion starts again
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from posefuse.core import Rig
from posefuse.core.arrays import Array
from posefuse.core.ideal_image import drawn_camera
from posefuse.core.se3 import SE3
from posefuse.formats.collada import write_collada
from posefuse.formats.rig import write_rig
from posefuse.formats.truth import write_arrays, write_loop, write_truth
from posefuse.foundation.output_folder import output_folder
from posefuse.messages.topics import ros_name
from posefuse.simulation.build import LiveScene, live_scene
from posefuse.simulation.exact import prop_truth, truth_with, visible_to_all
from posefuse.simulation.props import StillPath
from posefuse.simulation.render.model import lamp_height_m
from posefuse.simulation.render.textures import png
from posefuse.simulation.scene import Scene, motion_files, write_scene

from .animation import person_actor, prop_actor, prop_mesh
from .releases import release_named
from .room import room_models
from .ros_files import BRIDGE_FILE, LAUNCH_FILE, WORLD_FILE, bridge_text, image_topic, launch_text
from .settings import GazeboSettings, shown_scene
from .world import CameraSensor, StillModel, world_text

_COMMAND = "simulate --gazebo"
_MESHES = "meshes"
_EXECUTABLE = 0o755
_DEFAULT = GazeboSettings()


@dataclass(frozen=True, kw_only=True)
class GazeboWorld:
    """What was written.

    Attributes:
        folder: where. rig: the cameras. people: number of actors that are persons. loop_s: when the motion starts again.
        keys_hz: keys per second of each animation. left_out: what of the scene Gazebo cannot show, in words.
    """

    folder: Path
    rig: Rig
    people: int
    loop_s: float
    keys_hz: tuple[float, ...]
    left_out: tuple[str, ...]


def export_world(
    scene: Scene,
    out: Path,
    settings: GazeboSettings = _DEFAULT,
    *,
    replace_older: bool = False,
    warn: Callable[[str], None] | None = None,
) -> GazeboWorld:
    """Write a scene as a Gazebo world into the folder `out`.

    Args:
        replace_older: an earlier world that posefuse wrote and that is unchanged is replaced.
        warn: gets a line about files that are left over.

    Raises:
        ConfigError: the scene cannot be, or not in Gazebo. InputError: `out` holds anything else or cannot be written.
        DependencyError: the extra ``sim`` is missing.
    """
    release = release_named(settings.release)
    shown, left_out = shown_scene(scene, settings)
    per_frame = int(np.ceil(settings.truth_hz / shown.rate_hz))
    live = live_scene(replace(shown, rate_hz=shown.rate_hz * per_frame))
    drawn = [drawn_camera(camera) for camera in live.rig]
    with output_folder(out, command=_COMMAND, inputs=motion_files(scene), replace=replace_older, warn=warn) as made:
        folder = made.folder
        (folder / _MESHES).mkdir()
        actors, keys_hz = _actors(live, shown.rate_hz, folder, settings.most_between_keys_m)
        models = [
            *room_models(live.scene.room, live.room_size_m, scene.seed, folder / _MESHES, _MESHES),
            *_still_props(live, folder),
        ]
        topics = [ros_name(camera.name) for camera in live.rig]
        sensors = [
            CameraSensor(
                camera=camera,
                rate_hz=placed.sensor.rate_hz or shown.rate_hz,
                noise_dn=placed.sensor.noise_dn,
                image_topic=image_topic(topic),
            )
            for camera, placed, topic in zip(drawn, live.placed, topics, strict=True)
        ]
        text = world_text(
            release,
            room=live.scene.room,
            lamp_m=lamp_height_m(live.scene.room, live.room_size_m),
            boxes=live.boxes,
            models=models,
            actors=actors,
            cameras=sensors,
            step_s=settings.step_s,
        )
        _write(folder, WORLD_FILE, text)
        _write(folder, BRIDGE_FILE, bridge_text(release, topics))
        _write(folder, LAUNCH_FILE, launch_text(release))
        (folder / LAUNCH_FILE).chmod(_EXECUTABLE)
        write_scene(shown, folder)
        write_rig(folder / "rig.toml", live.rig)
        _write_truth(live, folder / "truth")
    return GazeboWorld(
        folder=out, rig=live.rig, people=len(live.people), loop_s=shown.duration_s, keys_hz=keys_hz, left_out=tuple(left_out)
    )


def _write(folder: Path, name: str, text: str) -> None:
    (folder / name).write_text(text, encoding="utf-8", newline="\n")


def _write_truth(live: LiveScene, folder: Path) -> None:
    folder.mkdir()
    visible = visible_to_all(live)
    write_truth(folder / "truth.npz", truth_with(live, visible))
    write_loop(folder, round(live.scene.duration_s * 1e9))
    if live.props:
        write_arrays(folder / "props.npz", prop_truth(live, visible))


def _actors(live: LiveScene, rate_hz: float, folder: Path, most_m: float) -> tuple[list[tuple[str, str]], tuple[float, ...]]:
    """Everything that moves, written: name and file of each, and its keys per second."""
    actors, keys_hz = [], []
    duration_s = live.scene.duration_s
    for i, body in enumerate(live.bodies):
        mesh, skeleton = person_actor(body, lambda t_s, i=i: live.bones(t_s)[i], duration_s, rate_hz, most_m)  # type: ignore[misc]
        actors.append((f"person{i}", _mesh_name(f"person{i}")))
        keys_hz.append(len(skeleton.t_s) / duration_s)
        write_collada(folder / actors[-1][1], mesh, skeleton)
    for i, prop in enumerate(live.props):
        if not isinstance(prop.path, StillPath):
            _write_picture(folder, prop.name, prop.texture)
            mesh, skeleton = prop_actor(prop, f"{prop.name}.png", _prop_poses(live, i), duration_s, rate_hz, most_m)
            actors.append((prop.name, _mesh_name(prop.name)))
            keys_hz.append(len(skeleton.t_s) / duration_s)
            write_collada(folder / actors[-1][1], mesh, skeleton)
    return actors, tuple(keys_hz)


def _prop_poses(live: LiveScene, i: int) -> Callable[[Array], Array]:
    return lambda t_s: live.prop_poses(t_s)[i].matrix4()


def _still_props(live: LiveScene, folder: Path) -> list[StillModel]:
    models = []
    for i, prop in enumerate(live.props):
        if isinstance(prop.path, StillPath):
            texture = _write_picture(folder, prop.name, prop.texture)
            write_collada(folder / _mesh_name(prop.name), prop_mesh(prop, f"{prop.name}.png"))
            pose: SE3 = live.prop_poses(np.zeros(1))[i][0]
            models.append(StillModel(name=prop.name, mesh=_mesh_name(prop.name), texture=texture, world_from_model=pose))
    return models


def _mesh_name(name: str) -> str:
    return f"{_MESHES}/{name}.dae"


def _write_picture(folder: Path, name: str, picture: Array) -> str:
    path = f"{_MESHES}/{name}.png"
    (folder / path).write_bytes(png(picture))
    return path
