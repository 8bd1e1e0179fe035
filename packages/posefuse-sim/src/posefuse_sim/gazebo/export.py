"""A scene as a folder that Gazebo opens: world, meshes with baked motion, bridge to ROS 2, and the exact truth.

DIR/world.sdf      everything that is seen, and the cameras
DIR/meshes/        people as COLLADA
DIR/bridge.yaml    clock, images and CameraInfo to ROS 2; DIR/launch.sh starts Gazebo and the bridge
DIR/rig.toml       the cameras, with their lenses, as the images are after intake
DIR/scene.yaml     every setting
DIR/truth/         `formats.truth` at simulation times, loop.json: when the motion starts again
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from posefuse.core import ConfigError, Rig
from posefuse.core.ideal_image import drawn_camera
from posefuse.formats.rig import write_rig
from posefuse.foundation.output_folder import output_folder
from posefuse.foundation.parsing import ros_name
from posefuse.foundation.summary import Block, Facts, Heading, Note
from posefuse_sim.build import LiveScene, live_scene
from posefuse_sim.cameras import ListedCameras, SensorSettings, placed_cameras
from posefuse_sim.exact import truth_with, visible_to_all
from posefuse_sim.files import write_loop, write_truth
from posefuse_sim.scene import SCENE_FILE, Scene, motion_files, scene_text

from .animation import person_actor
from .collada import write_collada
from .world import MESHES, image_topic, mesh_file, world_text

_COMMAND = "simulate --gazebo"
_EXECUTABLE = 0o755
# at least so many time steps per second of truth: linear interpolation between them is then within 0.1 mm for an acceleration of
# 50 m/s^2
_TRUTH_HZ = 240.0
# longest animation that is baked: one minute of a walk takes about 30 MB
_MOST_ANIMATION_S = 600.0
_NOT_SHOWN = "left out: props, depth, lost frames, rolling shutters, exposures and clocks of single cameras; see docs/gazebo.md"


@dataclass(frozen=True, kw_only=True)
class GazeboWorld:
    """What was written.

    Attributes:
        folder: where. rig: the cameras. people: number of actors that are persons. loop_s: when the motion starts again.
    """

    folder: Path
    rig: Rig
    people: int
    loop_s: float

    @property
    def figures(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "cameras": list(self.rig.names),
            "people": self.people,
            "loop_s": self.loop_s,
            "out": self.folder,
        }

    def summary(self) -> list[Block]:
        """What was written and what was left out, for people."""
        facts = {
            "cameras": ", ".join(self.rig.names),
            "people": self.people,
            "motion": f"{self.loop_s:g} s, again and again",
            "folder": str(self.folder),
        }
        return [Heading("Gazebo world"), Facts(facts), Note(_NOT_SHOWN)]


def export_world(scene: Scene, out: Path, *, replace_older: bool = False) -> GazeboWorld:
    """Write a scene as a Gazebo world into the folder `out`.

    Args:
        replace_older: an earlier world that posefuse wrote and that is unchanged is replaced.

    Raises:
        ConfigError: the scene cannot be, or not in Gazebo. InputError: `out` holds anything else or cannot be written.
        DependencyError: the extra ``sim`` is missing.
    """
    shown = shown_scene(scene)
    per_frame = int(np.ceil(_TRUTH_HZ / shown.rate_hz))
    live = live_scene(replace(shown, rate_hz=shown.rate_hz * per_frame))
    drawn = [drawn_camera(camera) for camera in live.rig]
    with output_folder(out, command=_COMMAND, inputs=motion_files(scene), replace=replace_older) as made:
        folder = made.folder
        (folder / MESHES).mkdir()
        actors = _actors(live, shown.rate_hz, folder)
        _write(folder, "world.sdf", world_text(live, actors=actors, cameras=drawn))
        _write(folder, "bridge.yaml", bridge_text(live.rig.names))
        _write(folder, "launch.sh", _LAUNCH)
        (folder / "launch.sh").chmod(_EXECUTABLE)
        _write(folder, SCENE_FILE, scene_text(shown))
        write_rig(folder / "rig.toml", live.rig)
        _write_truth(live, folder / "truth")
    return GazeboWorld(folder=out, rig=live.rig, people=len(live.people), loop_s=shown.duration_s)


def _write(folder: Path, name: str, text: str) -> None:
    (folder / name).write_text(text, encoding="utf-8", newline="\n")


def _write_truth(live: LiveScene, folder: Path) -> None:
    folder.mkdir()
    write_truth(folder / "truth.npz", truth_with(live, visible_to_all(live)))
    write_loop(folder, round(live.scene.duration_s * 1e9))


def _actors(live: LiveScene, rate_hz: float, folder: Path) -> list[str]:
    """The people, written: the name of each."""
    names = [f"person{i}" for i in range(len(live.people))]
    for name, person in zip(names, live.people, strict=True):
        write_collada(folder / mesh_file(name), *person_actor(person, live.scene.duration_s, rate_hz))
    return names


def shown_scene(scene: Scene) -> Scene:
    """The scene as Gazebo shows it, its time beginning at 0.

    Raises:
        ConfigError: it lasts too long, or less than a millisecond.
    """
    duration_s = int(scene.duration_s * 1000 + 1e-6) / 1000
    if not 0 < duration_s <= _MOST_ANIMATION_S:
        raise ConfigError(
            f"duration_s: expected 0.001 to {_MOST_ANIMATION_S:g} s for Gazebo, got {scene.duration_s:g} s; "
            "the animation begins again at its end, so a shorter scene continues as well"
        )
    cameras = []
    for camera in placed_cameras(scene.cameras):
        sensor = SensorSettings(rate_hz=camera.sensor.rate_hz or scene.rate_hz, noise_dn=camera.sensor.noise_dn)
        cameras.append(replace(camera, sensor=sensor))
    listed = ListedCameras(kind="list", cameras=tuple(cameras))
    return replace(scene, cameras=listed, props=(), duration_s=duration_s, start_s=0.0)


_LAUNCH = """\
#!/bin/sh
# Starts Gazebo with this world, and the bridge that brings its images and its clock to ROS 2. Ctrl-C ends both.
#   ./launch.sh              with Gazebo's window
#   ./launch.sh --headless   without a screen
cd "$(dirname "$0")" || exit 1
case "$1" in
  "") shown="" ;;
  --headless) shown="-s --headless-rendering" ;;
  *) echo "usage: $0 [--headless]" >&2; exit 2 ;;
