"""A camera node: sends detections of this machine's cameras, and receives the expected pose that selects image regions."""

from __future__ import annotations

from collections.abc import Sequence

from posefuse.core import CameraHealth, LiveHealth, LivePreview, Pose3D, Rig, Skeleton
from posefuse.foundation.channel import wait_any
from posefuse.health.cameras import Monitor
from posefuse.realtime.fusion import velocity_between
from posefuse.realtime.messages import Expected, SeenView, SessionClock, Status
from posefuse.realtime.processes import Groups

from . import topics
from .dds import RosNode
from .live_output import health_lines, publish_preview
from .messages import POSE_TYPE, message_from_detections, pose_from_message
from .ros_output import RosOutput
from .types import Intake

_S = 1_000_000_000
_POLL_S = 0.01
_JUDGE_NS = _S // 4
_MAX_BYTES = 2**20


class CameraNode:
    """Sends the detections of its groups, and gives predictions from the network to them."""

    def __init__(self, rig: Rig, cameras: Sequence[str], node: RosNode, clock: SessionClock, skeleton: Skeleton) -> None:
        self.cameras, self.monitor, self.sent = tuple(cameras), Monitor(cameras), dict.fromkeys(cameras, 0)
        self._rig, self._node, self._clock = rig, node, clock
        self._poses = node.reader(topics.EXPECTED)
        self._intake = Intake(POSE_TYPE, pose_from_message, _MAX_BYTES)
        self._looked_for: Pose3D | None = None
        self._fusion, self._taken_ns = "", 0
        self._skeleton = skeleton
        self._judged_ns = 0
        self._output = RosOutput(node, None)
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
                publish_preview(self._node, message, self._rig)
        now_ns = self._clock.now_ns()
        if now_ns - self._judged_ns > _JUDGE_NS:
            self._judged_ns = now_ns
            verdicts = self.monitor.judge(now_ns, groups.troubles())
            cameras = {name: CameraHealth(state=v.state, text=v.text) for name, v in verdicts.items()}
            self._output.diagnose(now_ns, health_lines(LiveHealth(t_ns=now_ns, cameras=cameras)))

    def _send(self, seen: SeenView) -> None:
        view = self.monitor.admit(seen, self._clock.now_ns())
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
            self._look_for(taken[0], groups)

    def _look_for(self, pose: Pose3D, groups: Groups) -> None:
        groups.expect(Expected(pose.t_ns, pose.xyz_world, velocity_between(self._looked_for, pose)))
        if self._looked_for is None or pose.t_ns - self._looked_for.t_ns > 25_000_000:
            self._looked_for = pose
