"""How a person moves on, learnt from the person's own motion while it is tracked.

The motion models of keypoints know nothing of a gait or an exercise. But people repeat themselves, and how a limb is accelerated
follows from the pose and the velocity of the body. So predictions over `HORIZON_S` are compared with what the views of that time
showed, and the difference is regressed on pose and velocity: ridge regression, recursive, older samples fade. Nothing is known
of other people, and a correction counts only as far as the corrections before it were right.

It learns from states that no late view can change any more, so the order in which views arrive makes no difference.

Rendered people, views 20 to 60 ms late: a walk is 25 mm off (28 without it), the demo clip 22 mm (28).
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from posefuse.core import Skeleton
from posefuse.core.arrays import Array
from posefuse.core.skeleton import SIDES

# somewhat longer than a pose is predicted in a live session: over shorter times more of what is missed is noise
HORIZON_S = 0.1
_HORIZON_NS, _EVERY_NS = round(HORIZON_S * 1e9), 25_000_000
# who stops at once, or begins another movement, is corrected wrongly until the tests of the last moments show it
_MEMORY_S, _TESTED_MEMORY_S = 30.0, 0.5
_KEEP, _KEEP_TESTED = math.exp(-_EVERY_NS * 1e-9 / _MEMORY_S), math.exp(-_EVERY_NS * 1e-9 / _TESTED_MEMORY_S)
# samples, 0.2 s; chosen, not fitted, to spare the solve, whose cost is cubic: less than a hundredth of the memory, so few of the
# samples that the weights are made from are new
_SOLVE_EVERY = 8
# the weight of no correction at all, in samples
_RIDGE = 0.3
# sum of squared corrections at which they count half, (m/s)^2
_TESTED = 0.05
# what is farther off is another thing taken for the keypoint, and no motion; no correction is larger
_MOST_M = 0.2
# corrections do not grow beyond those of a pose predicted so long
_LONGEST_S = 0.15
# usual sizes of what is regressed on, m and m/s
_SCALE_M, _SCALE_M_S = 0.3, 1.5
_LEAST_M = 0.05
_JOINTS = ("shoulder", "elbow", "wrist", "knee", "ankle")
_TRUNK = tuple(f"{side}_{joint}" for joint in ("hip", "shoulder") for side in SIDES)


class _Prediction(NamedTuple):
    """frame: (3, 3) the axes of the trunk as rows. features: (D,). places: (K, 3) expected."""

    frame: Array
    features: Array
    places: Array


class OwnMotion:
    """What is learnt of one person. A skeleton without hips and shoulders has no trunk to refer to: nothing is corrected."""

    def __init__(self, skeleton: Skeleton) -> None:
        places = {name: i for i, name in enumerate(skeleton.keypoints)}
        self._joints = [places[f"{s}_{j}"] for s in SIDES for j in _JOINTS if f"{s}_{j}" in places]
        self._trunk = [places[name] for name in _TRUNK if name in places]
        size, k = 4 + 6 * len(self._joints), len(skeleton)
        # the normal equations of what predictions missed on their features, and their solution
        self._square: Array = np.zeros((size, size))
        self._cross: Array = np.zeros((size, k * 3))
        self._weights: Array = np.zeros((size, k * 3))
        # (2, K) sums of expected times missed, and of expected squared
        self._tested: Array = np.zeros((2, k))
        self._samples = 0
        # by the time of the state they were made from
        self._waiting: deque[tuple[int, _Prediction]] = deque()

    def waits_until_ns(self) -> int | None:
        """Time at which the next prediction can be judged."""
        return self._waiting[0][0] + _HORIZON_NS if self._waiting else None

    def judge(self, seen: Array) -> None:
        """The first prediction that waits by where the keypoints (K, 3) were at its time."""
        _, made = self._waiting.popleft()
        off_m = seen - made.places
        good = np.linalg.norm(off_m, axis=-1) < _MOST_M
        expected = self._missing(made)
        # of the others the weights were right
        missed = np.where(good[:, None], off_m @ made.frame.T / HORIZON_S, expected)
        tests = np.array([(missed * expected).sum(axis=1), (expected**2).sum(axis=1)])
        self._tested = np.where(good, _KEEP_TESTED * self._tested + tests, self._tested)
        self._square = _KEEP * self._square + np.outer(made.features, made.features)
        self._cross = _KEEP * self._cross + np.outer(made.features, missed)
        self._samples += 1
        if self._samples % _SOLVE_EVERY == 0:
            self._weights = np.linalg.solve(self._square + _RIDGE * np.eye(len(self._square)), self._cross)

    def wants(self, t_ns: int) -> bool:
        """Whether to predict from the state after a view at t_ns, once no earlier view can come."""
        return not self._waiting or t_ns - self._waiting[-1][0] >= _EVERY_NS

    def settle(self, t_ns: int, now: Array, later: Array) -> None:
        """Predict from the state after a view at t_ns: places (K, 3) by it, and `HORIZON_S` later."""
        made = self._predicted(now, later)
        if made is not None:
            self._waiting.append((t_ns, made))

    def begin_again(self) -> None:
        """What was predicted so far was about something else."""
        self._waiting.clear()

    def correction(self, now: Array, later: Array, since_s: float) -> Array | float:
        """(K, 3) world m, to be added to a pose predicted since_s from a state, see `settle`: what it is expected to miss."""
        made = self._predicted(now, later)
        if made is None:
            return 0.0
        # by how much corrections have to be multiplied to be right on average, as far as they were tested
        right = np.clip(self._tested[0] / (self._tested[1] + _TESTED), 0.0, 1.0)
        expected_m = min(since_s, _LONGEST_S) * self._missing(made) @ made.frame
        return np.asarray(np.clip(right[:, None] * expected_m, -_MOST_M, _MOST_M))

    def _missing(self, made: _Prediction) -> Array:
        """(K, 3) what a prediction is expected to miss, m/s in the axes of the trunk."""
        return (made.features @ self._weights).reshape(-1, 3)

    def _predicted(self, now: Array, later: Array) -> _Prediction | None:
        frame = _trunk_axes(now[self._trunk]) if len(self._trunk) == len(_TRUNK) else None
        if frame is None:
            return None
        hips = self._trunk[:2]
        middle = now[hips].mean(axis=0)
        moved = later[hips].mean(axis=0) - middle
        away, faster = now[self._joints] - middle, (later - now)[self._joints] - moved
        limbs = np.stack([away / _SCALE_M, faster / (HORIZON_S * _SCALE_M_S)], axis=1) @ frame.T
        features = np.concatenate([[1.0], frame @ moved / (HORIZON_S * _SCALE_M_S), limbs.ravel()])
        # what is not known of the body counts as usual
        return _Prediction(frame, np.nan_to_num(features), later)


def _trunk_axes(trunk: Array) -> Array | None:
    """(3, 3) across the hips, up to the shoulders, and ahead, as rows; None where hips and shoulders (4, 3) are not known."""
    across = trunk[0] - trunk[1]
    up = trunk[2] + trunk[3] - trunk[0] - trunk[1]
    up = up - (up @ across) / (across @ across) * across
    length_m, height_m = math.sqrt(across @ across), math.sqrt(up @ up)
    if not (length_m > _LEAST_M and height_m > _LEAST_M):
        return None
    across, up = across / length_m, up / height_m
    return np.array([across, up, np.cross(across, up)])
