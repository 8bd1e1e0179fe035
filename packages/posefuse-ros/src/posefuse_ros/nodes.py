"""One session on several machines: camera nodes where the cameras are, the fusion node anywhere."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from posefuse import core
from posefuse.api.arguments import lines_of, shown
from posefuse.api.live_run import LiveRun, finished_run, live_plan
from posefuse.core import LiveHealth, LivePreview, Pose3D, Progress, Rig, Skeleton
from posefuse.detection.choosing import BLAZEPOSE
from posefuse.foundation.channel import wait_any
from posefuse.foundation.parsing import ros_name
from posefuse.foundation.summary import Facts, Heading
from posefuse.health.camera_monitor import Monitor
from posefuse.realtime.fusion_loop import velocity_between
from posefuse.realtime.inputs import check_any, compare_rig
from posefuse.realtime.messages import Expected, SeenView, SessionClock, Status
from posefuse.realtime.networks import fetch_networks, settled_network
from posefuse.realtime.notices import never_waiting
from posefuse.realtime.processes import Groups
from posefuse.realtime.session import group_plans, run_session, stop_requests

from . import topics
from .camera_info import publish_intrinsics
from .camera_messages import message_from_joint_centres
from .dds import RosNode
from .dds_domain import network_of
from .live_output import Ros2Config, publish
from .messages import POSE_TYPE, message_from_detections, pose_from_message
from .network_views import CLOCKS_APART_NS, NetworkViews
from .ros_output import RosOutput
from .types import Intake

_S = 1_000_000_000
_POLL_S = 0.01
_JUDGE_NS = _S // 4


class CameraNode:
    """Sends the detections of its groups, and gives predictions from the network to them."""

    def __init__(self, rig: Rig, cameras: Sequence[str], node: RosNode, clock: SessionClock, skeleton: Skeleton) -> None:
        self.cameras, self.monitor, self.sent = tuple(cameras), Monitor(cameras), dict.fromkeys(cameras, 0)
        self._node, self._clock = node, clock
        self._poses = node.reader(topics.EXPECTED)
        self._intake = Intake(POSE_TYPE, pose_from_message)
        self._looked_for: Pose3D | None = None
        self._fusion, self._taken_ns = "", 0
        self._skeleton = skeleton
        self._judged_ns = 0
        self._output = RosOutput(node, rig)
        # announced now: a fusion node that waits for it need not wait for the first person
        node.writer(topics.DETECTIONS)

    def step(self, groups: Groups) -> None:
        """Wait for messages for 10 ms at most and handle them."""
        wait_any(groups.channels(), _POLL_S)
        self._take_poses(groups)
        for message in groups.messages():
            if isinstance(message, SeenView):
                self._send(message)
            elif isinstance(message, Status):
                for state in message.cameras:
                    self.monitor.take_state(state, message.t_ns)
            elif isinstance(message, LivePreview):
                publish(self._output, message)
        now_ns = self._clock.now_ns()
        if now_ns - self._judged_ns > _JUDGE_NS:
            self._judged_ns = now_ns
            cameras = self.monitor.judge(now_ns, groups.troubles())
            publish(self._output, LiveHealth(t_ns=now_ns, cameras=cameras))

    def _send(self, seen: SeenView) -> None:
        view = self.monitor.admit(
            seen.detections, self._clock.now_ns(), received_ns=seen.received_ns, still=seen.still
        )  # fmt: skip
        if view is not None:
            stages = {"received": seen.received_ns, "started": seen.started_ns, "detected": seen.detected_ns}
            self._node.publish(topics.DETECTIONS, message_from_detections(view, stages, seen.state), view.t_ns)
            self.sent[view.camera] += 1

    def _take_poses(self, groups: Groups) -> None:
        for sample in self._poses.take()[-1:]:
            now_ns = self._clock.now_ns()
            taken = self._intake.take(sample.raw)
            # one fusion node at a time, which goes by the same keypoints; another one only after that is gone
            if taken is None or taken[0].skeleton != self._skeleton:
                continue
            if sample.sender != self._fusion and now_ns - self._taken_ns < _S:
                continue
            self._fusion, self._taken_ns = sample.sender, now_ns
            pose = taken[0]
            if abs(pose.t_ns - now_ns) > CLOCKS_APART_NS:
                # by the clock of another machine, which is not synchronised
                pose = replace(pose, t_ns=now_ns)
            groups.expect(Expected(pose.t_ns, pose.xyz_world, velocity_between(self._looked_for, pose)))
            if self._looked_for is None or pose.t_ns - self._looked_for.t_ns > 25_000_000:
                self._looked_for = pose


@dataclass(frozen=True, kw_only=True)
class CameraNodeRun:
    """How a camera node went: frames sent and refused, and the name of the signal that ended it (empty: none)."""

    figures: Mapping[str, Any]
    stopped_by: str


def camera_node(
    rig: core.Rig | str | Path,
    sources: Mapping[str, str] | Sequence[str],
    *,
    name: str = "1",
    config: str | Path | None = None,
    settings: Mapping[str, Any] | None = None,
    ros: Mapping[str, Any] | None = None,
    duration_s: float | None = None,
    loop_s: float | None = None,
    progress: Progress | bool | None = None,
) -> CameraNodeRun:
    """Capture and detect on this machine, send 2D poses to the fusion node; the fused pose selects the image regions.

    Args:
        rig: the cameras of all machines. name: of this node, different on every machine.
        ros: the ROS 2 network, see `live`. The rest as for `track_live`.

    Raises:
        PosefuseError: settings or sources that cannot be.

    Examples:
        >>> import posefuse as pf
        >>> pf.camera_node("rig.toml", {"cam1": "usb:0"}, name="left").figures  # doctest: +SKIP
    """
    whole = live_plan(
        rig, sources, config=config, settings=settings, ros=ros, duration_s=duration_s, loop_s=loop_s
    )  # fmt: skip
    check_any(whole.inputs)
    with shown(progress) as news:
        say = lines_of(news, "live")
        cameras = whole.rig
        compare_rig(cameras, whole.inputs, say)
        fetch_networks(whole.config.detector, news)
        # all nodes of a session need the same keypoints
        detector = settled_network(whole.config.detector, len(whole.inputs), say, tuple(reversed(BLAZEPOSE)))
        chosen = replace(whole.config, detector=detector)
        clock = SessionClock.begin()
        plan = replace(whole, config=chosen, outputs={"ros2": Ros2Config()})
        names = [entry.camera for entry in whole.inputs]
        with (
            RosNode(f"posefuse_cameras_{ros_name(name)}", network_of(ros)) as node,
            Groups(group_plans(plan, clock)) as groups,
        ):
            publish_intrinsics(node, cameras, names, time.time_ns())
            skeleton = groups.wait_ready()
            say("; ".join(groups.whereabouts()))
            groups.begin(time.monotonic_ns())
            worker = CameraNode(cameras, names, node, clock, skeleton)
            for centres in groups.centres():
                node.publish(topics.JOINT_CENTRES, message_from_joint_centres(centres), centres.t_ns)
            end_ns = None if whole.duration_s is None else clock.now_ns() + round(whole.duration_s * _S)
            with stop_requests() as stopped:
                while not stopped and not worker.monitor.all_ended() and (end_ns is None or clock.now_ns() < end_ns):
                    worker.step(groups)
    refused = {camera: worker.monitor.refused(camera) for camera in worker.cameras}
    return CameraNodeRun(figures={"sent": worker.sent, "refused": refused}, stopped_by=stopped[0] if stopped else "")


def fusion_node(
    rig: core.Rig | str | Path,
    *,
    config: str | Path | None = None,
    settings: Mapping[str, Any] | None = None,
    outputs: Mapping[str, Mapping[str, Any]] | None = None,
    ros: Mapping[str, Any] | None = None,
    axes: str | None = None,
    duration_s: float | None = None,
    progress: Progress | bool | None = None,
) -> LiveRun:
    """Take the views of all camera nodes, track, publish in ROS 2; the arguments are those of `camera_node` and `track_live`.

    Raises:
        PosefuseError: settings or outputs that cannot be.

    Examples:
        >>> import posefuse as pf
        >>> pf.fusion_node("rig.toml", duration_s=60).figures["messages"]  # doctest: +SKIP
    """
    # views that came from ROS are not sent back there
    also = {**(outputs or {}), "ros2": {**(outputs or {}).get("ros2", {}), "detections": False}}
    given = live_plan(rig, [], config=config, settings=settings, outputs=also, ros=ros, axes=axes, duration_s=duration_s)
    cameras, chosen, network = given.rig, given.config, network_of(ros)
    with shown(progress) as news:
        note = lines_of(news, "live")
        clock = SessionClock.begin()
        note(f"waiting for views of {', '.join(cameras.names)} in domain {network.domain_id}")
        with never_waiting(note) as say:
            views = NetworkViews(cameras, network, clock, chosen, duration_s=given.duration_s, say=say)
            done = run_session(given, clock, lambda: views, say, remote=True)
    counts, senders = views.views.intake.counts, views.views.senders
    offset_s = done.fusion.watch.known.offset_s if done.fusion.watch is not None else {}
    offsets_ms = {camera: 1000 * offset_s.get(camera, float("nan")) for camera in cameras.names}
    more = {
        "messages": {"accepted": counts.accepted, "refused": counts.refused},
        "last_refusal": counts.last_refusal,
        "not_used": dict(senders.refused),
        "strangers": dict(senders.strangers),
        "clock_offset_ms": offsets_ms,
    }
    run = finished_run(done, more=more)
    clocks = Facts({camera: "not known" if math.isnan(ms) else f"{ms:+z.1f}" for camera, ms in offsets_ms.items()})
    return replace(run, blocks=(*run.blocks, Heading("Clocks, ms after the mean"), clocks))
