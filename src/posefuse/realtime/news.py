"""Changes in a session, reported immediately: cameras, outputs, the rig watch, messages of unknown senders."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TypeVar

from posefuse.health.cameras import OK, Event

from .fusion import Fusion
from .output_plan import PROCESS

Say = Callable[[str], None]
# a camera's changes are reported this far apart; what it has become meanwhile follows then
_QUIET_NS = 10_000_000_000
T = TypeVar("T")


class News:
    """Reports what is new; times are given from `zero_ns`, session time. `notices`: of where views come from."""

    def __init__(self, fusion: Fusion, zero_ns: int, say: Say, notices: Callable[[], Iterable[str]] = tuple) -> None:
        self._fusion, self._zero_ns, self._say, self._notices = fusion, zero_ns, say, notices
        self._cameras_said = self._outputs_said = 0
        self._trouble = ""
        self._camera_said: dict[str, Event] = {}
        self._camera_waits: dict[str, Event] = {}
        # the first trouble of a camera is reported at once, however short ago the camera began
        self._camera_troubled: set[str] = set()

    def report(self, now_ns: int) -> None:
        """Report what is new."""
        monitor, outlets, watch = self._fusion.monitor, self._fusion.outlets, self._fusion.watch
        for camera in _newest(monitor.events, monitor.event_count - self._cameras_said):
            self._camera_waits[camera.camera] = camera
        self._report_cameras(now_ns)
        for output in _newest(outlets.events, outlets.event_count - self._outputs_said):
            who = "outputs" if output.output == PROCESS else f"output {output.output}"
            self._say_at(output.t_ns, f"{who}: {output.state}", output.text)
        self._cameras_said, self._outputs_said = monitor.event_count, outlets.event_count
        for notice in self._notices():
            self._say_at(now_ns, notice, "")
        if watch is not None and watch.trouble != self._trouble:
            self._trouble = watch.trouble
            self._say_at(now_ns, "rig watch", watch.trouble)

    def _report_cameras(self, now_ns: int) -> None:
        for name, event in list(self._camera_waits.items()):
            before = self._camera_said.get(name)
            began = before is None or (name not in self._camera_troubled and before.state == OK)
            if before is not None and not began and now_ns - before.t_ns < _QUIET_NS:
                continue
            del self._camera_waits[name]
            if before is None or event.state != before.state:
                self._camera_said[name] = event
                self._say_at(event.t_ns, f"camera {name}: {event.state}", event.text)
                self._camera_troubled |= {name} if event.state not in (OK, "opening") else set()

    def _say_at(self, t_ns: int, what: str, why: str) -> None:
        self._say(f"{(t_ns - self._zero_ns) / 1e9:6.2f} s  {what}{': ' + why if why else ''}")


def _newest(events: Iterable[T], count: int) -> list[T]:
    # asked for every few milliseconds: mostly there is nothing
    return list(events)[-count:] if count else []
