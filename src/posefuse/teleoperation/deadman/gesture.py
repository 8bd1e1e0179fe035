"""The other hand raised above its shoulder: for simulated robots, because it comes through the cameras it is to guard against."""

from __future__ import annotations

from posefuse.teleoperation.heartbeats import Beat
from posefuse.teleoperation.values import OperatorView

from .protocol import Pressed


class GestureSwitch:
    """The other hand up: follow (`DeadMan`)."""

    hint = "raise the other hand above its shoulder to move; Ctrl-C: end"

    def __init__(self) -> None:
        self._seq, self._t_ns = 0, -1

    def poll(self, now_ns: int, view: OperatorView | None) -> Pressed:
        """See `DeadMan`: one heartbeat for each new pose that shows the gesture."""
        if view is None or view.t_ns <= self._t_ns or not view.gesture:
            return Pressed()
        self._seq, self._t_ns = self._seq + 1, view.t_ns
        return Pressed(beats=(Beat(seq=self._seq, sent_ns=min(view.measured_ns, now_ns)),))

    def close(self) -> None:
        """See `DeadMan`."""
