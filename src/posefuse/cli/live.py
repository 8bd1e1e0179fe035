"""`posefuse live` and `node`: poses while they happen."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

import posefuse as pf
from posefuse.realtime.config import LiveConfig

from .options import (
    OUTPUTS,
    TIMING,
    Figures,
    NetworkOptions,
    Ros2Options,
    SettingsOptions,
    Shown,
    Sources,
    settings_options,
)
from .stopping import NO_PERSON_CODE, session_exit_code
from .terminal import Terminal, quoted

LIVE_SETTINGS = {
    "body": "body", "track.max_people": "people N", "names": "names A,B,...", "rate_hz": "rate HZ", "groups": "groups N",
}  # fmt: skip


@Parameter(name="*", group=TIMING)
@dataclass(frozen=True, kw_only=True)
class TimingOptions:
    """When a session begins and ends.

    Attributes:
        duration: Stop after so many seconds.
        loop: Show the first S seconds of videos and simulated sessions again and again.
    """

    duration: Annotated[float | None, Parameter(metavar="S")] = None
    loop: Annotated[float | None, Parameter(metavar="S")] = None


@Parameter(name="*", group=OUTPUTS)
@dataclass(frozen=True, kw_only=True)
class OutputOptions:
    """Where the poses go.

    Attributes:
        record: Record views and poses.
        ros: Publish in ROS 2.
        ros1: Publish in ROS 1, at the master of ROS_MASTER_URI.
        osc: Send poses as OSC. May be given several times.
        json_udp: Send poses as JSON datagrams. May be given several times.
        output: Any other live output, e.g. lsl (`posefuse plugins` lists them); options: --set outputs.NAME.KEY=VALUE.
        axes: Axes of OSC and JSON (default z_up).
        view: Open the Rerun viewer (extra: viewer).
        view_file: Write what the viewer would show to a file.
    """

    record: Annotated[Path | None, Parameter(metavar="FILE.mcap")] = None
    ros: bool = False
    ros1: bool = False
    osc: Annotated[tuple[str, ...], Parameter(metavar="HOST:PORT")] = ()
    json_udp: Annotated[tuple[str, ...], Parameter(metavar="HOST:PORT")] = ()
    output: Annotated[tuple[str, ...], Parameter(metavar="NAME")] = ()
    axes: Annotated[Literal["z_up", "y_up", "y_up_left_handed"] | None, Parameter(name_transform=str)] = None
    view: bool = False
    view_file: Annotated[Path | None, Parameter(metavar="FILE.rrd")] = None

    @property
    def chosen(self) -> dict[str, dict[str, Any]]:
        """Options of the outputs that were chosen, by name."""
        found: dict[str, dict[str, Any]] = {name: {} for name in self.output}
        if self.record:
            found["record"] = {"path": self.record.absolute()}
        found |= {name: {} for name, on in (("ros2", self.ros), ("ros1", self.ros1)) if on}
        found |= {name: {"to": list(to)} for name, to in (("osc", self.osc), ("json", self.json_udp)) if to}
        if self.view_file or self.view:
            found["rerun"] = {"file": self.view_file.absolute() if self.view_file else None}
        return found


@dataclass(frozen=True, kw_only=True)
class LiveOptions(SettingsOptions, NetworkOptions):
    """How the session works.

    Attributes:
        networks: 2D network: auto (default: the best installed one that processes every frame, measured at the start),
            blazepose_lite, blazepose_full, blazepose_heavy, blazepose_best, or your own model card (see docs/networks.md).
    """

    networks: Annotated[str | None, Parameter(metavar="auto|NAME|CARD.toml")] = None


@settings_options("settings", LiveConfig, LIVE_SETTINGS)
def live(
    rig: Path,
    /,
    *,
    source: Sources = (),
    timing: TimingOptions = TimingOptions(),
    outputs: OutputOptions = OutputOptions(),
    ros_2: Ros2Options = Ros2Options(),
    settings: LiveOptions = LiveOptions(),
    videos: Annotated[Path | None, Parameter(metavar="DIR", group=OUTPUTS)] = None,
    terminal: Shown,
) -> Figures:
    """Track live: cameras, streams, videos or the simulator in, 3D skeletons out 100 times a second.

    Runs until the time is over, the sources end, or Ctrl-C.

    Args:
        rig: Calibration file of the cameras.
        videos: Keep the cameras' videos in this folder, a session for posefuse track.
    """
    with terminal.stages() as progress:
        run = pf.track_live(
            rig,
            source,
            config=settings.config,
            settings=settings.changes,
            outputs=outputs.chosen,
            ros=ros_2.settings,
            axes=outputs.axes,
            duration_s=timing.duration,
            loop_s=timing.loop,
            videos=videos,
            on_end=lambda run: terminal.show(run.summary()),
            progress=progress,
        )
    if videos and any(one["written"] for one in run.figures["videos"].values()):
        terminal.next(f"posefuse track {quoted(videos)} --out DIR", "the videos, solved over all of time")
    _show_next(outputs, terminal, people=run.people)
    return {**run.figures, "exit_code": exit_code(run, timing.duration, terminal)}


def exit_code(run: Any, duration_s: float | None, terminal: Terminal) -> int:
    """The exit code of a session; states what request ended it early."""
    code = how_it_ended(run.stopped_by, duration_s, terminal, failed=run.failed)
    return code or (0 if run.people else NO_PERSON_CODE)


def how_it_ended(stopped_by: str, duration_s: float | None, terminal: Terminal, *, failed: bool = False) -> int:
    """State what request ended the session early; the exit code."""
    code = session_exit_code(stopped_by, endless=duration_s is None, failed=failed)
    if stopped_by and code:
        terminal.note(f"stopped by {stopped_by}" + ("" if duration_s is None else f" before {duration_s:g} s were over"))
    return code


def _show_next(outputs: OutputOptions, terminal: Terminal, *, people: bool) -> None:
    if outputs.record is None:
        terminal.next("the same with --record FILE.mcap", "keeps views and poses")
    elif people and outputs.record.exists():
        terminal.next(f"posefuse report {quoted(outputs.record)}", "joint angles, gait, files for OpenSim and Blender, one page")
        terminal.next(f"posefuse solve {quoted(outputs.record)} --out DIR", "solves it again over all of time, more exactly")
