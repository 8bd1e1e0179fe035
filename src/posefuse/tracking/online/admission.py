"""Which views can be used at all: their time must be believable, new, and not one of a flood.

Whether a ray is an outlier is judged by its residual, in `tracking.online.kernels.updates`.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

from posefuse.core import Detections2D, Rig, ShapeError, Skeleton
from posefuse.core.errors import choices

# a view with a time stamp further in the future than this has a wrong clock
_AHEAD_NS = 500_000_000
# of views of one camera that are closer in time, only the first is used: no camera has more than 250 frames/s
_APART_NS = 4_000_000


@dataclass
class _CameraTimes:
    """One camera's times: the newest received, those used within the lag buffer, and how many were refused, by reason."""

    stated_ns: int | None = None
    used_ns: list[int] = field(default_factory=list)
    refused: Counter[str] = field(default_factory=Counter)


class Admission:
    """Judges the time of every view by the newest used, the newest time asked for, and the other cameras.

    A single clock that jumps is refused; when at least half of the cameras agree (two, where there are two), time really
    continued, and where no one has asked for a time yet they may also set it back: `restarts` counts how often.
    """

    def __init__(self, rig: Rig, skeleton: Skeleton, lag_s: float) -> None:
        self._skeleton, self._lag_ns = skeleton, round(lag_s * 1e9)
        self.times = {name: _CameraTimes() for name in rig.names}
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
        times = self.times.get(detections.camera)
        if times is None:
            raise ShapeError(f"tracker: no camera {detections.camera!r} in the rig; there are: {choices(self.times)}")
        if detections.skeleton != self._skeleton:
            raise ShapeError(
                f"tracker: camera {detections.camera}: expected skeleton {self._skeleton.name}, got {detections.skeleton.name}"
            )
        t_ns = detections.t_ns
        times.stated_ns = t_ns
        if not self._believable(t_ns, times):
            return False
        if t_ns in times.used_ns:
            times.refused["repeated"] += 1
            return False
        if any(abs(t_ns - used) < _APART_NS for used in times.used_ns):
            times.refused["crowded"] += 1
            return False
        self.newest_ns = t_ns if self.newest_ns is None else max(t_ns, self.newest_ns)
        times.used_ns = [used for used in times.used_ns if used >= self.newest_ns - self._lag_ns] + [t_ns]
        return True

    def _believable(self, t_ns: int, times: _CameraTimes) -> bool:
        if self.newest_ns is None:
            return True
        if t_ns < self.newest_ns - self._lag_ns:
            if self._asked_ns is None and t_ns < self.newest_ns - self._lag_ns - _AHEAD_NS and self._agreed(t_ns):
                self.newest_ns = t_ns
                self.restarts += 1
                for other in self.times.values():
                    other.used_ns.clear()
                return True
            times.refused["late"] += 1
            return False
        known_ns = self.newest_ns if self._asked_ns is None else max(self.newest_ns, self._asked_ns)
        if t_ns > known_ns + _AHEAD_NS and not self._agreed(t_ns):
            times.refused["ahead"] += 1
            return False
        return True

    def _agreed(self, t_ns: int) -> bool:
        stated = [times.stated_ns for times in self.times.values() if times.stated_ns is not None]
        near = sum(abs(t_ns - other) <= _AHEAD_NS for other in stated)
        return 2 * near >= len(stated) and near >= min(2, len(stated))
