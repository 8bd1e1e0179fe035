"""One session on several machines: camera nodes beside the cameras, the fusion node anywhere."""

from __future__ import annotations

import argparse
import os
import select
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from posefuse.core import Pose3D, Rig, SourceError
from posefuse.core.skeleton import BLAZEPOSE33
from posefuse.formats.rig import read_placed_rig
from posefuse.health.cameras import Monitor
from posefuse.messages import topics
from posefuse.messages.dds import Network, RosNode
from posefuse.messages.intake import Intake
from posefuse.messages.messages import POSE_TYPE, message_from_detections, pose_from_message
from posefuse.messages.ros_output import RosOutput
from posefuse.realtime.board import Board
from posefuse.realtime.clock import SessionClock
from posefuse.realtime.config import LiveConfig
from posefuse.realtime.fusion import Fusion, velocity_between
from posefuse.realtime.joint_centres import Centring, message_from_centres
from posefuse.realtime.messages import Preview, Seen, Status
from posefuse.realtime.network_intake import NetworkIntake
from posefuse.realtime.outputs import OutputPlan, OutputProcess
from posefuse.realtime.processes import Groups, peak_mb
from posefuse.realtime.provenance import notes_of
from posefuse.realtime.rig_watch import RigWatch
from posefuse.realtime.scheduling import expected_gain
from posefuse.realtime.session import Finished, News, favoured, group_plans, new_board, ready_joints, ready_tracker, stop_requests
from posefuse.realtime.sinks import health_lines, publish_preview

from .live import output_plan, settled_config, settled_inputs
from .live_report import figures_of, show, write_report
from .terminal import Terminal

_S = 1_000_000_000
_POLL_S = 0.01
_JUDGE_NS = _S // 4
_SIGMA_PX = 4.0
_MAX_BYTES = 2**20
_FIRST_VIEW_S = 0.5


def network_of(args: argparse.Namespace) -> Network:
    """Where the nodes of a session meet."""
    return Network(args.domain, args.local_only, args.interface, tuple(args.peer))


def camera_node(args: argparse.Namespace, terminal: Terminal) -> Mapping[str, Any]:
    """Capture and look on this machine, send 2D poses; the fused pose tells where to look."""
    config, rig = settled_config(args), read_placed_rig(args.rig)
    inputs = settled_inputs(args, rig)
    if not inputs:
        raise SourceError("expected a source for at least 1 camera, got none; see --source")
    clock = SessionClock.begin()
    # the whole rig stands on the board, so that gains and regions have one order on all machines
    board = new_board(rig)
    plan = OutputPlan(rig, clock, ros=network_of(args))
    with (
        RosNode(f"posefuse_cameras_{topics.ros_name(args.name)}", plan.ros) as node,
        Groups(group_plans(rig, inputs, config, plan), board) as groups,
    ):
        groups.wait_ready()
        terminal.note("; ".join(groups.whereabouts()))
        groups.begin(time.monotonic_ns() if args.zero is None else round(args.zero * _S) - clock.offset_ns)
        worker = CameraNode(rig, [entry.camera for entry in inputs], node, board, clock)
        for told in groups.centres():
            node.publish(topics.JOINT_CENTRES, message_from_centres(told, clock.now_ns()), clock.now_ns())
        end_ns = None if args.duration is None else clock.now_ns() + round(args.duration * _S)
        with stop_requests() as stopped:
            while not stopped and not worker.monitor.all_ended() and (end_ns is None or clock.now_ns() < end_ns):
                worker.step(groups)
    return {"sent": worker.sent, "refused": {name: worker.monitor.refused(name) for name in worker.cameras}}


class CameraNode:
    """Sends what its groups see, and hands predictions from the network to them."""

    def __init__(self, rig: Rig, cameras: Sequence[str], node: RosNode, board: Board, clock: SessionClock) -> None:
        self.cameras, self.monitor, self.sent = tuple(cameras), Monitor(cameras), dict.fromkeys(cameras, 0)
        self._rig, self._node, self._board, self._clock = rig, node, board, clock
        self._poses = node.reader(topics.POSE)
        self._intake = Intake(POSE_TYPE, pose_from_message, _MAX_BYTES)
        self._told: Pose3D | None = None
        self._judged_ns = 0
        self._output = RosOutput(node, None)
        # announced now: a fusion node that waits for it need not wait for the first person
        node.writer(topics.DETECTIONS)

    def step(self, groups: Groups) -> None:
        """A moment's work."""
        select.select(groups.channels(), [], [], _POLL_S)
        self._hear()
        for message in groups.messages():
            if isinstance(message, Seen):
                self._send(message)
            elif isinstance(message, Status):
                for state in message.cameras:
                    self.monitor.told(state, message.t_ns)
            elif isinstance(message, Preview):
                publish_preview(self._node, message)
        now_ns = self._clock.now_ns()
        if now_ns - self._judged_ns > _JUDGE_NS:
            self._judged_ns = now_ns
            states = {name: (v.state, v.text) for name, v in self.monitor.judge(now_ns, groups.troubles()).items()}
            self._output.diagnose(now_ns, health_lines(states, {}))

    def _send(self, seen: Seen) -> None:
        view = self.monitor.admit(seen, self._clock.now_ns())
        if view is not None:
            stages = {"received": seen.received_ns, "started": seen.started_ns, "detected": seen.detected_ns}
            self._node.publish(topics.DETECTIONS, message_from_detections(view, stages), view.t_ns)
            self.sent[view.camera] += 1

    def _hear(self) -> None:
        samples = self._poses.take()
        taken = self._intake.take(samples[-1].raw) if samples else None
        if taken is None:
            return
        pose, _ = taken
        sigma = np.full(len(self._rig), _SIGMA_PX)
        self._board.write(pose, velocity_between(self._told, pose), expected_gain(pose, self._rig, sigma))
        if self._told is None or pose.t_ns - self._told.t_ns > 25_000_000:
            self._told = pose


