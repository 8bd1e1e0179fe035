"""Options that several commands have, and what their values may be."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Group, Parameter

from posefuse.cli.terminal import Terminal

Figures = Mapping[str, Any]
Shown = Annotated[Terminal, Parameter(parse=False)]
"""Where a command shows its progress; given by the caller."""

InputKind = Literal["auto", "videos", "images", "pose2d"]
# in the order of the help
CAMERAS, TIMING, OUTPUTS = Group.create_ordered("Cameras"), Group.create_ordered("Timing"), Group.create_ordered("Outputs")
ROS_2, TARGET, FLOOR = Group.create_ordered("ROS 2 network"), Group.create_ordered("Target"), Group.create_ordered("Floor")
SETTINGS = Group.create_ordered("Settings")


def positive(most: float) -> Parameter:
    """A number above 0 and at most `most`; NaN and infinity are refused."""

    def check(_: object, value: float | None) -> None:
        if value is not None and not 0 < value <= most:
            raise ValueError(f"expected a number > 0 and <= {most:g}, got {value:g}")

    return Parameter(validator=check)


def count(most: int) -> Parameter:
    """A whole number from 1 to `most`."""

    def check(_: object, value: int | None) -> None:
        if value is not None and not 1 <= value <= most:
            raise ValueError(f"expected a whole number from 1 to {most}, got {value}")

    return Parameter(validator=check)


def settings_of_networks(text: str) -> list[str]:
    """``KEY=VALUE`` settings of the detector for a bundled network's name or a model card.

    Raises:
        ValueError: a card that cannot be read.
    """
    from posefuse.core import ConfigError
    from posefuse.detection.build import network_settings

    try:
        return [f"{key}={value}" for key, value in network_settings(text).items()]
    except ConfigError as error:
        raise ValueError(str(error)) from None


def check_networks(_: object, names: tuple[str, ...]) -> None:
    """For `--networks`; raises ValueError for a card that cannot be read."""
    for name in names:
        settings_of_networks(name)


@Parameter(name="*", group=SETTINGS)
@dataclass(frozen=True, kw_only=True)
class NetworkOptions:
    """Which network the detector uses."""

    networks: Annotated[
        tuple[str, ...],
        Parameter(
            metavar="NAME|CARD.toml",
            help="2D network: blazepose_lite, blazepose_full (default), blazepose_heavy, blazepose_best, "
            "or your own model card (see docs/networks.md).",
            validator=check_networks,
        ),
    ] = ()

    @property
    def overrides(self) -> list[str]:
        """``KEY=VALUE`` settings."""
        return [setting for name in self.networks for setting in settings_of_networks(name)]


@Parameter(name="*", group=SETTINGS)
@dataclass(frozen=True, kw_only=True)
class SettingsOptions(NetworkOptions):
    """A settings file, and settings on top of it."""

    config: Annotated[Path | None, Parameter(metavar="FILE")] = None
    """TOML settings; `track` takes SESSION/posefuse.toml if it is there."""
    set_: Annotated[tuple[str, ...], Parameter(name="--set", metavar="KEY=VALUE")] = ()
    """Any setting, e.g. fuse.weights=score. May be given several times."""

    @property
    def overrides(self) -> list[str]:
        """``KEY=VALUE`` settings; those of ``--set`` come last and override."""
        return [*super().overrides, *self.set_]


@Parameter(name="*", group=ROS_2)
@dataclass(frozen=True, kw_only=True)
class Ros2Options:
    """Where ROS 2 is."""

    domain: Annotated[int | None, Parameter(metavar="ID")] = None
    """ROS_DOMAIN_ID (default 0)."""
    peer: Annotated[tuple[str, ...], Parameter(metavar="ADDRESS")] = ()
    """Address of another machine, where multicast is off. May be given several times."""
    interface: Annotated[str, Parameter(metavar="NAME")] = ""
    """Network interface to use."""
    local_only: bool = False
    """Nothing leaves this machine."""
    sim_time: bool = False
    """Stamps of ros: sources and of --ros are simulated time, which /clock gives (use_sim_time)."""

    @property
    def settings(self) -> dict[str, Any]:
        """Options that were given and that sources and outputs of ROS 2 share, by their names there."""
        return {**self.network, **({"sim_time": True} if self.sim_time else {})}

    @property
    def network(self) -> dict[str, Any]:
        """Those of them that state where ROS 2 is."""
        found = {"local_only": self.local_only, "interface": self.interface, "peers": self.peer}
        domain = {} if self.domain is None else {"domain_id": self.domain}
        return {**domain, **{name: value for name, value in found.items() if value}}


# what "all" means: more people would not fit into the area that a rig of cameras sees
ALL_PEOPLE = 16
_MOST_PEOPLE = 64


def people_from_text(_: object, tokens: Any) -> int:
    """The value of ``--people``: a whole number from 1 to 64, or ``all`` for up to 16; raises ValueError for anything else."""
    text = tokens[0].value
    if text == "all":
        return ALL_PEOPLE
    if text.isdecimal() and 1 <= int(text) <= _MOST_PEOPLE:
        return int(text)
    raise ValueError(f"expected a whole number from 1 to {_MOST_PEOPLE}, or all, got {text!r}")


def names_from_text(text: str | None) -> tuple[str, ...] | None:
    """The value of ``--names``."""
    return None if text is None else tuple(name.strip() for name in text.split(","))


def xy_from_text(_: object, tokens: Any) -> tuple[float, float]:
    """Metres from ``X,Y``."""
    text = tokens[0].value
    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError:
        raise ValueError(f"expected X,Y in metres, got {text!r}") from None
    return x, y
