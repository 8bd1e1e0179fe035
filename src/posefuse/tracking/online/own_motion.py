"""How a person moves on, learnt from the person's own motion while it is tracked.

The motion models of keypoints know nothing of a gait or an exercise. But people repeat themselves, and how a limb is accelerated
follows from the pose and the velocity of the body. So predictions over `HORIZON_S` are compared with what the views of that time
showed, and the difference is regressed on pose and velocity: ridge regression, recursive, older samples fade. Nothing is known
of other people, and a correction counts only as far as the corrections before it were right.

It learns from states that no late view can change any more, so the order in which views arrive makes no difference.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from posefuse.core import Skeleton
from posefuse.core.arrays import Array
from posefuse.core.skeleton import SIDES

from .kernels.own_motion import CorrectionLimits, Prediction, Regression, WatchedKeypoints, anticipate, correct, learn
from .kernels.state import SessionArrays

# somewhat longer than a pose is predicted in a live session: over shorter times more of what is missed is noise
HORIZON_S = 0.1
_HORIZON_NS = round(HORIZON_S * 1e9)
_EVERY_NS = 25_000_000
# who stops at once, or begins another movement, is corrected wrongly until the tests of the last moments show it
_MEMORY_S, _TESTED_MEMORY_S = 30.0, 0.5
_KEEP, _KEEP_TESTED = (math.exp(-_EVERY_NS * 1e-9 / memory_s) for memory_s in (_MEMORY_S, _TESTED_MEMORY_S))
# samples, 0.2 s; chosen, not fitted, to spare the solve, whose cost is cubic: less than a hundredth of the memory, so few of the
# samples that the weights are made from are new
_SOLVE_EVERY = 8
# the weight of no correction at all, in samples; sum of squared corrections at which they count half, (m/s)^2
_RIDGE, _TESTED = 0.3, 0.05
# what is farther off is another thing taken for the keypoint, and no motion; no correction is larger
_MOST_M = 0.2
# views older than this do not count in the age of what is known; corrections do not grow beyond that of a pose so old
_NEWEST_S, _OLDEST_S = 0.15, 0.15
_LIMITS = CorrectionLimits(tested=_TESTED, oldest_s=_OLDEST_S, most_m=_MOST_M)
_JOINTS = ("shoulder", "elbow", "wrist", "knee", "ankle")
_TRUNK = tuple(f"{side}_{joint}" for joint in ("hip", "shoulder") for side in SIDES)


class OwnMotion:
    """What is learnt of one person. A skeleton without hips and shoulders has no trunk to refer to: nothing is corrected."""

    def __init__(self, skeleton: Skeleton, session: SessionArrays) -> None:
        places = {name: i for i, name in enumerate(skeleton.keypoints)}
        self._session, self._skeleton = session, skeleton
        joints = np.array([places[f"{s}_{j}"] for s in SIDES for j in _JOINTS if f"{s}_{j}" in places], np.intp)
        trunk = np.array([places[name] for name in _TRUNK if name in places], np.intp)
        self._watched = WatchedKeypoints(joints, trunk)
        size, k = 4 + 6 * len(joints), len(skeleton)
        self._regression = Regression(
            square=np.zeros((size, size)), cross=np.zeros((size, k, 3)), weights=np.zeros((size, k, 3)), tested=np.zeros((k, 2))
        )
        self._samples = 0
        # by the time of the state they were made from
        self._waiting: deque[tuple[int, Prediction]] = deque()

    def waits_until_ns(self) -> int | None:
        """Time at which the next prediction can be judged."""
        return self._waiting[0][0] + _HORIZON_NS if self._waiting else None

    def judge(self, seen: Array) -> None:
        """The first prediction that waits by where the keypoints (K, 3) were at its time."""
        _, made = self._waiting.popleft()
        off_m = seen - made.places
        good = np.linalg.norm(off_m, axis=-1) < _MOST_M
        age_s = (made.ages + HORIZON_S)[:, None]
        missed = np.where(good[:, None], off_m @ made.frame.T / age_s, 0.0)
        learn(made.features, missed, good, _KEEP, _KEEP_TESTED, self._regression)
        self._samples += 1
        if self._samples % _SOLVE_EVERY == 0:
            square, cross, weights, _ = self._regression
            solved = np.linalg.solve(square + _RIDGE * np.eye(len(square)), cross.reshape(len(square), -1))
            weights[:] = solved.reshape(weights.shape)

    def settle(self, state: Array, t_ns: int) -> None:
        """The state after a view at t_ns, once no earlier view can come: perhaps predict from it."""
        if self._waiting and t_ns - self._waiting[-1][0] < _EVERY_NS:
            return
        made = self._predicted(state)
        if made is not None:
            self._waiting.append((t_ns, made))

    def begin_again(self) -> None:
        """What was predicted so far was about something else."""
        self._waiting.clear()

    def correct(self, state: Array, since_s: float, xyz: Array) -> None:
        """Add to a pose (K, 3) in the world, predicted since_s from the state, what is known that it will miss."""
        if self._samples < _SOLVE_EVERY or since_s <= 0:
            return
        made = self._predicted(state)
        if made is not None:
            correct(made, self._regression, since_s, _LIMITS, xyz)

    def _predicted(self, state: Array) -> Prediction | None:
        if len(self._watched.trunk) < len(_TRUNK):
            return None
        k = len(self._skeleton)
        made = Prediction(np.empty((3, 3)), np.empty(len(self._regression.square)), np.empty((k, 3)), np.empty(k))
        known = anticipate(state, self._session, HORIZON_S, _NEWEST_S, self._watched, made)
        return made if known else None
