"""One session on several machines: camera nodes where the cameras are, the fusion node anywhere."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from posefuse.cli.options.live import LiveSettingsOptions, NodeTimingOptions, OutputOptions, SourceOptions, TimingOptions
from posefuse.cli.options.shared import Ros2Options
from posefuse.core import CameraHealth, ConfigError, LiveHealth, LivePreview, Pose3D, Rig, Skeleton, SourceError
from posefuse.core.skeleton import BLAZEPOSE33
from posefuse.foundation.channel import Channel, wait_any
from posefuse.foundation.output_folder import check_replaceable
from posefuse.foundation.platform import peak_memory_mb
from posefuse.health.cameras import Monitor
from posefuse.messages import topics
from posefuse.messages.dds import Network, RosNode
from posefuse.messages.intake import Intake
from posefuse.messages.messages import POSE_TYPE, message_from_detections, pose_from_message
from posefuse.messages.ros_output import RosOutput
from posefuse.outputs.live.ros import Ros2Config, health_lines, publish_preview
from posefuse.realtime.board import Board
from posefuse.realtime.clock import SessionClock
from posefuse.realtime.config import LiveConfig
from posefuse.realtime.fusion import velocity_between
from posefuse.realtime.group_views import GroupViews
from posefuse.realtime.joint_centres import message_from_centres
from posefuse.realtime.messages import Centres, Seen, Status
from posefuse.realtime.network_intake import NetworkIntake
from posefuse.realtime.networks import settled_network
from posefuse.realtime.news import Say
from posefuse.realtime.output_plan import OutputPlan
from posefuse.realtime.processes import Groups
from posefuse.realtime.provenance import notes_of
from posefuse.realtime.ros_cameras import rig_with_camera_infos
from posefuse.realtime.scheduling import expected_gain
from posefuse.realtime.session import group_plans, new_board, ready_tracker, run_session, stop_requests
from posefuse.realtime.session_plan import SessionPlan

from .live import fetch_chosen, how_it_ended, output_configs, run_options, session_rig, settled_config, settled_inputs
from .live_report import figures_of, show, write_report
from .terminal import Terminal

_S = 1_000_000_000
_POLL_S = 0.01
_JUDGE_NS = _S // 4
_SIGMA_PX = 4.0
_MAX_BYTES = 2**20
_FIRST_VIEW_S = 0.5


def network_of(ros_2: Ros2Options) -> Network:
    """Where the nodes of a session meet."""
    return Network(domain_id=ros_2.domain, local_only=ros_2.local_only, interface=ros_2.interface, peers=ros_2.peer)


def camera_node(
    rig_file: Path,
    name: str,
    sources: SourceOptions,
    timing: NodeTimingOptions,
    ros_2: Ros2Options,
    settings: LiveSettingsOptions,
    terminal: Terminal,
) -> Mapping[str, Any]:
    """Capture and detect on this machine, send 2D poses; the fused pose tells where to look."""
    config, rig, run = settled_config(settings), session_rig(rig_file, terminal), run_options(timing)
    inputs = settled_inputs(sources, timing, ros_2, rig)
    if not inputs:
        raise SourceError("expected a source for at least 1 camera, got none; see --source")
    if config.camera_info == "use":
        raise ConfigError("--camera-info use: the fusion node needs these intrinsics, too; put them into the rig file")
    rig_with_camera_infos(rig, inputs, config.camera_info, terminal.note)
    fetch_chosen(config.detector, terminal)
    detector, chooser = settled_network(config.detector, len(inputs), terminal.note)
    config = replace(config, detector=detector)
    clock = SessionClock.begin()
    # the whole rig stands on the board, so that gains and regions have one order on all machines
    board = new_board(rig)
    plan = OutputPlan(rig=rig, clock=clock, configs={"ros2": Ros2Config()})
    with (
        RosNode(f"posefuse_cameras_{topics.ros_name(name)}", network_of(ros_2)) as node,
        GroupViews(group_plans(rig, inputs, config, plan), board, chooser, terminal.note) as groups,
    ):
        skeleton = groups.wait_ready()
        terminal.note("; ".join(groups.whereabouts()))
        groups.begin(time.monotonic_ns() if run.zero_s is None else round(run.zero_s * _S) - clock.offset_ns)
        worker = CameraNode(rig, [entry.camera for entry in inputs], node, board, clock, skeleton)
        for centres in groups.centres():
            node.publish(topics.JOINT_CENTRES, message_from_centres(centres, clock.now_ns()), clock.now_ns())
        end_ns = None if run.duration_s is None else clock.now_ns() + round(run.duration_s * _S)
        with stop_requests() as stopped:
            while not stopped and not worker.monitor.all_ended() and (end_ns is None or clock.now_ns() < end_ns):
                worker.step(groups)
    figures = {"sent": worker.sent, "refused": {name: worker.monitor.refused(name) for name in worker.cameras}}
    return {**figures, **how_it_ended(stopped[0] if stopped else "", run.duration_s, terminal)}


class CameraNode:
    """Sends what its groups see, and hands predictions from the network to them."""

    def __init__(
        self, rig: Rig, cameras: Sequence[str], node: RosNode, board: Board, clock: SessionClock, skeleton: Skeleton
    ) -> None:
        self.cameras, self.monitor, self.sent = tuple(cameras), Monitor(cameras), dict.fromkeys(cameras, 0)
        self._rig, self._node, self._board, self._clock = rig, node, board, clock
        self._poses = node.reader(topics.POSE)
        self._intake = Intake(POSE_TYPE, pose_from_message, _MAX_BYTES)
        self._told: Pose3D | None = None
        self._fusion, self._heard_ns = "", 0
        self._skeleton = skeleton
        self._judged_ns = 0
        self._output = RosOutput(node, None)
        # announced now: a fusion node that waits for it need not wait for the first person
        node.writer(topics.DETECTIONS)

    def step(self, groups: Groups) -> None:
        """A moment's work."""
        wait_any(groups.channels(), _POLL_S)
        self._hear()
        for message in groups.messages():
            if isinstance(message, Seen):
                self._send(message)
            elif isinstance(message, Status):
                for state in message.cameras:
                    self.monitor.take_state(state, message.t_ns)
            elif isinstance(message, Centres):
                now_ns = self._clock.now_ns()
                self._node.publish(topics.JOINT_CENTRES, message_from_centres(message, now_ns), now_ns)
            elif isinstance(message, LivePreview):
                publish_preview(self._node, message, self._rig)
        now_ns = self._clock.now_ns()
        if now_ns - self._judged_ns > _JUDGE_NS:
            self._judged_ns = now_ns
            verdicts = self.monitor.judge(now_ns, groups.troubles())
            cameras = {name: CameraHealth(state=v.state, text=v.text) for name, v in verdicts.items()}
            self._output.diagnose(now_ns, health_lines(LiveHealth(t_ns=now_ns, cameras=cameras)))

    def _send(self, seen: Seen) -> None:
        view = self.monitor.admit(seen, self._clock.now_ns())
        if view is not None:
            stages = {"received": seen.received_ns, "started": seen.started_ns, "detected": seen.detected_ns}
            self._node.publish(topics.DETECTIONS, message_from_detections(view, stages), view.t_ns)
            self.sent[view.camera] += 1

    def _hear(self) -> None:
        for sample in self._poses.take()[-1:]:
            now_ns = self._clock.now_ns()
            taken = self._intake.take(sample.raw)
            # one fusion node at a time, which goes by the same keypoints; another one only after that is gone
            if taken is None or taken[0].skeleton != self._skeleton:
                continue
            if sample.sender != self._fusion and now_ns - self._heard_ns < _S:
                continue
            self._fusion, self._heard_ns = sample.sender, now_ns
            self._look_for(taken[0])

    def _look_for(self, pose: Pose3D) -> None:
        sigma = np.full(len(self._rig), _SIGMA_PX)
        self._board.write(pose, velocity_between(self._told, pose), expected_gain(pose, self._rig, sigma))
        if self._told is None or pose.t_ns - self._told.t_ns > 25_000_000:
            self._told = pose


