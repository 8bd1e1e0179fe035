"""The session's side of its outputs: messages are handed on without waiting, and a process that dies is started again."""

from __future__ import annotations

import json
import time
from collections import deque
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, replace
from typing import Any

from posefuse import __version__
from posefuse.core import (
    InputError,
    LiveDetections,
    LiveHealth,
    LiveMessage,
    LiveOutputConfig,
    LivePose,
    LivePreview,
    LiveStart,
    OutputHealth,
    Rig,
)
from posefuse.core.live_messages import FAILED, OK
from posefuse.formats.recording import rig_values
from posefuse.foundation.channel import Channel, ChannelClosed
from posefuse.foundation.worker import Worker
from posefuse.health.camera_monitor import Event

from .config import LiveConfig
from .messages import LivePlan, RemoveOutput, SessionClock, Stop
from .output_process import END_S, HANGS, OPENING, OutputAdded, OutputsHealth, keep, run_outputs

PROCESS = "process"
_START_S = 60.0
# it reports four times a second: after the first limit its silence is reported, after the second it is ended
_SILENT_S = 2.0
_HUNG_S = 10.0
# messages are sent in batches, because each one wakes the other process: the longest time of a batch
_BATCH_S = 0.05
_END_SEND_S = 0.3


class SessionReader:
    """The end of a session of the program that began it: what it is given, never waiting for it. `images`: small images, too."""

    def __init__(self, channel: Channel, images: bool) -> None:
        self.takes = (LiveStart, LivePose, LiveHealth, *((LiveDetections, LivePreview) if images else ()))
        self._channel = channel
        # detections of frames without an image stay here
        self._views: dict[str, LiveDetections] = {}

    def take(self, message: LiveMessage) -> None:
        """Send it on; a program that is gone is noticed by the thread of its requests."""
        if isinstance(message, LiveDetections):
            self._views[message.detections.camera] = message
            return
        with suppress(ChannelClosed):
            if isinstance(message, LivePreview) and (view := self._views.get(message.camera)) is not None:
                self._channel.send(view)
            self._channel.send(message)


def notes_of(rig: Rig, config: LiveConfig) -> dict[str, str]:
    """How a session was made, as texts for a file."""
    return {
        "posefuse": __version__,
        "cameras": json.dumps(rig.names),
        "rig_id": rig.id,
        "rig": json.dumps(rig_values(rig)),
        "settings": json.dumps(asdict(config), default=str),
    }


def check_live_outputs(configs: Mapping[str, LiveOutputConfig]) -> None:
    """Build each output once, so that a missing package is named before any work; raises DependencyError."""
    for config in configs.values():
        config.build().close()


