"""What differs between releases of Gazebo: the names of plug-ins, message types and the command."""

from __future__ import annotations

from dataclasses import dataclass

from posefuse.core import ConfigError
from posefuse.core.errors import choices


@dataclass(frozen=True, kw_only=True)
class Release:
    """One release.

    Attributes:
        plugin: file name of a system plug-in, with ``{}`` for the system. system: class name, likewise.
        message: type name of a message, likewise. command: that starts the simulator. ros: the ROS 2 release it is paired with.
    """

    plugin: str
    system: str
    message: str
    command: str
    ros: str


_GZ = {"plugin": "gz-sim-{}-system", "system": "gz::sim::systems::{}", "message": "gz.msgs.{}", "command": "gz sim"}
RELEASES = {
    "fortress": Release(
        plugin="ignition-gazebo-{}-system", system="ignition::gazebo::systems::{}", message="ignition.msgs.{}",
        command="ign gazebo", ros="humble",
    ),
    "harmonic": Release(**_GZ, ros="jazzy"),
    "jetty": Release(**_GZ, ros="rolling"),
}  # fmt: skip


def release_named(name: str) -> Release:
    """The release of this name; ConfigError lists those there are."""
    if name not in RELEASES:
        raise ConfigError(f"gazebo: no release {name!r}; there are: {choices(RELEASES)}")
    return RELEASES[name]
