"""The rig, watched while it is used: cameras that were moved, exchanged or run unsynchronised, and how far clocks are apart.

Both are asked of what the cameras see of one person. The work (`health.rig_monitor`, `clock_finding`) is done in a process of its
own, so that the output tick never waits for it.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from functools import cache

from posefuse.calibration.clocks.paths import APART_S
from posefuse.calibration.keypoints import MIN_SCORE, limb_keypoints
from posefuse.core import CameraHealth, Detections2D, Rig, Skeleton
from posefuse.core.arrays import Array
from posefuse.foundation.channel import Channel, ChannelClosed
from posefuse.foundation.platform import lower_priority
from posefuse.foundation.worker import Worker
from posefuse.health import rig_monitor as monitor
from posefuse.health.clock_finding import ClockFinder
from posefuse.health.misalignment import CommonTimeSteps

_S = 1e9
_NICENESS = 10
_WAIT_S = 0.2
# it computes in one thread: waiting for each other, several would only take from the cameras
_ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
# of a camera's views, those closer than this to the one before add no information
_APART_NS = round(APART_S * 1e9)
# poses are better without a camera that sees people farther off than this (`bench/rig_monitor.py`)
_MISCALIBRATED_M = 0.05


@dataclass(frozen=True)
class Watched:
    """What is known of the rig.

    Attributes:
        offset_s: how much later each camera's stamps are than the mean of all, by camera; only those that are known.
        faulty: what is wrong with cameras, by camera; only those with something.
        miscalibrated: those whose views are so far off the person that the others know better.
    """

    offset_s: Mapping[str, float] = field(default_factory=dict)
    faulty: Mapping[str, CameraHealth] = field(default_factory=dict)
    miscalibrated: frozenset[str] = frozenset()


def watching(rig: Rig, clocks: bool) -> AbstractContextManager[RigWatch | None]:
    """The rig watch, where there are enough cameras: with two cameras it is unknown which of them is wrong."""
    return RigWatch(rig, clocks) if clocks or len(rig) >= monitor.LEAST_CAMERAS else contextlib.nullcontext()


class RigWatch:
    """The session's side: hands views on and never waits. Use as a context manager: leaving it ends the process.

    Args:
        rig: its cameras. clocks: find how far their clocks are apart, too.

    Attributes:
        known: what was found so far.
    """

    def __init__(self, rig: Rig, clocks: bool) -> None:
        self.known = Watched()
        self._sent_ns = dict.fromkeys(rig.names, 0)
        self._plan = rig, clocks
        self._worker = Worker(run_watch, _ONE_THREAD)
        self._worker.start(*self._plan)

    def __enter__(self) -> RigWatch:
        return self

    def __exit__(self, *problem: object) -> None:
        # it has nothing to finish
        self._worker.end(0.0)

    def whereabouts(self) -> str:
        """In which process it is, in words."""
        return f"rig watched in process {self._worker.pid}"

    def timed(self, view: Detections2D, followed: int) -> Detections2D:
        """The view with what is known of its clock taken away.

        It goes into the next finding, unless several people are followed: cameras must not be asked about different ones.
        """
        if followed <= 1 and len(view) == 1 and not 0 <= view.t_ns - self._sent_ns[view.camera] < _APART_NS:
            self._pass_on(view)
        offset_s = self.known.offset_s.get(view.camera, 0.0)
        return replace(view, t_ns=view.t_ns - round(offset_s * _S)) if offset_s else view

    def receive(self) -> None:
        """Take in what was found since the last time."""
        while (found := self._worker.receive()) is not None:
            self.known = found
        if self._worker.due():
            # what the former process found of the cameras is not watched any more; their clocks stay as they were
            self.known = replace(self.known, faulty={}, miscalibrated=frozenset())
            self._worker.start(*self._plan)

    @property
    def trouble(self) -> str:
        """How its newest process to die ended; empty when none did."""
        return f"{self._worker.trouble}; started again" if self._worker.trouble else ""

    def _pass_on(self, view: Detections2D) -> None:
        self._sent_ns[view.camera] = view.t_ns
        points = _limb_keypoints(view.skeleton)
        self._worker.send((view.camera, view.t_ns, view.xy_img[0, points], view.score[0, points]))


@cache
def _limb_keypoints(skeleton: Skeleton) -> Array:
    return limb_keypoints(skeleton.keypoints)


def run_watch(channel: Channel, rig: Rig, clocks: bool) -> None:
    """Body of the process: collects views, reports what it finds."""
    lower_priority(_NICENESS)
    watcher, reported = RigWatcher(rig, clocks), Watched()
    with contextlib.suppress(ChannelClosed):
        while True:
            channel.wait(_WAIT_S)
            while (view := channel.receive()) is not None:
                watcher.add(*view)
            found = watcher.look()
            if found != reported and channel.send(found):
                reported = found


class RigWatcher:
    """Both duties over views as they come; no clock inside."""

    def __init__(self, rig: Rig, clocks: bool) -> None:
        self._rig = rig
        self._finder = ClockFinder(rig) if clocks else None
        self._time_steps = CommonTimeSteps(rig.names)
        self._state = monitor.new_monitor_state(rig)
        self._offset_s: Mapping[str, float] = {}

    def add(self, camera: str, t_ns: int, xy_img: Array, score: Array) -> None:
        """One person's points (P, 2) in a view with their scores (P,)."""
        if self._finder is not None:
            self._finder.add(camera, t_ns, xy_img, score)
        later_ns = round(self._offset_s.get(camera, 0.0) * _S)
        self._time_steps.add(camera, t_ns - later_ns, xy_img, score >= MIN_SCORE)

    def look(self) -> Watched:
        """What is known by now."""
        if self._finder is not None:
            found = self._finder.find()
            self._offset_s = self._offset_s if found is None else found
        if len(self._rig) >= monitor.LEAST_CAMERAS:
            for t_ns, xy_img in self._time_steps.ready():
                self._state, _ = monitor.observe(self._state, self._rig, t_ns, xy_img)
        findings = self._state.findings
        faulty = {name: CameraHealth(one.kind, one.detail) for one in findings for name in one.cameras}
        miscalibrated = frozenset(name for one in findings if one.displaced_m > _MISCALIBRATED_M for name in one.cameras)
        return Watched(self._offset_s, faulty, miscalibrated)
