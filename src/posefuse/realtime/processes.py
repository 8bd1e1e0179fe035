"""Camera groups as processes: started, watched, restarted when they die, and always ended."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Self

from posefuse.core import Skeleton, SourceError
from posefuse.foundation.channel import Channel, ChannelClosed
from posefuse.foundation.platform import peak_memory_mb, processor_s
from posefuse.foundation.requests_to_end import children_ignore_requests
from posefuse.health.cameras import Verdict

from .clock import SessionClock
from .controls import KeepVideos, ShowImages
from .group import GroupPlan, run_group
from .messages import Centres, Expected, Go, GroupFailed, Ready, Status, Stop, VideoFailed
from .pace import ProcessedImages
from .video_keeping import FINISH_S

START_S = 120.0
# after the first time without a message something may be wrong; after the second a process that does nothing hangs
SILENT_S = 1.5
_HUNG_S = 5.0
# one that works is slow, however long it takes; only this much processor time without a message is a fault
_BUSY_S, _HUNG_BUSY_S = 0.02, 30.0
# a process that has worked for so long since its start is well, and the next fault is a new one
_WELL_S = 30.0
_FIRST_RETRY_S = 0.2
_LONGEST_RETRY_S = 10.0
_AT_ONCE = 32
_LEAVE_S = 0.8
_KILLED_S = 1.0
_LEAD_NS = 300_000_000


def spawned(target: Callable[..., None], *args: Any, name: str) -> Any:
    """A started process that Ctrl-C in the terminal, or closing it, does not reach; its parent ends it."""
    context = multiprocessing.get_context("spawn")
    process = context.Process(target=target, args=args, name=name, daemon=True)
    with children_ignore_requests():
        process.start()
    return process


def ended(process: Any, wait_s: float) -> None:
    """Wait for a process that was asked to stop; kill it when it does not."""
    process.join(wait_s)
    if process.is_alive():
        process.kill()
        process.join(_KILLED_S)
    # on a machine with no time to spare a killed process may be there a while
    if not process.is_alive():
        process.close()


@dataclass
class _Member:
    """One group's process, as its parent sees it."""

    plan: GroupPlan
    channel: Channel
    process: Any
    marks: Ready | None = None
    ready: bool = False
    received_s: float = field(default_factory=time.monotonic)
    began_s: float = field(default_factory=time.monotonic)
    used_s: float | None = None
    retry_s: float = _FIRST_RETRY_S
    again_at_s: float | None = None
    trouble: str = ""
    restarts: int = 0


