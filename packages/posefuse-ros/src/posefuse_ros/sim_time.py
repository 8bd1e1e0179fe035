"""Simulated time: `/clock` of ROS against the clock of this machine.

A simulator runs slower or faster than real time and may stop. A line through the newest second of `/clock` maps its time to the
time on this machine at which it was reached, and back.
"""

from __future__ import annotations

import time
from collections import deque
from typing import Any

import numpy as np

from posefuse.core import SourceError

from .messages import ns_from_time
from .topics import CLOCK
from .types import Intake

_KEPT_NS = 1_000_000_000
_KEPT = 256
_POLL_S = 0.02
_APART_NS = 2_000_000
# how long a simulator may take to publish its time
_WITHIN_S = 10.0


class SimulatedClock:
    """Pairs of simulated and real time as they are received; it reads no clock."""

    def __init__(self) -> None:
        self._pairs: deque[tuple[int, int]] = deque(maxlen=_KEPT)

    def add(self, sim_ns: int, real_ns: int) -> None:
        """`/clock` showed `sim_ns` at `real_ns`."""
        newest = self._pairs[-1] if self._pairs else None
        if newest is not None and sim_ns <= newest[0]:
            # it stands still, or began again: earlier pairs do not predict later ones
            self._pairs.clear()
        elif newest is not None and real_ns - newest[1] < _APART_NS:
            return
        self._pairs.append((sim_ns, real_ns))
        while self._pairs[0][1] < real_ns - _KEPT_NS:
            self._pairs.popleft()

    @property
    def known(self) -> bool:
        """Whether anything was received."""
        return bool(self._pairs)

    def real_from_sim(self, sim_ns: int) -> int:
        """When this machine's clock showed what, at simulated time `sim_ns`; `known` must hold."""
        (sim0_ns, real0_ns), rate = self._line()
        return real0_ns + round((sim_ns - sim0_ns) / rate)

    def sim_from_real(self, real_ns: int) -> int:
        """Simulated time at `real_ns` of this machine's clock; `known` must hold."""
        (sim0_ns, real0_ns), rate = self._line()
        return sim0_ns + round((real_ns - real0_ns) * rate)

    def _line(self) -> tuple[tuple[int, int], float]:
        """A point of the line, and simulated seconds per real second."""
        sim0_ns, real0_ns = self._pairs[-1]
        if len(self._pairs) < 2:
            return (sim0_ns, real0_ns), 1.0
        sim, real = (np.array([pair[i] - self._pairs[-1][i] for pair in self._pairs], np.float64) for i in (0, 1))
        rate = float(((real - real.mean()) * (sim - sim.mean())).sum() / ((real - real.mean()) ** 2).sum())
        return (sim0_ns + round(sim.mean()), real0_ns + round(real.mean())), max(rate, 1e-6)


class ClockReader:
    """Keeps a `SimulatedClock` up to date with a node's `/clock`."""

    def __init__(self, node: Any) -> None:
        self.clock = SimulatedClock()
        self._intake: Intake[int] = Intake(CLOCK.type_name, lambda msg: ns_from_time(msg.clock), max_bytes=1024)
        # a simulator may send it 1000 times a second, which is no reason to wake up
        self._reader = node.reader(CLOCK, wakes=False)
        self._delays_ns: deque[int] = deque(maxlen=_KEPT)

    def update(self) -> None:
        """Take in what has come; never waits."""
        samples, now_ns = self._reader.take(), time.time_ns()
        for sample in samples:
            if (sim_ns := self._intake.take(sample.raw)) is None:
                continue
            # the sender's stamp is free of the delays of this process; the shortest of them puts it on this machine's clock
            self._delays_ns.append(now_ns - sample.sent_ns)
            self.clock.add(sim_ns, sample.sent_ns + min(self._delays_ns))

    def wait(self, timeout_s: float = _WITHIN_S) -> None:
        """Wait for the first time; raises SourceError when none comes."""
        end_s = time.monotonic() + timeout_s
        while not self.clock.known:
            if time.monotonic() > end_s:
                raise SourceError(f"simulated time is wanted, but nothing came on {CLOCK.name} within {timeout_s:g} s")
            time.sleep(_POLL_S)
            self.update()
