"""Options of `posefuse live` and `posefuse node`, in the groups that the functions below take."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from .shared import CAMERAS, OUTPUTS, SETTINGS, TIMING, SettingsOptions, check_networks, people_from_text

SOURCE_HELP = (
    "One per camera: video:FILE, usb:DEVICE[@640x480@30] (Linux /dev/video0, macOS 0, Windows the name), rtsp://..., "
    "http://..., ros:/TOPIC, realsense:SERIAL, oak:SERIAL; or sim:SCENE|SESSION for all cameras."
)


@Parameter(name="*", group=CAMERAS)
@dataclass(frozen=True, kw_only=True)
class SourceOptions:
    """Where the images come from."""

    source: Annotated[tuple[str, ...], Parameter(metavar="CAMERA=KIND:WHERE", help=SOURCE_HELP)] = ()


@Parameter(name="*", group=TIMING)
@dataclass(frozen=True, kw_only=True)
class TimingOptions:
    """When a session begins and ends."""

    duration: Annotated[float | None, Parameter(metavar="S")] = None
    """Stop after so many seconds."""
    loop: Annotated[float | None, Parameter(metavar="S")] = None
    """Show the first S seconds of videos and simulated sessions again and again."""


@Parameter(name="*", group=OUTPUTS)
@dataclass(frozen=True, kw_only=True)
class OutputOptions:
    """Where the poses go."""

    record: Annotated[Path | None, Parameter(metavar="FILE.mcap")] = None
    """Record views and poses."""
    record_images: bool = False
    """Record small images of the cameras, too."""
    ros: bool = False
    """Publish in ROS 2."""
    ros1: bool = False
    """Publish in ROS 1, at the master of ROS_MASTER_URI."""
    osc: Annotated[tuple[str, ...], Parameter(metavar="HOST:PORT")] = ()
    """Send poses as OSC. May be given several times."""
    json_udp: Annotated[tuple[str, ...], Parameter(metavar="HOST:PORT")] = ()
    """Send poses as JSON datagrams. May be given several times."""
    output: Annotated[
        tuple[str, ...],
        Parameter(
            metavar="NAME",
            help="Any other live output, e.g. lsl (`posefuse plugins` lists them); options: --set outputs.NAME.KEY=VALUE.",
        ),
    ] = ()
    axes: Annotated[Literal["z_up", "y_up", "y_up_left_handed"] | None, Parameter(name_transform=str)] = None
    """Axes of OSC and JSON (default z_up)."""
    view: bool = False
    """Open the Rerun viewer (extra: viewer)."""
    view_file: Annotated[Path | None, Parameter(metavar="FILE.rrd")] = None
    """Write what the viewer would show to a file."""
    report: Annotated[Path | None, Parameter(metavar="DIR")] = None
    """Write the latency of every camera and stage."""


@Parameter(name="*", group=SETTINGS)
@dataclass(frozen=True, kw_only=True)
class LiveSettingsOptions(SettingsOptions):
    """How the session works."""

    networks: Annotated[
        tuple[str, ...],
        Parameter(
            metavar="auto|NAME|CARD.toml",
            help="2D network: auto (default: the largest that processes every frame on this machine, measured at the start), "
            "blazepose_lite, blazepose_full, blazepose_heavy, blazepose_best, or your own model card "
            "(see docs/networks.md).",
            validator=check_networks,
        ),
    ] = ()
    body: Literal["auto", "on", "off"] | None = None
    """Fit one skeleton of constant lengths per person, learnt on the way (auto, the default: with fitted joint centres)."""
    people: Annotated[int | None, Parameter(metavar="N", converter=people_from_text, n_tokens=1, accepts_keys=False)] = None
    """How many people to follow, the best seen ones: a number, or all (default 1)."""
    names: Annotated[str | None, Parameter(metavar="A,B,...")] = None
    """Names of the people in the order of their ids, for viewers, JSON datagrams and what is made of a recording."""
    rate: Annotated[float | None, Parameter(metavar="HZ")] = None
    """Output rate in poses per second (default 100)."""
    groups: Annotated[int | None, Parameter(metavar="N")] = None
    """Camera processes (default: one per two cameras and core)."""
    camera_info: Literal["check", "use", "ignore"] | None = None
    """CameraInfo of ros: sources: compare it with the rig (default), use it instead of the rig's intrinsics, or ignore it.
    On several machines give `use` to the fusion node, too: it takes the intrinsics that the camera nodes send."""

    @property
    def given(self) -> bool:
        """Whether anything was given that changes how views become poses."""
        return bool(self.config or self.overrides or self.body or self.people is not None)