class Groups:
    """The processes of all camera groups.

    Use as a context manager: leaving it ends them all. Implements `ViewSource`.
    """

    def __init__(self, plans: Sequence[GroupPlan]) -> None:
        self._go: Go | None = None
        self._first = 0
        # whether there may be any to finish at the end
        self._videos = any(plan.videos is not None for plan in plans)
        self._members = [_Member(plan, *self._start(plan)) for plan in plans]
        self._notices: list[str] = []
        self._processed = ProcessedImages()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *problem: object) -> None:
        self.stop()

    def whereabouts(self) -> list[str]:
        """Which cameras are in which process, in words."""
        return [f"cameras {_cameras(member.plan)} in process {member.process.pid}" for member in self._members]

    @property
    def restarts(self) -> int:
        """How often a process had to be started again."""
        return sum(member.restarts for member in self._members)

    def memory_mb(self) -> float:
        """Most memory this process and those of the groups have held, added up, see `peak_memory_mb`."""
        return peak_memory_mb([os.getpid(), *(member.process.pid for member in self._members)])

    def wait_ready(self, stopped: Sequence[str] = (), timeout_s: float = START_S) -> Skeleton:
        """Wait for every group's sources and network.

        Raises:
            SourceError: a group that cannot begin, in its own words, or one that takes longer.
            KeyboardInterrupt: `stopped` has an entry.
        """
        end_s = time.monotonic() + timeout_s
        for member in self._members:
            while member.marks is None:
                if stopped:
                    raise KeyboardInterrupt
                if time.monotonic() > end_s:
                    raise SourceError(f"cameras {_cameras(member.plan)}: not ready within {timeout_s:g} s")
                self._hear_ready(member)
        skeletons = {member.marks.skeleton for member in self._members if member.marks is not None}
        if len(skeletons) > 1:
            raise SourceError("camera groups: expected one skeleton from all detectors, got several")
        return skeletons.pop()

    def centres(self) -> list[Centres]:
        """Offsets of joint centres from the keypoints of each group's detector, when they are ready."""
        return [
            Centres(tuple(entry.camera for entry in member.plan.inputs), member.marks.joint_centres)
            for member in self._members
            if member.marks is not None
        ]

    def start(self, clock: SessionClock) -> int:
        """Recorded sources show their time 0 a moment from now, when all groups know it."""
        zero_ns = time.monotonic_ns() + _LEAD_NS
        self.begin(zero_ns)
        return zero_ns + clock.offset_ns

    def begin(self, zero_ns: int) -> None:
        """Let frames come; recorded sources show their time 0 at monotonic time `zero_ns`."""
        self._go = Go(zero_ns)
        for member in self._members:
            member.received_s = time.monotonic()
            self._send_go(member, self._go, 1.0)

    def channels(self) -> list[Channel]:
        """For `select`."""
        return [member.channel for member in self._members if member.again_at_s is None]

    def messages(self) -> Iterator[Any]:
        """What has come, a bounded number per group and call; notices and mends what has died.

        Each call begins with another group, as its caller may not take all.
        """
        self._first = (self._first + 1) % max(len(self._members), 1)
        for member in (*self._members[self._first :], *self._members[: self._first]):
            if member.again_at_s is not None:
                if time.monotonic() >= member.again_at_s:
                    self._restart(member)
                continue
            yield from self._from(member)

    def troubles(self) -> dict[str, Verdict]:
        """What is wrong with the process a camera belongs to, by camera: it is ``dead``, or too slow; only those with trouble."""
        found: dict[str, Verdict] = {}
        for member in self._members:
            trouble = Verdict("dead", member.trouble) if member.trouble else _silence(member)
            if trouble is not None:
                found.update(dict.fromkeys((entry.camera for entry in member.plan.inputs), trouble))
        return found

    def expect(self, expected: Expected) -> None:
        """Send all groups where people should be seen next; one that has no room gets the next prediction."""
        for member in self._members:
            with contextlib.suppress(ChannelClosed):
                if member.ready:
                    member.channel.send(expected)

    def control(self, request: ShowImages | KeepVideos) -> None:
        """Change what the groups give besides views; one that is started again knows it, but continues with no video."""
        for member in self._members:
            if isinstance(request, KeepVideos):
                self._videos = self._videos or request.folder is not None
            else:
                member.plan = replace(member.plan, preview_hz=request.rate_hz)
            with contextlib.suppress(ChannelClosed):
                member.channel.send(request, 0.1)

    def notices(self) -> list[str]:
        """Videos that ended early, and that this machine is too slow, each once."""
        new, self._notices = self._notices, []
        return new

    def stop(self) -> None:
        """End them all; safe to call twice."""
        for member in self._members:
            with contextlib.suppress(ChannelClosed):
                member.channel.send(Stop(), 0.1)
        for member in self._members:
            with contextlib.suppress(ChannelClosed):
                # it reports its status until its videos are finished
                while member.channel.wait(FINISH_S if self._videos else _LEAVE_S):
                    if isinstance(member.channel.receive(), Status):
                        member.channel.send(Stop())
            ended(member.process, _LEAVE_S)
            member.channel.close()
        self._members = []

    def _start(self, plan: GroupPlan) -> tuple[Channel, Any]:
        ours, theirs = Channel.pair()
        process = spawned(run_group, plan, theirs, name=f"posefuse cameras {_cameras(plan)}")
        theirs.close_own()
        return ours, process

    def _restart(self, member: _Member) -> None:
        if member.process.is_alive():
            # waiting here would stop the output tick
            member.process.kill()
            member.again_at_s = time.monotonic() + member.retry_s
            return
        member.channel.close()
        member.process.close()
        member.channel, member.process = self._start(member.plan)
        member.again_at_s, member.ready = None, False
        member.received_s = member.began_s = time.monotonic()
        member.used_s = None
        member.restarts += 1

    def _hear_ready(self, member: _Member) -> None:
        member.channel.wait(0.1)
        try:
            message = member.channel.receive()
        except ChannelClosed:
            raise SourceError(f"cameras {_cameras(member.plan)}: {death_of(member.process)} while starting") from None
        if isinstance(message, GroupFailed):
            raise SourceError(message.reason)
        if isinstance(message, Ready):
            member.marks, member.ready = message, True

    def _from(self, member: _Member) -> Iterator[Any]:
        for _ in range(_AT_ONCE):
            try:
                message = member.channel.receive()
            except ChannelClosed:
                self._died(member, death_of(member.process))
                return
            if message is None:
                break
            self._took(member, message)
            if isinstance(message, Ready) and self._go is not None:
                member.ready = True
                self._send_go(member, self._go, 0.1)
            elif isinstance(message, GroupFailed):
                self._died(member, message.reason)
                return
            elif isinstance(message, VideoFailed):
                self._notices.append(f"video {message.camera}: failed: {message.reason}")
            else:
                if isinstance(message, Status):
                    network = str(member.plan.detector.options.get("landmarks", ""))
                    self._notices += filter(None, [self._processed.news(message, member.received_s, network)])
                yield message
        # loading modules and networks takes a slow machine as long as it takes; ended for that, it would never begin
        if _hangs(member):
            member.process.kill()
            self._died(member, f"process {member.process.pid} hung and was ended")

    def _took(self, member: _Member, message: Any) -> None:
        """Note that a process is alive; one that has worked for a while has no trouble behind it."""
        member.received_s, member.used_s = time.monotonic(), None
        if isinstance(message, Status) and all(state.state != "opening" for state in message.cameras):
            member.trouble = ""
            if member.received_s - member.began_s > _WELL_S:
                member.retry_s = _FIRST_RETRY_S

    def _send_go(self, member: _Member, go: Go, wait_s: float) -> None:
        """Let the frames of one group come; a process that died since it was ready is started again."""
        try:
            member.channel.send(go, wait_s)
        except ChannelClosed:
            self._died(member, death_of(member.process))

    def _died(self, member: _Member, why: str) -> None:
        member.trouble = f"{why}; starting again"
        member.again_at_s = time.monotonic() + member.retry_s
        member.retry_s = min(2 * member.retry_s, _LONGEST_RETRY_S)


