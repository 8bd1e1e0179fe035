"""The session's side of its outputs: messages are handed on without waiting, and a process that dies is started again."""

from __future__ import annotations

import contextlib
import pickle
import time
from collections import deque
from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Any

from posefuse.core import InputError, LiveDetections, LiveMessage, LiveOutputConfig, LiveStart, OutputHealth
from posefuse.core.live_messages import FAILED, OK
from posefuse.foundation.channel import Channel, ChannelClosed

from .kept_messages import KeptMessages
from .output_plan import PROCESS, OutputEvent, OutputPlan
from .output_process import (
    END_S,
    HANGS,
    Bundle,
    OutputAdded,
    OutputRemoved,
    OutputsEnd,
    OutputsFailed,
    OutputsHealth,
    OutputsReady,
    run_outputs,
)
from .processes import death_of, ended, spawned

_START_S = 60.0
_FIRST_RETRY_S = 0.2
_LONGEST_RETRY_S = 10.0
# it reports four times a second: after the first limit its silence is reported, after the second it is ended
_SILENT_S = 2.0
_HUNG_S = 10.0
# messages are sent in batches, because each one wakes the other process: longest time and most bytes of a batch, far below what
# a channel carries at once
_BUNDLE_S, _BUNDLE_BYTES = 0.05, 1 << 16
_END_SEND_S = 0.3


