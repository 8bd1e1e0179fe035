"""The steady loop: views in as they come, a pose out at every output tick of the session clock, predicted to that output tick."""

from __future__ import annotations

import gc
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from posefuse.core import (
    CameraHealth,
    LiveDetections,
    LiveExpected,
    LiveHealth,
    LiveJointCentres,
    LivePose,
    LivePreview,
    Pose3D,
    Rig,
)
from posefuse.core.arrays import Array
from posefuse.foundation.channel import wait_any
from posefuse.health.camera_monitor import Monitor
from posefuse.kinematics import JointTracker

from .estimator import Estimator
from .latency import Latencies, ViewTimes
from .messages import Expected, SeenView, SessionClock, Status, ViewSource
from .outputs import OutputProcess
from .rig_watch import RigWatch

_S = 1_000_000_000
# the expected pose is published, and cameras are judged, this often
_BOARD_NS = _S // 40
_JUDGE_NS = _S // 4


class Fusion:
    """Tracker, monitor and stop watches of one session; everything in one thread.

    `expect` is given the predictions of the estimator, which select image regions.
    """

    def __init__(
        self,
        rig: Rig,
        estimator: Estimator,
        expect: Callable[[Expected], object],
        clock: SessionClock,
        outlets: OutputProcess,
        watch: RigWatch | None = None,
        joints: JointTracker | None = None,
    ) -> None:
        self.rig, self.estimator, self._expect, self.clock, self.outlets = rig, estimator, expect, clock, outlets
        self.monitor = Monitor(rig.names)
        self.latencies = Latencies(rig.names)
        self.watch, self._joints = watch, joints
        self.verdicts: Mapping[str, CameraHealth] = {}
        self.used = dict.fromkeys(rig.names, 0)
        self.seen = dict.fromkeys(rig.names, 0)
        self.poses = self.poses_with_people = 0
        self._waiting: list[ViewTimes] = []
        self._last_published: Pose3D | None = None
        self._followed = 0
        self._judged_ns = 0

    def run(self, views: ViewSource, rate_hz: float, until: Callable[[int], bool]) -> None:
        """Run until `until(now)` is true."""
        # objects that exist by now are permanent; a garbage collection would delay the output tick by milliseconds
        gc.collect()
        gc.freeze()
        period_ns = round(_S / rate_hz)
        due_ns = self.clock.now_ns() + period_ns
        try:
            while not until(now_ns := self.clock.now_ns()):
                if now_ns < due_ns:
                    self._listen(views, due_ns)
                    continue
                self.tick(due_ns, period_ns)
                # takes up to most of a period: only now can the next output be sure not to wait for it
                self.estimator.check()
                self._judge(views, due_ns, due_ns + period_ns)
                behind = (self.clock.now_ns() - due_ns) // period_ns
                if behind > 1:
                    self.latencies.late_ticks += int(behind) - 1
                    due_ns += (int(behind) - 1) * period_ns
                due_ns += period_ns
        finally:
            gc.unfreeze()

    def take(self, message: Any) -> None:
        """One message of a camera group, or of another machine."""
        if isinstance(message, SeenView):
            self._see(message)
        elif isinstance(message, LiveJointCentres):
            self.estimator.centring.learn(message)
            self.outlets.offer(message)
        elif isinstance(message, Status):
            for state in message.cameras:
                self.monitor.take_state(state, message.t_ns, regular=True)
        elif isinstance(message, LivePreview):
            self.outlets.offer(message)

    def tick(self, due_ns: int, period_ns: int) -> None:
        """One pose, for the time it is due."""
        landmarks = self.estimator.tracker.at(due_ns)
        output_ns = self.clock.now_ns()
        newest = max((way.exposed_ns for way in self._waiting), default=0)
        stages = {"exposed": newest, "output": output_ns} if newest else {"output": output_ns}
        shown = self.estimator.shown(landmarks)
        joints = self._joints.step(shown) if self._joints is not None else None
        self.outlets.offer(LivePose(pose=shown, joints=joints, stages_ns=stages))
        self.latencies.tick_out(due_ns, output_ns, period_ns)
        for way in self._waiting:
            self.latencies.view_out(way, output_ns)
        self._waiting.clear()
        self.poses += 1
        self._followed = len(landmarks.person_id)
        self.poses_with_people += self._followed > 0
        self._publish_prediction(due_ns)

    @property
    def noise_scale(self) -> float | None:
        """By what standard deviations of the views, which were not fitted, are multiplied; None: not, or not yet."""
        return None if self.watch is None else self.watch.known.noise_scale

    def _see(self, seen: SeenView) -> None:
        now_ns = self.clock.now_ns()
        if seen.state is not None:
            self.monitor.take_state(seen.state, now_ns)
        view = self.monitor.admit(seen.detections, now_ns, received_ns=seen.received_ns, still=seen.still)
        if view is None:
            return
        if self.watch is not None:
            view = self.watch.corrected(view, self._followed)
            miscalibrated = view.camera in self.watch.known.miscalibrated and not self.monitor.overloaded(view.camera)
            if miscalibrated and self.monitor.does_without(view.camera):
                return
        self.estimator.add(view)
        fused_ns = self.clock.now_ns()
        self.used[view.camera] += 1 + seen.skipped
        self.seen[view.camera] += len(view) > 0
        way = ViewTimes(view.camera, view.t_ns, seen.received_ns, seen.started_ns, seen.detected_ns, fused_ns)
        self._waiting.append(way)
        stages = {
            "received": way.received_ns, "started": way.started_ns, "detected": way.detected_ns, "fused": fused_ns
        }  # fmt: skip
        self.outlets.offer(LiveDetections(detections=view, stages_ns=stages))

    def _listen(self, views: ViewSource, due_ns: int) -> None:
        channels = views.channels()
        wait_s = max(0, due_ns - self.clock.now_ns()) / _S
        if not wait_any(channels, wait_s) and channels:
            return
        self._take_until(views, due_ns)

    def _take_until(self, views: ViewSource, due_ns: int) -> None:
        for message in views.messages():
            self.take(message)
            # what is left waits in its channel: several views would make the output late
            if self.clock.now_ns() >= due_ns:
                return

    def _publish_prediction(self, t_ns: int) -> None:
        """Hand the prediction to those who look at images."""
        before = self._last_published
        if before is not None and 0 <= t_ns - before.t_ns < _BOARD_NS:
            return
        pose = self.estimator.looked_for(t_ns)
        known: Array = np.asarray(np.isfinite(pose.xyz_world).any(axis=(1, 2)))
        shown = pose if known.all() else pose.people(known)
        self._expect(Expected(shown.t_ns, shown.xyz_world, velocity_between(before, shown)))
        self._last_published = shown
        self.outlets.offer(LiveExpected(pose=shown))

    def _judge(self, views: ViewSource, now_ns: int, until_ns: int) -> None:
        if now_ns - self._judged_ns < _JUDGE_NS:
            return
        self._judged_ns = now_ns
        # processes that died while nothing came are noticed here
        self._take_until(views, until_ns)
        if self.watch is not None:
            self.watch.receive()
        self.verdicts = self.monitor.judge(now_ns, views.troubles(), self.watch.known.faulty if self.watch is not None else {})
        self.outlets.poll()
        rates = self._rates()
        cameras = {name: replace(verdict, figures=rates[name]) for name, verdict in self.verdicts.items()}
        self.outlets.offer(LiveHealth(t_ns=now_ns, cameras=cameras, outputs=self.outlets.health))

    def _rates(self) -> dict[str, dict[str, float]]:
        health = self.estimator.tracker.health
        found = {}
        for name in self.rig.names:
            source = self.monitor.source(name)
            total = self.latencies.stages[name]["total"]
            found[name] = {
                "captured": source.captured,
                "used": self.used[name],
                "replaced": source.replaced,
                "latency_p95_ms": total.quantile_ms(0.95),
                "innovation_sigmas": health[name].innovation_sigmas,
                "age_ms": health[name].age_s * 1000,
                "noise_scale": self.noise_scale or 1.0,
            }
        return found


def velocity_between(before: Pose3D | None, now: Pose3D) -> Array:
    """(N, K, 3) from the prediction published before; 0 for people or keypoints it did not have."""
    if before is None or not len(now.person_id) or now.t_ns <= before.t_ns or not np.array_equal(before.person_id, now.person_id):
        return np.zeros(now.xyz_world.shape)
    return np.nan_to_num((now.xyz_world - before.xyz_world) * (_S / (now.t_ns - before.t_ns)))
