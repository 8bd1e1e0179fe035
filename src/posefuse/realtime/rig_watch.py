"""The rig, watched while it is used: cameras that were moved, swapped or run unsynchronised, and how far clocks are apart.

All is asked of what the cameras see of one person; so is the scale of noise that was not fitted. The work (`health.rig_monitor`,
`clock_finding`, `misalignment`) is done in a process of its own, so that the output tick never waits for it.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np

from posefuse.calibration.clocks.paths import APART_S
from posefuse.calibration.clocks.person_tracks import MIN_SCORE, limb_keypoints
from posefuse.core import CameraHealth, Detections2D, Rig, Skeleton
from posefuse.core.arrays import Array
from posefuse.foundation.channel import Channel, ChannelClosed
from posefuse.foundation.platform import lower_priority
from posefuse.foundation.worker import Worker
from posefuse.fusion import FuseSettings
from posefuse.health import rig_monitor as monitor
from posefuse.health.clock_finding import ClockFinder
from posefuse.health.misalignment import CommonTimeSteps, disagreement, noise_scale
from posefuse.tracking.settings import LASTING_S, LASTING_SHARE

_S = 1e9
_NICENESS = 10
_WAIT_S = 0.2
# it computes in one thread: waiting for each other, several would only take from the cameras
_ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
# of a camera's views, those closer than this to the one before add no information
_APART_NS = round(APART_S * 1e9)
# poses are better without a camera that sees people farther off than this (`bench/rig_monitor.py`)
_MISCALIBRATED_M = 0.05
# the scale of noise is settled by so many joints at common time steps: ten seconds of a person in full view
_NOISE_POINTS = 1000
# a point between two views of a camera, evenly likely at any place between them: their errors are correlated as LASTING_SHARE and
# LASTING_S state at 1.5 times `_APART_NS`, every second frame of 30 frames/s
_EVENED = float(np.sqrt((2 + LASTING_SHARE * np.exp(-1.5 * APART_S / LASTING_S)) / 3))


@dataclass(frozen=True)
class Watched:
    """What is known of the rig.

    Attributes:
        offset_s: how much later each camera's stamps are than the mean of all, by camera; only those that are known.
        faulty: what is wrong with cameras, by camera; only those with something.
        miscalibrated: those whose views are so far off the person that the others know better.
        noise_scale: by what standard deviations that were not fitted are to be multiplied; None: not known, or not asked for.
    """

    offset_s: Mapping[str, float] = field(default_factory=dict)
    faulty: Mapping[str, CameraHealth] = field(default_factory=dict)
    miscalibrated: frozenset[str] = frozenset()
    noise_scale: float | None = None


def watching(rig: Rig, clocks: bool, noise: bool) -> AbstractContextManager[RigWatch | None]:
    """The rig watch, where there is work for it: with two cameras it is unknown which of them is wrong."""
    needed = clocks or noise or len(rig) >= monitor.LEAST_CAMERAS
    return RigWatch(rig, clocks, noise) if needed else contextlib.nullcontext()


class RigWatch:
    """The session's side: hands views on and never waits. Use as a context manager: leaving it ends the process.

    Args:
        rig: its cameras. clocks: find how far their clocks are apart, too. noise: find the scale of the views' noise, too.

    Attributes:
        known: what was found so far.
    """

    def __init__(self, rig: Rig, clocks: bool, noise: bool = False) -> None:
        self.known = Watched()
        self._sent_ns = dict.fromkeys(rig.names, 0)
        self._plan = rig, clocks, noise
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

    def corrected(self, view: Detections2D, followed: int) -> Detections2D:
        """The view with what is known of its clock taken away, and its noise scaled.

        It goes into the next finding, unless several people are followed: cameras must not be asked about different ones.
        """
        if followed <= 1 and len(view) == 1 and not 0 <= view.t_ns - self._sent_ns[view.camera] < _APART_NS:
            self._pass_on(view)
        offset_s, scale = self.known.offset_s.get(view.camera, 0.0), self.known.noise_scale
        view = view if scale is None else replace(view, sigma_px=scale * view.sigma_px)
        return replace(view, t_ns=view.t_ns - round(offset_s * _S)) if offset_s else view

    def receive(self) -> None:
        """Take in what was found since the last time."""
        while (found := self._worker.receive()) is not None:
            # poses of a session have one scale, also where a process that was started again finds another
            self.known = replace(found, noise_scale=self.known.noise_scale or found.noise_scale)
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
        seen = np.column_stack([view.xy_img[0, points], view.sigma_px[0, points]])
        self._worker.send((view.camera, view.t_ns, seen, view.score[0, points]))


@cache
def _limb_keypoints(skeleton: Skeleton) -> Array:
    return limb_keypoints(skeleton.keypoints)


def run_watch(channel: Channel, rig: Rig, clocks: bool, noise: bool) -> None:
    """Body of the process: collects views, reports what it finds."""
    lower_priority(_NICENESS)
    watcher, reported = RigWatcher(rig, clocks, noise), Watched()
    with contextlib.suppress(ChannelClosed):
        while True:
            channel.wait(_WAIT_S)
            while (view := channel.receive()) is not None:
                watcher.add(*view)
            found = watcher.look()
            if found != reported and channel.send(found):
                reported = found


class RigWatcher:
    """All duties over views as they come; no clock inside."""

    def __init__(self, rig: Rig, clocks: bool, noise: bool = False) -> None:
        self._rig = rig
        self._finder = ClockFinder(rig) if clocks else None
        self._time_steps = CommonTimeSteps(rig.names)
        self._state = monitor.new_monitor_state(rig)
        self._offset_s: Mapping[str, float] = {}
        self._noise, self._shares = noise, np.zeros(0)

    def add(self, camera: str, t_ns: int, seen: Array, score: Array) -> None:
        """One person's points in a view (P, 3), px and their standard deviation, with their scores (P,); (P, 2) without noise."""
        if self._finder is not None:
            self._finder.add(camera, t_ns, seen[:, :2], score)
        later_ns = round(self._offset_s.get(camera, 0.0) * _S)
        self._time_steps.add(camera, t_ns - later_ns, seen, score >= MIN_SCORE)

    def look(self) -> Watched:
        """What is known by now."""
        if self._finder is not None:
            found = self._finder.find()
            self._offset_s = self._offset_s if found is None else found
        for t_ns, seen in self._time_steps.ready():
            if len(self._rig) >= monitor.LEAST_CAMERAS:
                self._state, _ = monitor.observe(self._state, self._rig, t_ns, seen[..., :2])
            if self._noise and len(self._shares) < _NOISE_POINTS:
                xy, sigma_px = seen[..., :2], seen[..., 2] * _EVENED
                known = np.isfinite(sigma_px).astype(np.float64)
                self._shares = np.append(self._shares, disagreement(self._rig, xy, known, sigma_px, FuseSettings()))
        findings = self._state.findings
        faulty = {name: CameraHealth(one.kind, one.detail) for one in findings for name in one.cameras}
        miscalibrated = frozenset(name for one in findings if one.displaced_m > _MISCALIBRATED_M for name in one.cameras)
        settled = len(self._shares) >= _NOISE_POINTS
        return Watched(self._offset_s, faulty, miscalibrated, noise_scale(self._shares) if settled else None)
