"""`posefuse live` and `node`: poses while they happen."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from posefuse.cli.options import (
    EXPERT,
    OUTPUTS,
    TIMING,
    Figures,
    Ros2Options,
    SettingsOptions,
    Shown,
    Sources,
    settings_options,
)
from posefuse.realtime.config import LiveConfig

_SHOWN = {"body": "body", "track.max_people": "people N", "names": "names A,B,...", "rate_hz": "rate HZ"}
_EXPERT = {"groups": "groups N", "camera_info": "camera-info"}
LIVE_SETTINGS = {**_SHOWN, **_EXPERT}


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class SourceOptions:
    """Where the images come from."""

    source: Sources = ()


@Parameter(name="*", group=TIMING)
@dataclass(frozen=True, kw_only=True)
class TimingOptions:
    """When a session begins and ends.

    Attributes:
        duration: Stop after so many seconds.
        loop: Show the first S seconds of videos and simulated sessions again and again.
    """

    duration: Annotated[float | None, Parameter(metavar="S")] = None
    loop: Annotated[float | None, Parameter(metavar="S"), EXPERT] = None


@Parameter(name="*", group=OUTPUTS)
@dataclass(frozen=True, kw_only=True)
class OutputOptions:
    """Where the poses go.

    Attributes:
        record: Record views and poses.
        record_images: Record small images of the cameras, too.
        ros: Publish in ROS 2.
        ros1: Publish in ROS 1, at the master of ROS_MASTER_URI.
        osc: Send poses as OSC. May be given several times.
        json_udp: Send poses as JSON datagrams. May be given several times.
        output: Any other live output, e.g. lsl (`posefuse plugins` lists them); options: --set outputs.NAME.KEY=VALUE.
        axes: Axes of OSC and JSON (default z_up).
        view: Open the Rerun viewer (extra: viewer).
        view_file: Write what the viewer would show to a file.
        report: Write the latency of every camera and stage.
    """

    record: Annotated[Path | None, Parameter(metavar="FILE.mcap")] = None
    record_images: Annotated[bool, EXPERT] = False
    ros: bool = False
    ros1: Annotated[bool, EXPERT] = False
    osc: Annotated[tuple[str, ...], Parameter(metavar="HOST:PORT")] = ()
    json_udp: Annotated[tuple[str, ...], Parameter(metavar="HOST:PORT")] = ()
    output: Annotated[tuple[str, ...], Parameter(metavar="NAME")] = ()
    axes: Annotated[Literal["z_up", "y_up", "y_up_left_handed"] | None, Parameter(name_transform=str)] = None
    view: bool = False
    view_file: Annotated[Path | None, Parameter(metavar="FILE.rrd"), EXPERT] = None
    report: Annotated[Path | None, Parameter(metavar="DIR")] = None


@dataclass(frozen=True, kw_only=True)
class LiveOptions(SettingsOptions):
    """How the session works.

    Attributes:
        networks: 2D network: auto (default: the largest that processes every frame on this machine, measured at the start),
            blazepose_lite, blazepose_full, blazepose_heavy, blazepose_best, or your own model card (see docs/networks.md).
    """

    networks: Annotated[str | None, Parameter(metavar="auto|NAME|CARD.toml")] = None

    @property
    def given(self) -> bool:
        """Whether anything was given that changes how views become poses."""
        return bool(self.config or set(self.changes) - {"names", "rate_hz", "groups", "camera_info"})


@settings_options("settings", LiveConfig, _EXPERT, show=False)
@settings_options("settings", LiveConfig, _SHOWN)
def live(
    rig: Path,
    /,
    *,
    sources: SourceOptions = SourceOptions(),
    timing: TimingOptions = TimingOptions(),
    outputs: OutputOptions = OutputOptions(),
    ros_2: Ros2Options = Ros2Options(),
    settings: LiveOptions = LiveOptions(),
    videos: Annotated[Path | None, Parameter(metavar="DIR")] = None,
    replay: Annotated[Path | None, Parameter(metavar="FILE"), EXPERT] = None,
    terminal: Shown,
) -> Figures:
    """Track live: cameras, streams, videos or the simulator in, 3D skeletons out 100 times a second.

    Runs until the time is over, the sources end, or Ctrl-C.

    Args:
        rig: Calibration file of the cameras.
        videos: Keep the cameras' videos in this folder, a session for posefuse track.
        replay: Feed a recording to the tracker again, and compare the poses.
    """
    from posefuse.cli.live import check_nothing_else, replay_session, run_session

    if replay is not None:
        check_nothing_else(sources, timing, outputs, ros_2, videos=videos)
        return replay_session(rig, replay, settings, terminal)
    return run_session(rig, sources, timing, outputs, ros_2, settings=settings, terminal=terminal, videos=videos)


@settings_options("settings", LiveConfig, LIVE_SETTINGS, show=False)
def node_camera(
    rig: Path,
    /,
    *,
    sources: SourceOptions = SourceOptions(),
    timing: TimingOptions = TimingOptions(),
    ros_2: Ros2Options = Ros2Options(),
    settings: LiveOptions = LiveOptions(),
    name: str = "1",
    terminal: Shown,
) -> Figures:
    """Capture and detect on this machine, and send 2D poses to the fusion node.

    Args:
        rig: Calibration file of all cameras, the same on every machine.
        name: Name of this node, different on every machine.
    """
    from posefuse.cli.nodes import camera_node

    return camera_node(rig, name, sources, timing, ros_2, settings=settings, terminal=terminal)


@settings_options("settings", LiveConfig, LIVE_SETTINGS, show=False)
def node_fusion(
    rig: Path,
    /,
    *,
    timing: TimingOptions = TimingOptions(),
    outputs: Annotated[OutputOptions, EXPERT] = OutputOptions(),
    ros_2: Ros2Options = Ros2Options(),
    settings: LiveOptions = LiveOptions(),
    terminal: Shown,
) -> Figures:
    """Turn the 2D poses of all camera nodes into 3D poses, and publish them in ROS 2.

    Args:
        rig: Calibration file of all cameras, the same on every machine.
    """
    from posefuse.cli.nodes import fusion_node

    return fusion_node(rig, timing, outputs, ros_2, settings, terminal)