def fusion_node(
    rig_file: Path,
    timing: TimingOptions,
    outputs: OutputOptions,
    ros_2: Ros2Options,
    settings: LiveSettingsOptions,
    terminal: Terminal,
) -> Mapping[str, Any]:
    """Take the views of all camera nodes, track, publish."""
    config, rig, network = settled_config(settings), session_rig(rig_file, terminal), network_of(ros_2)
    duration_s = run_options(timing).duration_s
    if outputs.report:
        check_replaceable(outputs.report, command="live", replace=False)
    # views that came from ROS are not sent back there
    configs = output_configs(outputs, ros_2, config, {"ros2": {"detections": False}})
    clock = SessionClock.begin()
    plan = OutputPlan(rig=rig, clock=clock, rate_hz=config.rate_hz, configs=configs, notes=notes_of(rig, config))
    views = NetworkViews(NetworkIntake(rig, network, clock), config, duration_s, terminal.note)
    whole = SessionPlan(outputs=plan, config=config, duration_s=duration_s, remote=True)
    terminal.note(f"waiting for views of {', '.join(rig.names)} in domain {ros_2.domain}")
    done = run_session(whole, lambda board: views, terminal.note)
    counts, senders = views.intake.views.intake.counts, views.intake.views.senders
    figures = {
        **figures_of(done),
        **how_it_ended(done.stopped_by, duration_s, terminal, failed=done.outputs_failed),
        "messages": {"accepted": counts.accepted, "refused": counts.refused},
        "last_refusal": counts.last_refusal,
        "not_used": dict(senders.refused),
        "strangers": dict(senders.strangers),
        "clock_offset_ms": {name: 1000 * offset for name, offset in done.clock_offset_s.items()},
    }
    show(terminal, figures)
    terminal.facts("Clocks, ms after the mean", {name: f"{ms:+.1f}" for name, ms in figures["clock_offset_ms"].items()})
    if outputs.report:
        write_report(outputs.report, done, figures)
    return figures


