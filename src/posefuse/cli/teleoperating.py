"""What `posefuse teleoperate` does around the session: settings of the command line, news while it runs, tables."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from posefuse.api.live import build_live_session
from posefuse.api.teleoperate import teleoperate
from posefuse.cli.command_options import LiveOptions, OutputOptions, RobotOptions, RosRobotOptions, SourceOptions, TimingOptions
from posefuse.cli.options import Ros2Options
from posefuse.core import ConfigError
from posefuse.formats.rig import read_placed_rig
from posefuse.messages.dds_domain import Network
from posefuse.outputs.rerun_scene import SPAWN
from posefuse.pipeline.config import read_changed
from posefuse.realtime.config import LiveConfig
from posefuse.teleoperation.ros import RosPlan
from posefuse.teleoperation.settings import TeleoperationSettings

from .live import output_configs, run_options, settled_inputs
from .terminal import Terminal

if TYPE_CHECKING:
    from posefuse.teleoperation.session import Operator, Summary
    from posefuse.teleoperation.values import Order


def run_teleoperation(
    rig: Path,
    sources: SourceOptions,
    timing: TimingOptions,
    robot: RobotOptions,
    ros: RosRobotOptions,
    *,
    ros_2: Ros2Options,
    settings: LiveOptions,
    terminal: Terminal,
) -> Mapping[str, Any]:
    """Teleoperate; returns the figures of the tables."""
    if ros.command and not (ros.ros or ros.ros1):
        raise ConfigError(f"--command {ros.command}: needs --ros or --ros1")
    if ros.ros and ros.ros1:
        raise ConfigError("--ros --ros1: expected one of them")
    if not sources.source:
        raise ConfigError("--source: expected one per camera, e.g. --source cam1=usb:0, or --source sim:SCENE.yaml")
    cameras = read_placed_rig(rig)
    config = read_changed(settings.config, settings.changes, LiveConfig)
    session = build_live_session(
        cameras,
        settled_inputs(sources, timing, ros_2, cameras),
        config,
        output_configs(OutputOptions(record=robot.record), ros_2, config),
        duration_s=run_options(timing).duration_s,
    )
    with terminal.stages() as report:
        done = teleoperate(
            session,
            deadman=robot.deadman,
            settings=read_changed(robot.limits, robot.changes, TeleoperationSettings),
            robot=robot.robot,
            frames=robot.frame,
            command=ros.command,
            ros=_ros_plan(ros, ros_2) if ros.ros or ros.ros1 else None,
            emergency_stop=robot.i_have_an_emergency_stop,
            view=robot.view,
            show=robot.view_file.absolute() if robot.view_file else SPAWN if robot.view_scene else None,
            record=robot.record.with_suffix(".robot.mcap") if robot.record else None,
            watch=_News(terminal),
            progress=report,
        )
    return _shown(done, terminal)


def _ros_plan(ros: RosRobotOptions, ros_2: Ros2Options) -> RosPlan:
    return RosPlan(
        version=1 if ros.ros1 else 2,
        network=Network(**ros_2.network),
        base_frame=ros.base_frame,
        controller=ros.controller,
        cmd_vel=ros.cmd_vel,
        stamped=not (ros.cmd_vel_twist or ros.ros1),
    )


class _News:
    """A line whenever the phase or its reason changes."""

    def __init__(self, terminal: Terminal) -> None:
        self._terminal, self._last = terminal, ""

    def __call__(self, operator: Operator, order: Order | None) -> None:
        gate = operator.gate
        reason = "".join("#" if c.isdigit() else c for c in gate.reason)
        if (line := f"{gate.phase.value} {reason}") != self._last:
            self._last = line
            self._terminal.note(f"{gate.phase.value.upper():8} {gate.reason}")


def _shown(done: Summary, terminal: Terminal) -> Mapping[str, Any]:
    total = max(1, sum(done.ticks.values()))
    shares = {phase: count / total for phase, count in done.ticks.items()}
    latency = np.array(done.latency_ms)
    p50, p95 = np.percentile(latency, [50, 95]) if len(latency) else (None, None)
    terminal.table("time", ["phase", "share %"], [[phase, 100 * share] for phase, share in shares.items()])
    if done.reasons:
        rows = [[reason, count] for reason, count in done.reasons.most_common(8)]
        terminal.table("what slowed it down or held it", ["reason", "steps"], rows)
    facts = {
        "seconds": done.seconds,
        "times engaged": done.engagements,
        "mid-exposure to command, p50 ms": p50,
        "p95 ms": p95,
        "late control steps of the robot": done.robot_late,
    }
    terminal.facts("session", facts)
    if done.fault:
        terminal.warn(done.fault)
    return {
        "phases": shares,
        "reasons": dict(done.reasons),
        "engagements": done.engagements,
        "latency_p50_ms": p50,
        "latency_p95_ms": p95,
        "robot_late": done.robot_late,
        "seconds": done.seconds,
        "failed": bool(done.fault),
    }