esac
for program in gz ros2; do
  command -v "$program" >/dev/null || { echo "$program: not found; see docs/gazebo.md of posefuse" >&2; exit 1; }
done
# shellcheck disable=SC2086
gz sim -r $shown world.sdf &
simulator=$!
trap 'kill $simulator 2>/dev/null' EXIT
trap 'exit 130' INT TERM
ros2 run ros_gz_bridge parameter_bridge --ros-args -p config_file:="$PWD/bridge.yaml"
"""


def bridge_text(cameras: Sequence[str]) -> str:
    """The configuration of `ros_gz_bridge`: clock, images and CameraInfo, from Gazebo to ROS only."""
    topics = [("/clock", "rosgraph_msgs/msg/Clock", "Clock")]
    for name in cameras:
        topics += [(image_topic(name), "sensor_msgs/msg/Image", "Image")]
        topics += [(f"/{ros_name(name)}/camera_info", "sensor_msgs/msg/CameraInfo", "CameraInfo")]
    entries: list[dict[str, Any]] = [
        {
            "ros_topic_name": topic,
            "gz_topic_name": topic,
            "ros_type_name": ros_type,
            "gz_type_name": f"gz.msgs.{message}",
            "direction": "GZ_TO_ROS",
        }
        for topic, ros_type, message in topics
    ]
    return yaml.safe_dump(entries, sort_keys=False)
