"""Camera groups as processes: started, watched, restarted when they die, and always ended."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Self

from posefuse.core import CameraHealth, LiveJointCentres, Skeleton, SourceError
from posefuse.foundation.channel import Channel
from posefuse.foundation.platform import processor_s
from posefuse.foundation.worker import Worker

from .group import GroupPlan, run_group
from .messages import CannotStart, Expected, Go, KeepVideos, Ready, SessionClock, ShowImages, Status, Stop
from .video_keeping import FINISH_S

START_S = 120.0
# after the first time without a message something may be wrong; after the second a process that does nothing hangs
SILENT_S = 1.5
_HUNG_S = 5.0
# one that works is slow, however long it takes; only this much processor time without a message is a fault
_BUSY_S, _HUNG_BUSY_S = 0.02, 30.0
_AT_ONCE = 32
_LEAVE_S = 0.8
_LEAD_NS = 300_000_000


@dataclass
class _Member:
    """One group's process, as its parent sees it.

    Attributes:
        ready: whether it waits for `Go`, or works. used_s: its processor time when it had been silent for a while.
        video_faults: of its newest status.
    """

    plan: GroupPlan
    worker: Worker
    marks: Ready | None = None
    ready: bool = False
    used_s: float | None = None
    video_faults: Mapping[str, str] = field(default_factory=dict)

    @property
    def cameras(self) -> list[str]:
        """Their names."""
        return [entry.camera for entry in self.plan.inputs]

    @property
    def words(self) -> str:
        """For messages."""
        return f"cameras {' '.join(self.cameras)}"


class Groups:
    """The processes of all camera groups.

    Use as a context manager: leaving it ends them all. Implements `ViewSource`.
    """

    def __init__(self, plans: Sequence[GroupPlan]) -> None:
        self._go: Go | None = None
        self._first = 0
        # whether there may be any to finish at the end
        self._videos = any(plan.videos is not None for plan in plans)
        self._members = [_Member(plan, Worker(run_group)) for plan in plans]
        for member in self._members:
            member.worker.start(member.plan)
        self._notices: list[str] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *problem: object) -> None:
        self.stop()

    def whereabouts(self) -> list[str]:
        """Which cameras are in which process, in words."""
        return [f"{member.words} in process {member.worker.pid}" for member in self._members]

    @property
    def restarts(self) -> int:
        """How often a process had to be started again."""
        return sum(member.worker.starts - 1 for member in self._members)

    @property
    def pids(self) -> list[int]:
        """Of the newest process of each group."""
        return [member.worker.pid for member in self._members]

    def wait_ready(self, stopped: Sequence[str] = ()) -> Skeleton:
        """Wait for every group's sources and network.

        Raises:
            SourceError: a group that cannot begin, in its own words, or one that takes longer.
            KeyboardInterrupt: `stopped` has an entry.
        """
        end_s = time.monotonic() + START_S
        for member in self._members:
            while member.marks is None:
                if stopped:
                    raise KeyboardInterrupt
                if time.monotonic() > end_s:
                    raise SourceError(f"{member.words}: not ready within {START_S:g} s")
                self._hear_ready(member)
        skeletons = {member.marks.skeleton for member in self._members if member.marks is not None}
        if len(skeletons) > 1:
            raise SourceError("camera groups: expected one skeleton from all detectors, got several")
        return skeletons.pop()

    def centres(self) -> list[LiveJointCentres]:
        """Offsets of joint centres from the keypoints of the detector, when all groups are ready.

        One message for all cameras, whose groups have one detector: on a network only the last one reaches those who come later.
        """
        cameras = tuple(camera for member in self._members for camera in member.cameras)
        first = self._members[0]
        table = first.marks.joint_centres if first.marks is not None else None
        return [LiveJointCentres(t_ns=first.plan.clock.now_ns(), cameras=cameras, table=table)]

    @property
    def noise_fitted(self) -> bool:
        """False where the standard deviations of the detector, which all groups have, are a rule of thumb."""
        return all(member.marks.noise_fitted for member in self._members if member.marks is not None)

    def start(self, clock: SessionClock) -> int:
        """Recorded sources show their time 0 a moment from now, when all groups know it."""
        zero_ns = time.monotonic_ns() + _LEAD_NS
        self.begin(zero_ns)
        return zero_ns + clock.offset_ns

    def begin(self, zero_ns: int) -> None:
        """Let frames come; recorded sources show their time 0 at monotonic time `zero_ns`."""
        self._go = Go(zero_ns)
        for member in self._members:
            member.worker.send(self._go, 1.0)

    def channels(self) -> list[Channel]:
        """For `select`."""
        return [member.worker.channel for member in self._members if member.worker.running]

    def messages(self) -> Iterator[Any]:
        """What has come, a bounded number per group and call; notices and mends what has died.

        Each call begins with another group, as its caller may not take all.
        """
        self._first = (self._first + 1) % max(len(self._members), 1)
        for member in (*self._members[self._first :], *self._members[: self._first]):
            if member.worker.running:
                yield from self._from(member)
            elif member.worker.due():
                member.ready, member.used_s = False, None
                member.worker.start(member.plan)

    def troubles(self) -> dict[str, CameraHealth]:
        """What is wrong with the process a camera belongs to, by camera: it is ``dead``, or too slow; only those with trouble."""
        found: dict[str, CameraHealth] = {}
        for member in self._members:
            why = member.worker.trouble
            trouble = CameraHealth("dead", f"{why}; starting again") if why else _silence(member)
            if trouble is not None:
                found.update(dict.fromkeys(member.cameras, trouble))
        return found

    def expect(self, expected: Expected) -> None:
        """Send all groups where people should be seen next; one that has no room gets the next prediction."""
        for member in self._members:
            if member.ready:
                member.worker.send(expected)

    def control(self, request: ShowImages | KeepVideos) -> None:
        """Change what the groups give besides views; one that is started again knows it, but continues with no video."""
        for member in self._members:
            if isinstance(request, KeepVideos):
                self._videos = self._videos or request.folder is not None
            else:
                member.plan = replace(member.plan, preview_hz=request.rate_hz)
            member.worker.send(request, 0.1)

    def notices(self) -> list[str]:
        """Videos that ended early, each once."""
        new, self._notices = self._notices, []
        return new

    def stop(self) -> None:
        """End them all; safe to call twice."""
        for member in self._members:
            member.worker.send(Stop(), 0.1)
        for member in self._members:
            # it reports its status until its videos are finished
            while member.worker.wait(FINISH_S if self._videos else _LEAVE_S):
                if isinstance(member.worker.receive(), Status):
                    member.worker.send(Stop())
            member.worker.end(_LEAVE_S)
        self._members = []

    def _hear_ready(self, member: _Member) -> None:
        member.worker.wait(0.1)
        message = member.worker.receive()
        if not member.worker.running:
            raise SourceError(f"{member.words}: {member.worker.trouble} while starting")
        if isinstance(message, CannotStart):
            raise SourceError(message.reason)
        if isinstance(message, Ready):
            member.marks, member.ready = message, True

    def _from(self, member: _Member) -> Iterator[Any]:
        worker = member.worker
        for _ in range(_AT_ONCE):
            message = worker.receive()
            if message is None:
                break
            self._took(member, message)
            if isinstance(message, Ready) and self._go is not None:
                member.ready = True
                worker.send(self._go, 0.1)
            elif isinstance(message, CannotStart):
                worker.fail(message.reason)
            else:
                if isinstance(message, Status):
                    new = message.video_faults.items() - member.video_faults.items()
                    self._notices += [f"video {camera}: failed: {fault}" for camera, fault in sorted(new)]
                    member.video_faults = message.video_faults
                yield message
        # loading modules and networks takes a slow machine as long as it takes; ended for that, it would never begin
        if worker.running and _hangs(member):
            worker.fail(f"process {worker.pid} hung and was ended")

    def _took(self, member: _Member, message: Any) -> None:
        """Note that a process is alive; one whose cameras are open has no trouble behind it."""
        member.used_s = None
        if isinstance(message, Status) and all(state.state != "opening" for state in message.cameras):
            member.worker.trouble = ""


def _busy_s(member: _Member) -> float | None:
    """Processor time since it has been silent for a while; None where the system does not report it."""
    now_s = processor_s(member.worker.pid)
    if now_s is None:
        return None
    member.used_s = now_s if member.used_s is None else member.used_s
    return now_s - member.used_s


def _silence(member: _Member) -> CameraHealth | None:
    silent_s = member.worker.silent_s()
    if silent_s <= SILENT_S:
        return None
    busy_s = _busy_s(member)
    if busy_s is not None and (busy_s >= _BUSY_S or silent_s < 2 * SILENT_S):
        return CameraHealth("overload", f"process {member.worker.pid} works, but has processed nothing for {silent_s:.1f} s")
    return CameraHealth("dead", f"process {member.worker.pid} has been silent for {silent_s:.1f} s")


def _hangs(member: _Member) -> bool:
    silent_s = member.worker.silent_s()
    if silent_s <= (_HUNG_S if member.ready else START_S):
        return False
    busy_s = _busy_s(member)
    return busy_s is None or busy_s < _BUSY_S or busy_s > _HUNG_BUSY_S
