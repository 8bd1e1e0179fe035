"""The process of a live session's outputs: one thread and one bounded queue each; what fails is reported and opened again."""

from __future__ import annotations

import contextlib
import queue
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from posefuse.core import (
    LiveJointCentres,
    LiveMessage,
    LiveNames,
    LiveOutput,
    LiveOutputConfig,
    LiveStart,
    OutputHealth,
    PosefuseError,
)
from posefuse.core.live_messages import FAILED, OK
from posefuse.foundation.channel import Channel, ChannelClosed
from posefuse.foundation.parsing import one_line
from posefuse.foundation.platform import lower_priority
from posefuse.foundation.requests_to_end import wait_while_working

from .messages import RemoveOutput, Stop

# at the end an output that has made no progress for so long is given up; one that has nothing left ends at once
END_S = 5.0
_QUEUE = 4000
# what an output that wants the newest may be behind: about 60 ms of poses and detections
_LIVE_QUEUE = 12
_WAIT_S = 0.1
_REPORT_S = 0.25
_FIRST_RETRY_S = 0.5
_LONGEST_RETRY_S = 10.0
# after so long without a failure the next one is tried again soon
_SETTLED_S = 30.0
_HANGS_S = 2.0
OPENING, HANGS = "opening", "hangs"
NOTHING_YET = OutputHealth()


def keep(message: LiveMessage, kept: dict[object, LiveMessage]) -> bool:
    """Remember it if an output that is opened later must have it: the newest of each set of cameras, and of the names."""
    if not isinstance(message, (LiveJointCentres, LiveNames)):
        return False
    key = message.cameras if isinstance(message, LiveJointCentres) else LiveNames
    # in the order they came
    kept.pop(key, None)
    kept[key] = message
    return True


@dataclass(frozen=True)
class OutputsHealth:
    """How the outputs fare: the first one of a process has none, the last one is `final`."""

    health: Mapping[str, OutputHealth]
    final: bool = False


@dataclass(frozen=True)
class OutputAdded:
    """Open an output.

    Attributes:
        start: its first message. kept: those it must have seen before all others.
        known: what it took and dropped, and how often it failed, in former processes.
    """

    name: str
    config: LiveOutputConfig
    start: LiveStart
    kept: Sequence[LiveMessage] = ()
    known: OutputHealth = NOTHING_YET


def run_outputs(channel: Channel) -> None:
    """Body of the process; its outputs are added to it."""
    lower_priority(2)
    workers: list[OutputThread] = []
    with contextlib.suppress(ChannelClosed):
        channel.send(OutputsHealth({}), 1.0)
        _hand_out(channel, workers)
    # also when the session was killed: files are finished
    for worker in workers:
        worker.finish()

    def report() -> None:
        with contextlib.suppress(ChannelClosed):
            channel.send(OutputsHealth(_health(workers)))

    wait_while_working(lambda: [worker.health() for worker in workers if not worker.finished], END_S, report)
    for worker in workers:
        worker.join(0.0)
    with contextlib.suppress(ChannelClosed):
        channel.send(OutputsHealth(_health(workers), final=True), 1.0)


def _hand_out(channel: Channel, workers: list[OutputThread]) -> None:
    reported, reported_s = _states(workers), time.monotonic()
    while True:
        channel.wait(_WAIT_S)
        while (message := channel.receive()) is not None:
            if isinstance(message, Stop):
                return
            if isinstance(message, OutputAdded):
                workers.append(OutputThread(message))
            elif isinstance(message, RemoveOutput):
                for worker in workers:
                    if worker.name == message.name:
                        worker.finish()
            else:
                for one in message:
                    for worker in workers:
                        worker.put(one)
        workers[:] = [worker for worker in workers if not worker.finished]
        now_s, states = time.monotonic(), _states(workers)
        # a report there is no room for is sent again
        if (states != reported or now_s - reported_s > _REPORT_S) and channel.send(OutputsHealth(_health(workers))):
            reported, reported_s = states, now_s


def _health(workers: Sequence[OutputThread]) -> dict[str, OutputHealth]:
    return {worker.name: worker.health() for worker in workers}


def _states(workers: Sequence[OutputThread]) -> list[tuple[str, int]]:
    return [(health.state, health.failures) for health in _health(workers).values()]


