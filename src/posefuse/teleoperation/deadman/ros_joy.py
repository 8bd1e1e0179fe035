"""Button 0 of a joystick over ROS (`sensor_msgs/Joy`): each message with the button down is a heartbeat."""

from __future__ import annotations

import time

from posefuse.core import MessageError
from posefuse.messages.intake import decode
from posefuse.messages.topics import Topic
from posefuse.teleoperation.heartbeats import Beat
from posefuse.teleoperation.robots.reports import RosPlan
from posefuse.teleoperation.values import OperatorView

from .protocol import Pressed

_MOST_BYTES = 10_000
_JOY = "sensor_msgs/msg/Joy"


class RosJoySwitch:
    """Button 0 held: follow. 1: gripper. 2: emergency stop. 3: reset (`DeadMan`). joy_node repeats at 20 Hz by default.

    ROS 2: messages count by their source time on this machine's clock, so the clocks of two machines must agree. ROS 1 has no
    source time: they count by their arrival, and a message that waited in the network counts as new.
    """

    def __init__(self, topic: str, ros: RosPlan) -> None:
        self.hint = f"hold button 0 of {topic} to move; button 1: gripper, 2: emergency stop, 3: reset, Ctrl-C: end"
        self._node = ros.node("posefuse_deadman")
        self._reader = self._node.reader(Topic(topic, _JOY, depth=10))
        self._seq, self._grip, self._down = 0, False, frozenset[int]()

    def poll(self, now_ns: int, view: OperatorView | None) -> Pressed:
        """See `DeadMan`; unreadable messages count as released."""
        beats, events = [], set[int]()
        offset_ns = time.time_ns() - now_ns
        for sample in self._reader.take():
            try:
                buttons = list(decode(sample.raw, _JOY, _MOST_BYTES).buttons)
            except (MessageError, AttributeError):
                continue
            down = frozenset(i for i, pressed in enumerate(buttons[:16]) if pressed)
            events |= down - self._down
            self._grip ^= 1 in down - self._down
            self._down = down
            if 0 in down:
                self._seq += 1
                # a stamp a little ahead is of now: clocks of two machines differ
                sent_ns = min(sample.sent_ns - offset_ns, now_ns)
                beats.append(Beat(seq=self._seq, sent_ns=sent_ns, grip=self._grip))
        return Pressed(beats=tuple(beats), emergency=2 in events, reset=3 in events)

    def close(self) -> None:
        """See `DeadMan`."""
        self._node.close()
