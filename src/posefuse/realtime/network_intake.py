"""Views that camera nodes send, as the fusion takes them."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping
from typing import Any

from posefuse.core import Rig, Skeleton
from posefuse.messages import topics
from posefuse.messages.dds import Network, RosNode
from posefuse.messages.intake import Intake
from posefuse.messages.joint_centre_messages import JOINT_CENTRES_TYPE
from posefuse.messages.messages import DETECTIONS_TYPE, detections_from_message

from .channel import Channel, ChannelClosed
from .clock import SessionClock
from .joint_centres import centres_from_message
from .messages import Centres, Seen

_WAIT_S = 0.2
_AT_ONCE = 64
_MAX_BYTES = 2**18


class NetworkIntake:
    """Reads the topics of 2D poses, and of where joint centres lie beside them, in a thread of its own.

    Attributes:
        rig: its cameras are taken. clock: of the session.
        intake: counts what came and what was refused, and why. strangers: views of cameras the rig does not have.
        centres: what was told of joint centres before the first view was taken.
        dropped: views the fusion had no room for.
    """

    def __init__(self, rig: Rig, network: Network, clock: SessionClock, name: str = "posefuse_fusion_intake") -> None:
        self.intake = Intake(DETECTIONS_TYPE, detections_from_message, _MAX_BYTES)
        self.strangers: dict[str, int] = {}
        self.centres: list[Centres] = []
        self.dropped = 0
        self.rig, self.clock = rig, clock
        self._names = set(rig.names)
        self._node = RosNode(name, network)
        self._reader = self._node.reader(topics.DETECTIONS)
        self._centres_reader = self._node.reader(topics.JOINT_CENTRES)
        self._centres_intake = Intake(JOINT_CENTRES_TYPE, centres_from_message, _MAX_BYTES, self.intake.counts)
        self._ours, self._theirs = Channel.pair()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="views from the network", daemon=True)
        self._thread.start()

    def channels(self) -> list[Channel]:
        """For `select`."""
        return [self._ours]

    def messages(self) -> Iterator[Seen | Centres]:
        """What has come; never waits."""
        for _ in range(_AT_ONCE):
            told = self._ours.receive()
            if told is None:
                return
            yield told

    def troubles(self) -> Mapping[str, str]:
        """Nothing is known of processes on other machines; their silence is seen by the monitor."""
        return {}

    def first_skeleton(self, timeout_s: float) -> Skeleton | None:
        """Skeleton of the first view that comes; None when none does."""
        if not self._ours.wait(timeout_s):
            return None
        for told in self.messages():
            if isinstance(told, Seen):
                return told.detections.skeleton
            self.centres.append(told)
        return None

    def close(self) -> None:
        """Leave the network."""
        self._stop.set()
        self._thread.join(2 * _WAIT_S)
        self._node.close()
        self._ours.close()
        self._theirs.close()

    def _run(self) -> None:
        while not self._stop.is_set():
            if not self._node.wait(_WAIT_S):
                continue
            try:
                self._hand_on()
            except ChannelClosed:
                return

    def _hand_on(self) -> None:
        for sample in self._centres_reader.take():
            if (told := self._centres_intake.take(sample.raw)) is not None:
                self._theirs.send(told, _WAIT_S)
        for sample in self._reader.take():
            taken = self.intake.take(sample.raw)
            if taken is None:
                continue
            seen = _seen(*taken, sample.sent_ns, self.clock.now_ns())
            if seen.detections.camera in self._names:
                self.dropped += not self._theirs.send(seen)
                continue
            camera = seen.detections.camera if len(self.strangers) < 100 else "others"
            self.strangers[camera] = self.strangers.get(camera, 0) + 1


def _seen(view: Any, stages: Mapping[str, int], sent_ns: int, now_ns: int) -> Seen:
    received_ns = stages.get("received", min(sent_ns, now_ns))
    started_ns = stages.get("started", received_ns)
    return Seen(
        detections=view,
        state=None,
        received_ns=received_ns,
        started_ns=started_ns,
        detected_ns=stages.get("detected", started_ns),
    )