class OutputThread:
    """An output's thread, which opens it, and its queue: one that keeps all is given what it has room for, another the newest."""

    def __init__(self, added: OutputAdded) -> None:
        self.name, self._config, self._start = added.name, added.config, added.start
        self._queue: queue.Queue[LiveMessage | None] = queue.Queue(_QUEUE if added.config.keeps_all else _LIVE_QUEUE)
        self._kept: dict[object, LiveMessage] = {}
        for message in added.kept:
            if isinstance(message, added.config.takes):
                keep(message, self._kept)
        self._part, self._retry_s, self._again_s = added.start.part, _FIRST_RETRY_S, 0.0
        self._failed_s = self._busy_s = 0.0
        self._output: LiveOutput | None = None
        self._now = replace(added.known, state=OPENING, text="")
        self._ending = False
        self._dropped = added.known.dropped
        self._thread = threading.Thread(target=self._run, name=added.name, daemon=True)
        self._thread.start()

    @property
    def finished(self) -> bool:
        """Whether it was asked for its end, and has come to it."""
        return self._ending and not self._thread.is_alive()

    def put(self, message: LiveMessage) -> None:
        """Queue it, never waiting."""
        if self._ending or not isinstance(message, self._config.takes):
            return
        while True:
            try:
                self._queue.put_nowait(message)
                return
            except queue.Full:
                self._dropped += 1
                if self._config.keeps_all:
                    return
                with contextlib.suppress(queue.Empty):
                    self._queue.get_nowait()

    def health(self) -> OutputHealth:
        """As it is now."""
        now = replace(self._now, dropped=self._dropped)
        busy_s = self._busy_s
        if not busy_s or time.monotonic() - busy_s <= _HANGS_S:
            return now
        what = "has taken nothing" if self._output is not None else "has been opening"
        return replace(now, state=HANGS, text=f"{what} for more than {_HANGS_S:g} s")

    def finish(self) -> None:
        """Request the end, after the queued messages; for an output that hangs one message is dropped."""
        self._ending = True
        while self._thread.is_alive():
            try:
                self._queue.put_nowait(None)
                return
            except queue.Full:
                with contextlib.suppress(queue.Empty):
                    self._queue.get_nowait()
                    self._dropped += 1

    def join(self, wait_s: float) -> None:
        """Wait for the end; one that does not come counts as a failure."""
        self._thread.join(wait_s)
        if self._thread.is_alive():
            self._fail(f"not finished, and no progress for {END_S:g} s; what it wrote last may be missing")

    def _run(self) -> None:
        self._busy_s = time.monotonic()
        self._open()
        self._busy_s = 0.0
        while (message := self._queue.get()) is not None:
            keep(message, self._kept)
            self._busy_s = time.monotonic()
            if self._output is None and not self._open():
                self._dropped += 1
            elif self._output is not None:
                self._take(self._output, message)
            self._busy_s = 0.0
        self._close()

    def _take(self, output: LiveOutput, message: LiveMessage) -> None:
        try:
            output.take(message)
            self._now = replace(self._now, taken=self._now.taken + 1)
        except Exception as error:  # noqa: BLE001 - others' outputs may fail in any way; it is reported, not hidden
            self._dropped += 1
            self._again_later(words_of(error, output.where))

    def _opened(self) -> LiveOutput:
        output = self._config.build()
        try:
            output.take(replace(self._start, part=self._part))
            for message in self._kept.values():
                output.take(message)
        except BaseException:
            with contextlib.suppress(Exception):
                output.close()
            raise
        return output

    def _open(self) -> bool:
        """Whether it is open now; not tried before it is time to try again."""
        if time.monotonic() < self._again_s:
            return False
        try:
            self._output = self._opened()
        except Exception as error:  # noqa: BLE001 - see `_take`
            self._again_later(words_of(error, self.name), counts=False)
            return False
        where = self._output.where
        first = self._part == 1 and self._now.state == OPENING
        text = "" if first else f"continues in {where}" if where else "continues"
        self._now = replace(self._now, state=OK, text=text, where=where)
        return True

    def _again_later(self, why: str, counts: bool = True) -> None:
        now_s = time.monotonic()
        self._retry_s = _FIRST_RETRY_S if now_s - self._failed_s > _SETTLED_S else min(2 * self._retry_s, _LONGEST_RETRY_S)
        self._failed_s, self._again_s = now_s, now_s + self._retry_s
        self._part += counts
        # what closing raises is of the same cause
        output, self._output = self._output, None
        with contextlib.suppress(Exception):
            if output is not None:
                output.close()
        self._fail(why, counts)

    def _fail(self, why: str, counts: bool = True) -> None:
        now = self._now
        self._now = replace(now, state=FAILED, text=why, fault=why, failures=now.failures + counts)

    def _close(self) -> None:
        output, self._output = self._output, None
        if output is None:
            return
        try:
            output.close()
        except Exception as error:  # noqa: BLE001 - see `_take`
            self._fail(f"not finished: {words_of(error, output.where)}")


def words_of(error: Exception, where: str) -> str:
    """One line about what an output raised."""
    if isinstance(error, PosefuseError):
        return str(error)
    if isinstance(error, OSError):
        return f"{where}: {error.strerror or error}"
    return f"{where}: {type(error).__name__}: {one_line(error)}"
