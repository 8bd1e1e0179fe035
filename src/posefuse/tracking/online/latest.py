"""The paper's live tracker: the newest view of each camera, fused as if all were of one moment."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from posefuse.core import Detections2D, Kind, Pose3D, Rig, Skeleton
from posefuse.core.arrays import Array

from .admission import Admission
from .contract import CameraStatistics, Solve
from .evidence import Evidence
from .settings import LiveSettings


class LatestTracker:
    """Views of different age are mixed, so the error grows with speed; views older than the lag buffer do not count."""

    def __init__(self, rig: Rig, skeleton: Skeleton, settings: LiveSettings, solve: Solve) -> None:
        self._names, self._skeleton, self._settings, self._solve = rig.names, skeleton, settings, solve
        self._admission = Admission(rig, skeleton, settings)
        self._newest: dict[str, Detections2D] = {}
        self._used = dict.fromkeys(rig.names, 0)
        self._pose: Pose3D | None = None
        self._found_ns = 0
        self._stale = False
        self._restarts = 0

    def add(self, detections: Detections2D) -> Array:
        """See `Tracker.add`; association comes later, with the views of all cameras."""
        if self._admission.admits(detections):
            self._keep(detections)
        return np.full(len(detections), -1)

    def _keep(self, detections: Detections2D) -> None:
        if self._admission.restarts != self._restarts:
            self._restarts, self._pose = self._admission.restarts, None
            self._newest.clear()
        self._used[detections.camera] += len(detections) > 0
        before = self._newest.get(detections.camera)
        if before is None or before.t_ns < detections.t_ns:
            self._newest[detections.camera] = detections
            self._stale = True

    def at(self, t_ns: int) -> Pose3D:
        """The newest views fused, whatever their age; kind PREDICTED while no view is new enough to count as measured."""
        self._admission.asked(t_ns)
        if self._stale:
            self._fuse()
        lost = self._pose is None or t_ns - self._found_ns > round(self._settings.lost_after_s * 1e9)
        if lost or self._pose is None:
            return Pose3D.empty(t_ns, self._skeleton)
        pose = replace(self._pose, t_ns=t_ns)
        if t_ns - self._found_ns > round(self._settings.measured_s * 1e9):
            pose = replace(pose, kind=np.where(pose.kind == Kind.MISSING, Kind.MISSING, Kind.PREDICTED))
        return pose

    def looked_for(self, t_ns: int) -> Pose3D:
        """See `Tracker.looked_for`."""
        return self.at(t_ns)

    def check(self) -> None:
        """Nothing: fusion has to be done when its pose is wanted."""

    def evidence(self, t_ns: int) -> Mapping[int, Evidence]:
        """None: views of different times are taken for one."""
        return {}

    @property
    def health(self) -> Mapping[str, CameraStatistics]:
        """Ages and refusals; this tracker predicts nothing, so it cannot judge a view."""
        newest_ns = self._admission.newest_ns
        return {
            name: CameraStatistics(
                used=self._used[name],
                age_s=(newest_ns - self._newest[name].t_ns) * 1e-9
                if newest_ns is not None and name in self._newest
                else float("nan"),
                late=times.late,
                ahead=times.ahead,
                repeated=times.repeated,
                crowded=times.crowded,
            )
            for name, times in self._admission.times.items()
        }

    def _fuse(self) -> None:
        self._stale = False
        newest_ns = self._admission.newest_ns or 0
        oldest_ns = newest_ns - round(self._settings.lag_s * 1e9)
        nothing = Detections2D.empty("", newest_ns, self._skeleton)
        views = [self._newest.get(name, nothing) for name in self._names]
        together = [
            replace(view, t_ns=newest_ns) if view.t_ns >= oldest_ns and len(view) else replace(nothing, camera=name)
            for name, view in zip(self._names, views, strict=True)
        ]
        pose = self._solve(together, self._pose)
        if np.isfinite(pose.xyz_world).any():
            self._pose, self._found_ns = pose, newest_ns