class OutputProcess:
    """Offers messages to the reader and the process of the outputs, and never waits; without outputs there is no process.

    Args:
        plan, clock: of the session. reader: the program that began it, if any; takes messages in the session's own thread, the
            first one at once.

    Attributes:
        lost: messages the process had no room for, or that came while there was no process.
        health: of every output, by name.
        events: what changed (named ``process``: for all outputs), oldest first, at most the newest 1000.
        event_count: of all there ever were.
    """

    def __init__(self, plan: LivePlan, clock: SessionClock, reader: SessionReader | None = None) -> None:
        self.lost = 0
        self.health: dict[str, OutputHealth] = {name: OutputHealth(state=OPENING) for name in plan.outputs}
        self.events: deque[Event] = deque(maxlen=1000)
        self.event_count = 0
        self._plan, self._clock, self._reader, self._configs = plan, clock, reader, dict(plan.outputs)
        self._first: LiveStart | None = None
        self._kept: dict[object, LiveMessage] = {}
        # messages that were not sent yet, and since when there are any
        self._batch: list[LiveMessage] = []
        self._batch_s = 0.0
        self._finished = self._ready = False
        # what was changed and not sent yet
        self._changes: list[OutputAdded | RemoveOutput] = []
        self._deaths = 0
        self._worker = Worker(run_outputs)
        if reader is not None:
            reader.take(self._start())
        if self._configs:
            self._begin()

    def wants(self, kind: type[LiveMessage]) -> bool:
        """Whether any output, or the reader, takes such messages."""
        read = self._reader is not None and kind in self._reader.takes
        return read or any(kind in config.takes for config in self._configs.values())

    @property
    def wants_newest(self) -> bool:
        """Whether any output is better off with a message now than with all of them later."""
        return not all(config.keeps_all for config in self._configs.values())

    def _start(self) -> LiveStart:
        """The first message."""
        rig, config = self._plan.rig, self._plan.config
        return LiveStart(
            t_ns=self._clock.now_ns(),
            rig=rig,
            rate_hz=config.rate_hz,
            clock_offset_ns=self._clock.offset_ns,
            notes=notes_of(rig, config),
            names=config.names,
        )

    @property
    def failed(self) -> bool:
        """Whether any output, or their process, failed at any time."""
        return self._worker.deaths > 0 or any(health.failures for health in self.health.values())

    def whereabouts(self) -> str:
        """In which process they are, in words."""
        return f"outputs {' '.join(self._configs)} in process {self._worker.pid}" if self._worker.running else ""

    def figures(self) -> dict[str, dict[str, Any]]:
        """Per output, what happened to what it was given."""
        return {name: {**asdict(health), "finished": self._finished} for name, health in self.health.items()}

    def wait_ready(self) -> None:
        """Wait until everything is open; raises InputError in the words of what could not be opened."""
        until_s = time.monotonic() + _START_S
        while any(health.state != OK for health in self.health.values()):
            if not self._worker.wait(max(until_s - time.monotonic(), 0.0)):
                raise InputError(f"outputs: not ready within {_START_S:g} s")
            self._take(self._worker.receive())
            if not self._worker.running:
                raise InputError(f"outputs: {self._worker.trouble} while starting")
            for health in self.health.values():
                if health.state == FAILED:
                    raise InputError(health.text)
        # one that opened slowly is no news
        self.events.clear()

    def offer(self, message: LiveMessage) -> None:
        """Hand a message on, if the reader or any output takes such, or an output that is opened later must have it.

        To the outputs it goes with others, soon; a pose at once where an output wants the newest.
        """
        if self._reader is not None and isinstance(message, self._reader.takes):
            self._reader.take(message)
        wanted = any(isinstance(message, config.takes) for config in self._configs.values())
        if not (keep(message, self._kept) or wanted) or not self.health:
            return
        if not self._ready:
            self.lost += 1
            return
        now_s = time.monotonic()
        if not self._batch:
            self._batch_s = now_s
        self._batch.append(message)
        urgent = not isinstance(message, LiveDetections) and self.wants_newest
        if urgent or now_s - self._batch_s >= _BATCH_S:
            self._send_batch()

    def _send_batch(self, wait_s: float = 0.0) -> None:
        batch, self._batch = self._batch, []
        if batch and not (self._ready and self._worker.send(batch, wait_s)):
            self.lost += len(batch)

    def poll(self) -> None:
        """Take in how the outputs fare, and start a process that died again."""
        self._send_batch()
        while (message := self._worker.receive()) is not None:
            self._take(message)
        worker = self._worker
        silent_s = worker.silent_s()
        if self._ready and worker.running:
            if silent_s > _HUNG_S:
                worker.fail(f"process {worker.pid} hung and was ended")
            elif silent_s > _SILENT_S:
                self._set_all(HANGS, f"process {worker.pid} has reported nothing for {_SILENT_S:g} s")
        self._change()
        self._note_death()
        if self._configs and worker.due():
            self._begin()

    def add(self, name: str, config: LiveOutputConfig) -> None:
        """Open another output; one of the same name that is open stays."""
        if name in self._configs:
            return
        self._configs[name] = config
        self.health[name] = OutputHealth(state=OPENING)
        # a process that is started for it opens all there are
        if self._worker.running:
            self._change(OutputAdded(name, config, self._start(), list(self._kept.values())))

    def remove(self, name: str) -> None:
        """Finish and close an output; it stays in `health` until that is done."""
        self._configs.pop(name, None)
        self._change(RemoveOutput(name))

    def _change(self, change: OutputAdded | RemoveOutput | None = None) -> None:
        """Send what was changed, and what there was no room for before."""
        if change is not None:
            self._changes.append(change)
            self._send_batch()
        while self._ready and self._changes and self._worker.send(self._changes[0]):
            self._changes.pop(0)

    def close(self) -> None:
        """Let it finish, files first; safe to call twice."""
        self._send_batch(_END_SEND_S)
        worker, asked = self._worker, False
        while worker.running and not self._finished:
            asked = asked or worker.send(Stop(), _END_SEND_S)
            # it reports until its files are finished, or make no progress any more
            if not worker.wait(END_S + 0.5):
                break
            self._take(worker.receive())
        if worker.running and self._ready and not self._finished:
            worker.fail("ended before the outputs had finished")
        worker.end(0.5)
        self._note_death(again=False)

    def _begin(self) -> None:
        self._note_death()
        self._first = self._first or self._start()
        first = replace(self._first, part=1 + max((health.failures for health in self.health.values()), default=0))
        self._ready, kept = False, list(self._kept.values())
        self._changes = [OutputAdded(name, one, first, kept, self.health[name]) for name, one in self._configs.items()]
        self._worker.start()

    def _take(self, message: OutputsHealth | None) -> None:
        if message is not None:
            self._ready, self._finished = True, message.final
            self._change()
            self._learn(message.health)
            for name in [name for name in self.health if name not in message.health and name not in self._configs]:
                del self.health[name]

    def _learn(self, health: Mapping[str, OutputHealth]) -> None:
        for name, now in health.items():
            # one that is opened again has failed until then
            if (known := self.health.get(name)) is None or now.state == OPENING:
                continue
            self.health[name] = now
            if now.failures > known.failures and now.state == OK:
                self._event(name, FAILED, now.fault)
            changed = (now.state, now.failures, now.fault) != (known.state, known.failures, known.fault)
            if changed and (known.state, now.state) != (OPENING, OK):
                self._event(name, now.state, now.text)

    def _note_death(self, again: bool = True) -> None:
        if self._worker.deaths == self._deaths:
            return
        self._deaths, self._ready = self._worker.deaths, False
        why = f"{self._worker.trouble}{'; starting again' if again else ''}"
        self._event(PROCESS, FAILED, why)
        for name, health in self.health.items():
            self.health[name] = replace(health, state=FAILED, text=why, fault=why, failures=health.failures + 1)

    def _set_all(self, state: str, text: str) -> None:
        for name, health in self.health.items():
            if health.state == OK:
                self.health[name] = replace(health, state=state, text=text)
                self._event(name, state, text)

    def _event(self, output: str, state: str, text: str) -> None:
        self.event_count += 1
        self.events.append(Event(self._clock.now_ns(), output, state, text))
