"""One session on several machines: camera nodes where the cameras are, the fusion node anywhere."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from posefuse.cli.command_options import LiveOptions, OutputOptions, SourceOptions, TimingOptions
from posefuse.cli.options import Ros2Options
from posefuse.core import SourceError
from posefuse.foundation.output_folder import check_replaceable
from posefuse.messages import topics
from posefuse.messages.dds import RosNode
from posefuse.messages.dds_domain import Network
from posefuse.outputs.live.ros import Ros2Config
from posefuse.pipeline.config import read_changed
from posefuse.realtime.camera_node import CameraNode
from posefuse.realtime.config import LiveConfig
from posefuse.realtime.estimator import message_from_centres
from posefuse.realtime.messages import SessionClock
from posefuse.realtime.network_views import NetworkViews
from posefuse.realtime.networks import settled_network
from posefuse.realtime.news import never_waiting
from posefuse.realtime.outputs import OutputPlan, check_live_outputs
from posefuse.realtime.processes import Groups
from posefuse.realtime.provenance import notes_of
from posefuse.realtime.ros_cameras import publish_intrinsics, rig_of_nodes, rig_with_camera_infos
from posefuse.realtime.session import SessionPlan, group_plans, run_session, stop_requests

from .live import fetch_chosen, how_it_ended, output_configs, run_options, session_rig, settled_inputs
from .live_report import live_session_figures, show_live_figures, write_latency_report
from .terminal import Terminal

_S = 1_000_000_000


def network_of(ros_2: Ros2Options) -> Network:
    """Where the nodes of a session meet."""
    return Network(**ros_2.network)


def camera_node(
    rig_file: Path,
    name: str,
    sources: SourceOptions,
    timing: TimingOptions,
    ros_2: Ros2Options,
    settings: LiveOptions,
    terminal: Terminal,
) -> Mapping[str, Any]:
    """Capture and detect on this machine, send 2D poses; the fused pose selects the image regions."""
    config, rig = read_changed(settings.config, settings.changes, LiveConfig), session_rig(rig_file, terminal)
    duration_s = run_options(timing).duration_s
    inputs = settled_inputs(sources, timing, ros_2, rig)
    if not inputs:
        raise SourceError("expected a source for at least 1 camera, got none; see --source")
    rig = rig_with_camera_infos(rig, inputs, config.camera_info, terminal.note)
    fetch_chosen(config.detector, terminal)
    config = replace(config, detector=settled_network(config.detector, len(inputs), terminal.note))
    clock = SessionClock.begin()
    plan = OutputPlan(rig=rig, clock=clock, configs={"ros2": Ros2Config()})
    with (
        RosNode(f"posefuse_cameras_{topics.ros_name(name)}", network_of(ros_2)) as node,
        Groups(group_plans(rig, inputs, config, plan)) as groups,
    ):
        publish_intrinsics(node, rig, [entry.camera for entry in inputs], time.time_ns())
        skeleton = groups.wait_ready()
        terminal.note("; ".join(groups.whereabouts()))
        groups.begin(time.monotonic_ns())
        worker = CameraNode(rig, [entry.camera for entry in inputs], node, clock, skeleton)
        for centres in groups.centres():
            node.publish(topics.JOINT_CENTRES, message_from_centres(centres, clock.now_ns()), clock.now_ns())
        end_ns = None if duration_s is None else clock.now_ns() + round(duration_s * _S)
        with stop_requests() as stopped:
            while not stopped and not worker.monitor.all_ended() and (end_ns is None or clock.now_ns() < end_ns):
                worker.step(groups)
    figures = {"sent": worker.sent, "refused": {name: worker.monitor.refused(name) for name in worker.cameras}}
    return {**figures, **how_it_ended(stopped[0] if stopped else "", duration_s, terminal)}


def fusion_node(
    rig_file: Path,
    timing: TimingOptions,
    outputs: OutputOptions,
    ros_2: Ros2Options,
    settings: LiveOptions,
    terminal: Terminal,
) -> Mapping[str, Any]:
    """Take the views of all camera nodes, track, publish."""
    config, rig, network = (
        read_changed(settings.config, settings.changes, LiveConfig),
        session_rig(rig_file, terminal),
        network_of(ros_2),
    )
    duration_s = run_options(timing).duration_s
    if outputs.report:
        check_replaceable(outputs.report, command="live", replace=False)
    # views that came from ROS are not sent back there
    configs = output_configs(outputs, ros_2, config, {"ros2": {"detections": False}})
    check_live_outputs(configs)
    if config.camera_info == "use":
        rig = rig_of_nodes(rig, network, terminal.note, duration_s)
    clock = SessionClock.begin()
    plan = OutputPlan(
        rig=rig, clock=clock, rate_hz=config.rate_hz, configs=configs, notes=notes_of(rig, config), names=config.names
    )
    whole = SessionPlan(outputs=plan, config=config, duration_s=duration_s, remote=True)
    terminal.note(f"waiting for views of {', '.join(rig.names)} in domain {network.domain_id}")
    with never_waiting(terminal.note) as say:
        views = NetworkViews(rig, network, clock, config, duration_s, say)
        done = run_session(whole, lambda: views, say)
    counts, senders = views.views.intake.counts, views.views.senders
    figures = {
        **live_session_figures(done),
        **how_it_ended(done.stopped_by, duration_s, terminal, failed=done.outputs_failed, fusion=done.fusion),
        "messages": {"accepted": counts.accepted, "refused": counts.refused},
        "last_refusal": counts.last_refusal,
        "not_used": dict(senders.refused),
        "strangers": dict(senders.strangers),
        "clock_offset_ms": {name: 1000 * offset for name, offset in done.clock_offset_s.items()},
    }
    show_live_figures(terminal, figures)
    terminal.facts("Clocks, ms after the mean", {name: f"{ms:+.1f}" for name, ms in figures["clock_offset_ms"].items()})
    if outputs.report:
        write_latency_report(outputs.report, done, figures)
    return figures