class NetworkViews:
    """Views of other machines, as `session.SessionViews`. Use as a context manager: leaving it closes them."""

    restarts = 0

    def __init__(self, intake: NetworkIntake, config: LiveConfig, duration_s: float | None, say: Say) -> None:
        self.intake = intake
        self._config, self._duration_s, self._say = config, duration_s, say
        self._begun_ns = intake.clock.now_ns()

    def __enter__(self) -> NetworkViews:
        return self

    def __exit__(self, *problem: object) -> None:
        self.intake.close()

    def wait_ready(self, stopped: Sequence[str]) -> Skeleton:
        """The skeleton of the first view."""
        # compiled for any skeleton, before a view is there to be waited for
        ready_tracker(self.intake.rig, BLAZEPOSE33, self._config)
        while (skeleton := self.intake.first_skeleton(_FIRST_VIEW_S)) is None:
            if stopped or (self._duration_s is not None and self._waited_s() >= self._duration_s):
                raise SourceError(self._nothing_came())
        self._say(f"first view after {self._waited_s():.1f} s")
        return skeleton

    def whereabouts(self) -> list[str]:
        """In no process of this machine."""
        return []

    def centres(self) -> list[Centres]:
        """They come with the views."""
        return []

    def start(self, clock: SessionClock) -> int:
        """They come already; the session counts from when it began to wait for them."""
        return self._begun_ns

    def channels(self) -> list[Channel]:
        """For `select`."""
        return self.intake.channels()

    def messages(self) -> Iterator[Seen | Centres]:
        """What has come; never waits."""
        return self.intake.messages()

    def troubles(self) -> Mapping[str, str]:
        """See `NetworkIntake`."""
        return self.intake.troubles()

    def notices(self) -> list[str]:
        """Why messages are refused."""
        return self.intake.notices()

    def memory_mb(self) -> float:
        """Most memory this process has held."""
        return peak_memory_mb([os.getpid()])

    def _waited_s(self) -> float:
        return (self.intake.clock.now_ns() - self._begun_ns) / _S

    def _nothing_came(self) -> str:
        counts, strangers = self.intake.views.intake.counts, self.intake.views.senders.strangers
        why = f"; {counts.refused} messages were refused, the last because: {counts.last_refusal}" if counts.refused else ""
        others = f"; there are views of {', '.join(sorted(strangers))}, not in the rig" if strangers else ""
        return f"no view of any camera of the rig came{why}{others}; are the camera nodes in the same domain?"