class OutputProcess:
    """Offers messages to the process of the outputs and never waits for it; while there are no outputs there is no process.

    Attributes:
        lost: messages the process had no room for, or that came while there was no process.
        health: of every output, by name.
        events: what changed, oldest first, at most the newest 1000. event_count: of all there ever were.
    """

    def __init__(self, plan: OutputPlan) -> None:
        self.lost = 0
        self.health: dict[str, OutputHealth] = {name: OutputHealth(state="opening") for name in plan.configs}
        self.events: deque[OutputEvent] = deque(maxlen=1000)
        self.event_count = 0
        # the reader is given its messages by the session itself
        self._plan = replace(plan, reader=None)
        self._first: LiveStart | None = None
        # what former processes took, dropped and failed
        self._before = dict.fromkeys(plan.configs, OutputHealth())
        self._kept = KeptMessages()
        # pickled messages that were not sent yet, and since when there are any
        self._bundle: list[bytes] = []
        self._bundled_s = 0.0
        self._deaths, self._retry_s, self._again_s = 0, _FIRST_RETRY_S, 0.0
        self._finished = self._ready = False
        self._received_s = 0.0
        # None while a process that died waits to be started again
        self._process: Any = None
        if plan.configs:
            self._begin()

    @property
    def failed(self) -> bool:
        """Whether any output, or their process, failed at any time."""
        return self._deaths > 0 or any(health.failures for health in self.health.values())

    def whereabouts(self) -> str:
        """In which process they are, in words."""
        return f"outputs {' '.join(self._plan.configs)} in process {self._process.pid}" if self._process else ""

    def figures(self) -> dict[str, dict[str, Any]]:
        """Per output, what happened to what it was given."""
        return {name: {**asdict(health), "finished": self._finished} for name, health in self.health.items()}

    def wait_ready(self) -> None:
        """Wait until everything is open; raises InputError in the words of what could not be opened."""
        if self._process is None:
            return
        try:
            if not self._channel.wait(_START_S):
                raise InputError(f"outputs: not ready within {_START_S:g} s")
            message = self._channel.receive()
        except ChannelClosed:
            raise InputError(f"outputs: {death_of(self._process)} while starting") from None
        if isinstance(message, OutputsFailed):
            raise InputError(message.reason)
        self._take(message)

    def offer(self, message: LiveMessage) -> None:
        """Hand a message on, if any output takes such, or one that is opened later must have it.

        It goes with others, soon; a pose at once where an output wants the newest.
        """
        if not (self._kept.keep(message) or self._plan.wants(type(message))) or not self.health:
            return
        if not self._ready:
            self.lost += 1
            return
        raw, now_s = pickle.dumps(message, pickle.HIGHEST_PROTOCOL), time.monotonic()
        if sum(map(len, self._bundle)) + len(raw) > _BUNDLE_BYTES:
            self._send_bundle()
        if not self._bundle:
            self._bundled_s = now_s
        self._bundle.append(raw)
        urgent = not isinstance(message, LiveDetections) and self._plan.wants_newest
        if urgent or now_s - self._bundled_s >= _BUNDLE_S:
            self._send_bundle()

    def _send_bundle(self, wait_s: float = 0.0) -> None:
        bundle, self._bundle = self._bundle, []
        if not bundle:
            return
        try:
            sent = self._ready and self._channel.send(Bundle(bundle), wait_s)
        except ChannelClosed:
            sent = False
            self._died(death_of(self._process))
        self.lost += 0 if sent else len(bundle)

    def poll(self) -> None:
        """Take in how the outputs fare, and start a process that died again."""
        if self._process is None:
            if self._plan.configs and time.monotonic() >= self._again_s:
                self._begin()
            return
        self._send_bundle()
        if self._process is None:
            return
        try:
            while (message := self._channel.receive()) is not None:
                self._take(message)
                if self._process is None:
                    return
        except ChannelClosed:
            self._died(death_of(self._process))
            return
        self._change()
        silent_s = time.monotonic() - self._received_s
        if self._ready and silent_s > _HUNG_S:
            self._process.kill()
            self._died(f"process {self._process.pid} hung and was ended")
        elif self._ready and silent_s > _SILENT_S:
            self._set_all(HANGS, f"process {self._process.pid} has reported nothing for {_SILENT_S:g} s")

    def add(self, name: str, config: LiveOutputConfig) -> None:
        """Open another output; one of the same name that is open stays."""
        if name in self._plan.configs:
            return
        if self._process is None and not self._plan.configs:
            self._begin()
        self._plan = replace(self._plan, configs={**self._plan.configs, name: config})
        self.health[name], self._before[name] = OutputHealth(state="opening"), OutputHealth()
        self._opening.add(name)
        self._change(OutputAdded(name, config, self._plan.start()))

    def remove(self, name: str) -> None:
        """Finish and close an output; it stays in `health` until that is done."""
        self._plan = replace(self._plan, configs={other: one for other, one in self._plan.configs.items() if other != name})
        self._change(OutputRemoved(name))

    def _change(self, change: OutputAdded | OutputRemoved | None = None) -> None:
        """Send what was changed, and what there was no room for before."""
        if change is not None:
            self._changes.append(change)
            self._send_bundle()
        with contextlib.suppress(ChannelClosed):
            while self._ready and self._changes and self._channel.send(self._changes[0]):
                self._changes.pop(0)

    def close(self) -> None:
        """Let it finish, files first; safe to call twice."""
        self._send_bundle(_END_SEND_S)
        if self._process is None:
            return
        with contextlib.suppress(ChannelClosed):
            asked = False
            while not self._finished:
                asked = asked or self._channel.send(OutputsEnd(), _END_SEND_S)
                # it reports until its files are finished, or make no progress any more
                if not self._channel.wait(END_S + 0.5):
                    break
                self._take(self._channel.receive())
                if self._process is None:
                    return
        if self._ready and not self._finished:
            self._count_death("ended before the outputs had finished")
        ended(self._process, 0.5)
        self._channel.close()
        self._process = None

    def _begin(self) -> None:
        self._channel, theirs = Channel.pair()
        self._first = self._first or self._plan.start()
        first = replace(self._first, part=1 + max((health.failures for health in self.health.values()), default=0))
        self._process = spawned(run_outputs, dict(self._plan.configs), first, theirs, name="posefuse outputs")
        theirs.close_own()
        # it is given all outputs that are open by now
        self._changes: list[OutputAdded | OutputRemoved] = []
        self._ready, self._received_s = False, time.monotonic()
        # those of which it is not known yet whether they can be opened
        self._opening = set(self._plan.configs)

    def _take(self, message: Any) -> None:
        self._received_s = time.monotonic()
        if isinstance(message, OutputsFailed):
            self._died(message.reason)
        elif isinstance(message, OutputsReady):
            self._ready = True
            for kept in self._kept.messages():
                self._channel.send(kept)
            self._learn(message.health)
        elif isinstance(message, OutputsHealth):
            self._retry_s = _FIRST_RETRY_S
            self._finished = message.final
            self._learn(message.health)
            for name in [name for name in self.health if name not in message.health and name not in self._plan.configs]:
                del self.health[name]

    def _learn(self, health: Mapping[str, OutputHealth]) -> None:
        for name, now in health.items():
            if name not in self.health or (name in self._opening and now.state == "opening"):
                continue
            first = name in self._opening
            self._opening.discard(name)
            known, before = self.health[name], self._before[name]
            new = replace(
                now,
                taken=before.taken + now.taken,
                dropped=before.dropped + now.dropped,
                failures=before.failures + now.failures,
                fault=now.fault or before.fault,
            )
            self.health[name] = new
            if new.failures > known.failures and new.state == OK:
                self._event(name, FAILED, new.fault)
            if first and new.state == OK:
                new = self.health[name] = replace(new, text=new.text or new.where)
            changed = first or (new.state, new.failures) != (known.state, known.failures)
            if changed and (known.state, new.state) != ("opening", OK):
                self._event(name, new.state, new.text)

    def _died(self, why: str) -> None:
        self._process.join(0)
        self._channel.close()
        self._count_death(f"{why}; starting again")
        self._process, self._ready = None, False
        self._again_s = time.monotonic() + self._retry_s
        self._retry_s = min(2 * self._retry_s, _LONGEST_RETRY_S)

    def _count_death(self, why: str) -> None:
        self._deaths += 1
        self._event(PROCESS, FAILED, why)
        for name, health in self.health.items():
            self.health[name] = replace(health, state=FAILED, text=why, fault=why, failures=health.failures + 1)
        self._before = dict(self.health)

    def _set_all(self, state: str, text: str) -> None:
        for name, health in self.health.items():
            if health.state == OK:
                self.health[name] = replace(health, state=state, text=text)
                self._event(name, state, text)

    def _event(self, output: str, state: str, text: str) -> None:
        self.event_count += 1
        self.events.append(OutputEvent(self._plan.clock.now_ns(), output, state, text))