def _busy_s(member: _Member) -> float | None:
    """Processor time since it has been silent for a while; None where the system does not report it."""
    now_s = processor_s(member.process.pid)
    if now_s is None:
        return None
    member.used_s = now_s if member.used_s is None else member.used_s
    return now_s - member.used_s


def _silence(member: _Member) -> Verdict | None:
    silent_s = time.monotonic() - member.received_s
    if silent_s <= SILENT_S:
        return None
    busy_s = _busy_s(member)
    if busy_s is not None and (busy_s >= _BUSY_S or silent_s < 2 * SILENT_S):
        return Verdict("overload", f"process {member.process.pid} works, but has processed nothing for {silent_s:.1f} s")
    return Verdict("dead", f"process {member.process.pid} has been silent for {silent_s:.1f} s")


def _hangs(member: _Member) -> bool:
    silent_s = time.monotonic() - member.received_s
    if silent_s <= (_HUNG_S if member.ready else START_S):
        return False
    busy_s = _busy_s(member)
    return busy_s is None or busy_s < _BUSY_S or busy_s > _HUNG_BUSY_S


def _cameras(plan: GroupPlan) -> str:
    return " ".join(entry.camera for entry in plan.inputs)


def death_of(process: Any) -> str:
    """How a process ended, in words."""
    process.join(0.2)
    code = process.exitcode
    how = f"by signal {signal.Signals(-code).name}" if code is not None and code < 0 else f"with status {code}"
    return f"process {process.pid} ended {how}"
