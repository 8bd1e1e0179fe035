"""News of a session: changes of cameras and outputs, a machine that is too slow; who reads it is never waited for."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from typing import TypeVar

from posefuse.core.protocols import NOISE_NOT_FITTED
from posefuse.health.camera_monitor import OK, Event

from .fusion_loop import Fusion
from .outputs import PROCESS

Say = Callable[[str], None]
# a camera's changes are reported this far apart; what it has become meanwhile follows then
_QUIET_NS = 10_000_000_000
T = TypeVar("T")
# a sentence is due when a smaller share of the images is processed over this time
LEAST_SHARE, _OVER_NS = 0.5, 10_000_000_000
# that see a person, before it has a place
LEAST_CAMERAS = 2
_MOST_LINES = 1000
_END_S = 2.0


class News:
    """Reports what is new; times are given from `zero_ns`, session time.

    Args:
        notices: of where views come from.
        watches_pace: report where this machine is too slow; not for views of other machines.
    """

    def __init__(
        self,
        fusion: Fusion,
        zero_ns: int,
        say: Say,
        notices: Callable[[], Iterable[str]] = tuple,
        *,
        watches_pace: bool,
    ) -> None:
        self._fusion, self._zero_ns, self._say, self._notices = fusion, zero_ns, say, notices
        # no longer, either, when a machine that is too slow was reported
        self._watches_pace = watches_pace
        # when images were counted last; how many had come, and how many of them were processed
        self._counted_ns, self._came, self._used = zero_ns, 0, 0
        self._cameras_said = self._outputs_said = 0
        self._trouble = ""
        self._noise_scale: float | None = None
        self._camera_said: dict[str, Event] = {}
        self._camera_waits: dict[str, Event] = {}
        # the first trouble of a camera is reported at once, however short ago the camera began
        self._camera_troubled: set[str] = set()

    def report(self, now_ns: int) -> None:
        """Report what is new."""
        monitor, outlets, watch = self._fusion.monitor, self._fusion.outlets, self._fusion.watch
        for camera in _newest(monitor.events, monitor.event_count - self._cameras_said):
            self._camera_waits[camera.name] = camera
        self._report_cameras(now_ns)
        self._report_pace(now_ns)
        for output in _newest(outlets.events, outlets.event_count - self._outputs_said):
            who = "outputs" if output.name == PROCESS else f"output {output.name}"
            self._say_at(output.t_ns, f"{who}: {output.state}", output.text)
        self._cameras_said, self._outputs_said = monitor.event_count, outlets.event_count
        for notice in self._notices():
            self._say_at(now_ns, notice, "")
        if watch is not None and watch.trouble != self._trouble:
            self._trouble = watch.trouble
            self._say_at(now_ns, "rig watch", watch.trouble)
        if (scale := self._fusion.noise_scale) is not None and self._noise_scale is None:
            self._noise_scale = scale
            self._say_at(now_ns, f"{NOISE_NOT_FITTED}; scaled by {scale:.2g} from this session", "")

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

    def _report_pace(self, now_ns: int) -> None:
        if not self._watches_pace or now_ns - self._counted_ns < _OVER_NS:
            return
        sources = [self._fusion.monitor.source(name) for name in self._fusion.rig.names]
        all_came, all_used = sum(source.captured for source in sources), sum(source.used for source in sources)
        came, used = all_came - self._came, all_used - self._used
        self._counted_ns, self._came, self._used = now_ns, all_came, all_used
        if used < LEAST_SHARE * came:
            self._watches_pace = False
            what = f"this computer processes {used / came:.0%} of the images"
            self._say_at(now_ns, what, "use fewer cameras, cameras at a lower frame rate, or a smaller network")

    def _say_at(self, t_ns: int, what: str, why: str) -> None:
        self._say(f"{(t_ns - self._zero_ns) / 1e9:6.2f} s  {what}{': ' + why if why else ''}")


def _newest(events: Iterable[T], count: int) -> list[T]:
    # asked for every few milliseconds: mostly there is nothing
    return list(events)[-count:] if count else []


@contextmanager
def never_waiting(say: Say) -> Iterator[Say]:
    """Call `say` in a thread of its own; what there is no room for is lost. What it raises, the next call raises.

    At the end the lines that are left are given a moment.
    """
    lines: queue.Queue[str | None] = queue.Queue(_MOST_LINES)
    problems: list[Exception] = []

    def run() -> None:
        while (line := lines.get()) is not None:
            try:
                say(line)
            except Exception as error:  # noqa: BLE001 - a closed terminal or connection; raised where the session notices it
                problems.append(error)
                return

    def put(line: str) -> None:
        if problems:
            raise problems[0]
        with suppress(queue.Full):
            lines.put_nowait(line)

    thread = threading.Thread(target=run, name="news", daemon=True)
    thread.start()
    try:
        yield put
    finally:
        with suppress(queue.Full):
            lines.put_nowait(None)
            thread.join(_END_S)
