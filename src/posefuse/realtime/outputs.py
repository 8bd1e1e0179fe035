"""Everything that leaves the session, in a process of its own: a slow disk or network never holds the beat up."""

from __future__ import annotations

import contextlib
import os
import queue
import signal
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from posefuse.core import InputError, PosefuseError, Rig

from .channel import Channel, ChannelClosed
from .clock import SessionClock
from .processes import ended, spawned

NOTES = "posefuse_live"
_START_S = 60.0
_END_S = 1.5
_QUEUE = 4000
# what a live sink may be behind: about 60 ms of poses and views
_LIVE_QUEUE = 12


@dataclass(frozen=True)
class OutputPlan:
    """Where to send results; what is empty or None is not sent.

    Attributes:
        rig: the cameras. clock: of the session.
        record: .mcap file. notes: texts to keep in it, see `provenance`.
        osc, json_udp: ``host:port`` each. axes: of those two, see `wire.osc.AXES`.
        ros: `wire.dds.Network` to publish in. ros_views: 2D poses too; not where they came from the network.
        view: ``spawn`` opens the Rerun viewer, a path records an .rrd file, empty shows nothing.
    """

    rig: Rig
    clock: SessionClock
    record: Path | None = None
    notes: Mapping[str, str] = field(default_factory=dict)
    osc: tuple[str, ...] = ()
    json_udp: tuple[str, ...] = ()
    axes: str = "z_up"
    ros: Any = None
    ros_views: bool = True
    view: str = ""

    @property
    def empty(self) -> bool:
        """Nothing leaves."""
        return not (self.record or self.osc or self.json_udp or self.ros or self.view)


class LiveSink(Protocol):
    """One way out; each works in a thread of its own."""

    name: str
    keeps_all: bool

    def take(self, kind: str, values: Sequence[Any]) -> None:
        """One of the following, each with its values.

        ``centres`` (t_ns, Centres), ``view`` (Detections2D, stages), ``pose`` (Pose3D, stages, Joints or None), ``health``
        (t_ns, states, rates), ``preview`` (Preview).
        """
        ...

    def close(self) -> None:
        """Finish."""
        ...


class OutputProcess:
    """The session's side: offers values to the process and never waits for it.

    Attributes:
        lost: values the process had no room for.
        trouble: what is wrong with the process; empty when nothing is.
    """

    def __init__(self, plan: OutputPlan) -> None:
        self.lost, self.trouble = 0, ""
        self.figures: dict[str, Any] = {}
        self._channel, theirs = Channel.pair()
        self._process = spawned(run_outputs, plan, theirs, name="posefuse outputs")
        theirs.close_own()

    def wait_ready(self) -> None:
        """Wait until everything is open; raises InputError in the words of what could not be opened."""
        try:
            if not self._channel.wait(_START_S):
                raise InputError(f"outputs: not ready within {_START_S:g} s")
            kind, text = self._channel.receive() or ("failed", "outputs: their process said nothing")
        except ChannelClosed:
            raise InputError("outputs: their process ended while starting") from None
        if kind == "failed":
            raise InputError(text)

    def offer(self, kind: str, *values: Any) -> None:
        """Hand something on."""
        if self.trouble:
            self.lost += 1
            return
        try:
            self.lost += not self._channel.send((kind, values))
        except ChannelClosed:
            self.trouble = f"process {self._process.pid} ended; nothing is sent or recorded any more"

    def close(self) -> None:
        """Let it finish, files first; safe to call twice."""
        if self._process is None:
            return
        with contextlib.suppress(ChannelClosed):
            self._channel.send(("end", ()), 0.3)
            end_s = time.monotonic() + _END_S
            while not self.figures and self._channel.wait(max(0.0, end_s - time.monotonic())):
                kind, figures = self._channel.receive() or ("", {})
                if kind == "done":
                    self.figures = figures
        ended(self._process, 0.5)
        self._process = None
        self._channel.close()


def run_outputs(plan: OutputPlan, channel: Channel) -> None:
    """Body of the process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with contextlib.suppress(OSError):
        os.nice(2)
    try:
        sinks = _opened(plan)
    except PosefuseError as error:
        with contextlib.suppress(ChannelClosed):
            channel.send(("failed", str(error)), 1.0)
        return
    workers = [_Worker(sink) for sink in sinks]
    with contextlib.suppress(ChannelClosed):
        channel.send(("ready", ""), 1.0)
        _hand_out(channel, workers)
    figures = {worker.sink.name: worker.finished() for worker in workers}
    with contextlib.suppress(ChannelClosed):
        channel.send(("done", figures), 1.0)
    # a viewer or network that hangs must not keep the process
    os._exit(0)


def _hand_out(channel: Channel, workers: Sequence[_Worker]) -> None:
    while True:
        channel.wait(0.5)
        while (message := channel.receive()) is not None:
            kind, values = message
            if kind == "end":
                return
            for worker in workers:
                worker.put(kind, values)


class _Worker:
    """A sink's thread and its bounded queue: a recording keeps all it has room for, a live sink the newest."""

    def __init__(self, sink: LiveSink) -> None:
        self.sink = sink
        self._queue: queue.Queue[Any] = queue.Queue(_QUEUE if sink.keeps_all else _LIVE_QUEUE)
        self._taken = self._dropped = 0
        self._fault = ""
        self._thread = threading.Thread(target=self._run, name=sink.name, daemon=True)
        self._thread.start()

    def put(self, kind: str, values: Sequence[Any]) -> None:
        """Queue it, never waiting."""
        while True:
            try:
                self._queue.put_nowait((kind, values))
                return
            except queue.Full:
                self._dropped += 1
                if self.sink.keeps_all:
                    return
                with contextlib.suppress(queue.Empty):
                    self._queue.get_nowait()

    def finished(self) -> dict[str, Any]:
        """Take what is queued, close the sink, and say how it went."""
        while self._thread.is_alive():
            with contextlib.suppress(queue.Full):
                self._queue.put_nowait(None)
                break
            time.sleep(0.005)
        self._thread.join(_END_S)
        return {"taken": self._taken, "dropped": self._dropped, "fault": self._fault, "finished": not self._thread.is_alive()}

    def _run(self) -> None:
        while (item := self._queue.get()) is not None:
            try:
                self.sink.take(*item)
                self._taken += 1
            except (PosefuseError, OSError) as error:
                self._fault = str(error)
        self.sink.close()


def _opened(plan: OutputPlan) -> list[LiveSink]:
    from . import sinks

    makers: list[Callable[[], LiveSink]] = []
    if plan.record:
        makers.append(lambda: sinks.RecordSink(plan))
    if plan.ros:
        makers.append(lambda: sinks.RosSink(plan))
    if plan.osc:
        makers.append(lambda: sinks.UdpSink("osc", plan.osc, plan.axes))
    if plan.json_udp:
        makers.append(lambda: sinks.UdpSink("json", plan.json_udp, plan.axes))
    if plan.view:
        makers.append(lambda: sinks.ViewSink(plan))
    return [make() for make in makers]


class NoOutputs:
    """Nothing leaves: only figures are wanted."""

    lost, trouble = 0, ""
    figures: dict[str, Any] = {}  # noqa: RUF012 - never written

    def wait_ready(self) -> None:
        """Nothing to wait for."""

    def offer(self, kind: str, *values: Any) -> None:
        """Nobody wants it."""

    def close(self) -> None:
        """Nothing to close."""
