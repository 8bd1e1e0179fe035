"""What goes with a world for ROS 2: the bridge's configuration and a script that starts both."""

from __future__ import annotations

from collections.abc import Sequence
from string import Template
from typing import Any

import yaml

from .releases import Release

WORLD_FILE, BRIDGE_FILE, LAUNCH_FILE = "world.sdf", "bridge.yaml", "launch.sh"
_LAUNCH = Template("""\
#!/bin/sh
# Starts Gazebo with this world, and the bridge that brings its images and its clock to ROS 2. Ctrl-C ends both.
#   ./launch.sh              with Gazebo's window
#   ./launch.sh --headless   without a screen
cd "$$(dirname "$$0")" || exit 1
case "$$1" in
  "") shown="" ;;
  --headless) shown="-s --headless-rendering" ;;
  *) echo "usage: $$0 [--headless]" >&2; exit 2 ;;
esac
for program in ${program} ros2; do
  command -v "$$program" >/dev/null || { echo "$$program: not found; see docs/gazebo.md of posefuse" >&2; exit 1; }
done
# shellcheck disable=SC2086
${command} -r $$shown ${world} &
simulator=$$!
trap 'kill $$simulator 2>/dev/null' EXIT
trap 'exit 130' INT TERM
ros2 run ros_gz_bridge parameter_bridge --ros-args -p config_file:="$$PWD/${bridge}"
""")


def image_topic(camera_topic: str) -> str:
    """Topic of a camera's images; Gazebo puts CameraInfo next to it."""
    return f"/{camera_topic}/image"


def bridge_text(release: Release, camera_topics: Sequence[str]) -> str:
    """The configuration of `ros_gz_bridge`: clock, images and CameraInfo, from Gazebo to ROS only."""
    topics = [("/clock", "rosgraph_msgs/msg/Clock", "Clock")]
    for name in camera_topics:
        topics += [(image_topic(name), "sensor_msgs/msg/Image", "Image")]
        topics += [(f"/{name}/camera_info", "sensor_msgs/msg/CameraInfo", "CameraInfo")]
    entries: list[dict[str, Any]] = [
        {
            "ros_topic_name": topic,
            "gz_topic_name": topic,
            "ros_type_name": ros_type,
            "gz_type_name": release.message.format(message),
            "direction": "GZ_TO_ROS",
        }
        for topic, ros_type, message in topics
    ]
    return yaml.safe_dump(entries, sort_keys=False)


def launch_text(release: Release) -> str:
    """A shell script; it is made executable."""
    program = release.command.split()[0]
    return _LAUNCH.substitute(program=program, command=release.command, world=WORLD_FILE, bridge=BRIDGE_FILE)
