"""What is known of each camera, and which of its views can be used at all: times must be believable, new, and not of a flood.

Whether a ray is an outlier is judged by its residual, in `tracking.online.kernels.updates`.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from posefuse.core import Detections2D, Rig, ShapeError, Skeleton
from posefuse.core.errors import choices

from .kernels.step import ViewFigures

# a view with a time stamp further in the future than this has a wrong clock
_AHEAD_NS = 500_000_000
# of views of one camera that are closer in time, only the first is used: no camera has more than 250 frames/s
_APART_NS = 4_000_000


# the figures of a camera are means over about its last 1 / 0.01 = 100 views, 3 s at 30 frames/s
_HEALTH_MEMORY = 0.01


@dataclass(frozen=True, kw_only=True)
class CameraStatistics:
    """Statistics of one camera's views. Shares and rms run over about the last hundred views.

    Attributes:
        age_s: from its newest view to the newest time the tracker knows; NaN before the first.
        innovation_sigmas: rms of its keypoints' normalised innovations (1 for a healthy camera); NaN before the first.
        gated_share: share of its keypoints that were too far off to be used.
        late: views refused as older than the buffer.
    """

    age_s: float = float("nan")
    innovation_sigmas: float = float("nan")
    gated_share: float = 0.0
    late: int = 0


@dataclass
class CameraRecord:
    """One camera: the newest time received, those used within the lag buffer, how many came later, and figures."""

    stated_ns: int | None = None
    used_ns: list[int] = field(default_factory=list)
    late: int = 0
    used: int = 0
    square: float = float("nan")
    gated: float = 0.0

    def count(self, figures: ViewFigures) -> None:
        """Apply what was found in a view of this camera."""
        self.used += 1
        if figures.measured == 0:
            return
        memory = max(_HEALTH_MEMORY, 1 / self.used)
        square = figures.square / (2 * figures.measured)
        self.square = square if np.isnan(self.square) else self.square + memory * (square - self.square)
        self.gated += memory * (figures.gated / figures.measured - self.gated)

    def statistics(self, now_ns: int | None) -> CameraStatistics:
        """At the newest time of all cameras; None: no view was used so far."""
        return CameraStatistics(
            age_s=float("nan") if now_ns is None or not self.used_ns else (now_ns - max(self.used_ns)) * 1e-9,
            innovation_sigmas=float(np.sqrt(self.square)),
            gated_share=self.gated,
            late=self.late,
        )


class Admission:
    """Judges the time of every view by the newest used, the newest time asked for, and the other cameras.

    A single clock that jumps is refused; when at least half of the cameras agree (two, where there are two), time really
    continued, and where no one has asked for a time yet they may also set it back: `restarts` counts how often.
    """

    def __init__(self, rig: Rig, skeleton: Skeleton, lag_s: float) -> None:
        self._skeleton, self._lag_ns = skeleton, round(lag_s * 1e9)
        self.cameras = {name: CameraRecord() for name in rig.names}
        self.newest_ns: int | None = None
        self.restarts = 0
        self._asked_ns: int | None = None

    def asked(self, t_ns: int) -> None:
        """A pose is wanted at this time: views may be about as new."""
        self._asked_ns = t_ns

    def admits(self, detections: Detections2D) -> bool:
        """Whether to use a view; it then counts as used.

        Raises:
            ShapeError: a camera that is not the rig's, or another skeleton.
        """
        camera = self.cameras.get(detections.camera)
        if camera is None:
            raise ShapeError(f"tracker: no camera {detections.camera!r} in the rig; there are: {choices(self.cameras)}")
        if detections.skeleton != self._skeleton:
            raise ShapeError(
                f"tracker: camera {detections.camera}: expected skeleton {self._skeleton.name}, got {detections.skeleton.name}"
            )
        t_ns = detections.t_ns
        camera.stated_ns = t_ns
        if not self._believable(t_ns, camera):
            return False
        if any(abs(t_ns - used) < _APART_NS for used in camera.used_ns):
            return False
        self.newest_ns = t_ns if self.newest_ns is None else max(t_ns, self.newest_ns)
        camera.used_ns = [used for used in camera.used_ns if used >= self.newest_ns - self._lag_ns] + [t_ns]
        return True

    def _believable(self, t_ns: int, camera: CameraRecord) -> bool:
        if self.newest_ns is None:
            return True
        if t_ns < self.newest_ns - self._lag_ns:
            if self._asked_ns is None and t_ns < self.newest_ns - self._lag_ns - _AHEAD_NS and self._agreed(t_ns):
                self.newest_ns = t_ns
                self.restarts += 1
                for other in self.cameras.values():
                    other.used_ns.clear()
                return True
            camera.late += 1
            return False
        known_ns = self.newest_ns if self._asked_ns is None else max(self.newest_ns, self._asked_ns)
        return t_ns <= known_ns + _AHEAD_NS or self._agreed(t_ns)

    def _agreed(self, t_ns: int) -> bool:
        stated = [one.stated_ns for one in self.cameras.values() if one.stated_ns is not None]
        near = sum(abs(t_ns - other) <= _AHEAD_NS for other in stated)
        return 2 * near >= len(stated) and near >= min(2, len(stated))
