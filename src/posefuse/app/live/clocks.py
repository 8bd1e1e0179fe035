"""What is left of the difference between camera clocks, found from the moving person.

A camera whose stamps are late by d shows people where they were d before: its keypoints lie behind the prediction along
their own motion in the picture. Over many keypoints, d = -sum(v . r) / sum(v . v) with r the residual in px and v the
velocity in px/s. The prediction rests on all cameras, so what one camera is found to be off is taken away from its stamps and
the rest found again, until nothing is left; only differences can be seen, so the mean over the cameras is kept at 0.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from posefuse.core import Camera, Detections2D, Pose3D
from posefuse.core.arrays import Array

_S = 1e9
# slower keypoints say nothing about time, nor do those that jumped
_LEAST_PX_S, _MOST_PX = 20.0, 60.0
_STEP_S = 1e-3
_FORGET = 0.01
_GAIN = 0.02
_ENOUGH = 40.0
# a single view counts no more than a usual one: one keypoint in a hundred wild pixels must not set a clock
_MOST_SHIFT_S = 0.15


class ClockOffsets:
    """Offsets of all cameras' stamps, learnt view by view. No clock inside."""

    def __init__(self, cameras: Sequence[str]) -> None:
        self._names = tuple(cameras)
        self._offset_s = np.zeros(len(self._names))
        self._along, self._speed, self._views = (np.zeros(len(self._names)) for _ in range(3))

    @property
    def offset_s(self) -> Mapping[str, float]:
        """How much later each camera's stamps are than the mean of all; NaN until enough has moved in its picture."""
        known = self._views >= _ENOUGH
        return {
            name: float(offset) if ok else float("nan")
            for name, offset, ok in zip(self._names, self._offset_s, known, strict=True)
        }

    def corrected_ns(self, camera: str, t_ns: int) -> int:
        """The stamp with what was found taken away."""
        return t_ns - round(self._offset_s[self._names.index(camera)] * _S)

    def learn(self, camera: Camera, view: Detections2D, pose: Pose3D, velocity_world: Array) -> None:
        """Hold a view, its stamp corrected, against a pose near it in time and how fast everybody moves (N, K, 3)."""
        late_s = (view.t_ns - pose.t_ns) / _S
        best: tuple[int, float, float] = (0, 0.0, 0.0)
        for xyz, speed in zip(pose.xyz_world, velocity_world, strict=True):
            then = xyz + speed * late_s
            expected = camera.project(then)
            motion = (camera.project(then + speed * _STEP_S) - expected) / _STEP_S
            for seen, score in zip(view.xy_img, view.score, strict=True):
                best = max(best, _sums(seen, score, expected, motion))
        if best[0] == 0 or best[2] == 0:
            return
        c = self._names.index(camera.name)
        self._along[c] += _FORGET * (best[1] - self._along[c])
        self._speed[c] += _FORGET * (best[2] - self._speed[c])
        self._views[c] += 1
        if self._views[c] >= _ENOUGH:
            found_s = float(np.clip(-self._along[c] / max(self._speed[c], 1e-9), -_MOST_SHIFT_S, _MOST_SHIFT_S))
            self._offset_s[c] += _GAIN * found_s
            self._offset_s -= self._offset_s.mean()


def _sums(seen: Array, score: Array, expected: Array, motion: Array) -> tuple[int, float, float]:
    """Keypoints that count, sum of v . r, sum of v . v."""
    residual = seen - expected
    speed = np.linalg.norm(motion, axis=-1)
    with np.errstate(invalid="ignore"):
        use = (score > 0) & (speed > _LEAST_PX_S) & (np.linalg.norm(residual, axis=-1) < _MOST_PX)
    v, r = motion[use], residual[use]
    return int(use.sum()), float((v * r).sum()), float((v * v).sum())