def fusion_node(args: argparse.Namespace, terminal: Terminal) -> Mapping[str, Any]:
    """Take the views of all camera nodes, track, publish."""
    config, rig = settled_config(args), read_placed_rig(args.rig)
    args.ros = True
    plan = replace(output_plan(args, rig), ros_views=False, notes=notes_of(rig, config))
    with stop_requests() as stopped:
        outputs = OutputProcess(plan)
        intake = NetworkIntake(rig, plan.ros, plan.clock)
        try:
            outputs.wait_ready()
            terminal.note(f"waiting for views of {', '.join(rig.names)} in domain {args.domain}")
            done = _fuse(rig, config, plan, outputs, intake, args.duration, stopped, terminal.note)
        finally:
            outputs.close()
            intake.close()
    times = os.times()
    done.cpu_s = (times.user + times.system, times.children_user + times.children_system)
    done.outputs, done.lost, done.trouble = outputs.figures, outputs.lost, outputs.trouble
    figures = {
        **figures_of(done),
        "messages": {"accepted": intake.intake.counts.accepted, "refused": intake.intake.counts.refused},
        "last_refusal": intake.intake.counts.last_refusal,
        "strangers": intake.strangers,
        "clock_offset_ms": {name: 1000 * offset for name, offset in done.clock_offset_s.items()},
    }
    show(terminal, figures)
    terminal.facts("Clocks, ms after the mean", {name: f"{ms:+.1f}" for name, ms in figures["clock_offset_ms"].items()})
    if args.report:
        write_report(args.report, done, figures)
    return figures


def _fuse(
    rig: Rig,
    config: LiveConfig,
    plan: OutputPlan,
    outputs: OutputProcess,
    intake: NetworkIntake,
    duration_s: float | None,
    stopped: list[str],
    say: Callable[[str], None],
) -> Finished:
    # compiled for any skeleton, before anybody waits
    ready_tracker(rig, BLAZEPOSE33, config)
    begun_ns = plan.clock.now_ns()
    end_ns = None if duration_s is None else begun_ns + round(duration_s * _S)

    def until(now_ns: int) -> bool:
        return bool(stopped) or (end_ns is not None and now_ns >= end_ns)

    skeleton = None
    while skeleton is None:
        if until(plan.clock.now_ns()):
            counts = intake.intake.counts
            why = f"; {counts.refused} messages were refused, the last because: {counts.last_refusal}" if counts.refused else ""
            others = f"; there are views of {', '.join(sorted(intake.strangers))}, not in the rig" if intake.strangers else ""
            raise SourceError(f"no view of any camera of the rig came{why}{others}; are the camera nodes in the same domain?")
        skeleton = intake.first_skeleton(_FIRST_VIEW_S)
    say(f"first view after {(plan.clock.now_ns() - begun_ns) / _S:.1f} s")
    with RigWatch(rig, clocks=True) as watch:
        joints = ready_joints(skeleton, config)
        tracker, centring = ready_tracker(rig, skeleton, config), Centring(rig.names, config.joint_centres)
        fusion = Fusion(rig, tracker, new_board(rig), plan.clock, outputs, centring, watch, joints)
        for told in intake.centres:
            fusion.take(told)
        done = Finished(fusion, skeleton, zero_ns=begun_ns)
        news = News(fusion, begun_ns, say)

        def over(now_ns: int) -> bool:
            news.tell(now_ns)
            return until(now_ns)

        with favoured():
            fusion.run(intake, config.rate_hz, over)
        done.clock_offset_s = {name: watch.known.offset_s.get(name, float("nan")) for name in rig.names}
    done.memory_mb = peak_mb([os.getpid()])
    done.seconds = (plan.clock.now_ns() - begun_ns) / _S
    done.stopped_by = stopped[0] if stopped else ""
    return done
