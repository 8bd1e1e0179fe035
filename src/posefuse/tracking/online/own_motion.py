"""How a person moves on, learnt from the person's own motion while it is tracked.

The motion models of keypoints know nothing of a gait or an exercise. But people repeat themselves, and how a limb is accelerated
follows from the pose and the velocity of the body. So predictions over `HORIZON_S` are compared with what the views of that time
showed, and the difference is regressed on pose and velocity: ridge regression, recursive, older samples fade. Nothing is known
of other people, and a correction counts only as far as the corrections before it were right.

It learns from states that no late view can change any more, so the order in which views arrive makes no difference.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from posefuse.core import Skeleton
from posefuse.core.arrays import Array
from posefuse.core.skeleton import SIDES

from .kernels import own_motion as kernels
from .kernels.state import SessionArrays, TrackState

_HORIZON_NS, _EVERY_NS = round(kernels.HORIZON_S * 1e9), round(kernels.SAMPLE_EVERY_S * 1e9)
# samples, 0.2 s; chosen, not fitted, to spare the solve, whose cost is cubic: less than a hundredth of the memory, so few of the
# samples that the weights are made from are new
_SOLVE_EVERY = 8
# the weight of no correction at all, in samples
_RIDGE = 0.3
_JOINTS = ("shoulder", "elbow", "wrist", "knee", "ankle")
_TRUNK = tuple(f"{side}_{joint}" for joint in ("hip", "shoulder") for side in SIDES)


class OwnMotion:
    """What is learnt of one person. A skeleton without hips and shoulders has no trunk to refer to: nothing is corrected."""

    def __init__(self, skeleton: Skeleton, session: SessionArrays) -> None:
        places = {name: i for i, name in enumerate(skeleton.keypoints)}
        self._session, self._skeleton = session, skeleton
        joints = np.array([places[f"{s}_{j}"] for s in SIDES for j in _JOINTS if f"{s}_{j}" in places], np.intp)
        trunk = np.array([places[name] for name in _TRUNK if name in places], np.intp)
        self._watched = kernels.WatchedKeypoints(joints, trunk)
        size, k = 4 + 6 * len(joints), len(skeleton)
        self._regression = kernels.Regression(
            square=np.zeros((size, size)), cross=np.zeros((size, k, 3)), weights=np.zeros((size, k, 3)), tested=np.zeros((k, 2))
        )
        self._samples = 0
        # by the time of the state they were made from
        self._waiting: deque[tuple[int, kernels.Prediction]] = deque()

    def waits_until_ns(self) -> int | None:
        """Time at which the next prediction can be judged."""
        return self._waiting[0][0] + _HORIZON_NS if self._waiting else None

    def judge(self, seen: Array) -> None:
        """The first prediction that waits by where the keypoints (K, 3) were at its time."""
        _, made = self._waiting.popleft()
        off_m = seen - made.places
        good = np.linalg.norm(off_m, axis=-1) < kernels.MOST_M
        age_s = (made.ages + kernels.HORIZON_S)[:, None]
        missed = np.where(good[:, None], off_m @ made.frame.T / age_s, 0.0)
        kernels.learn(made.features, missed, good, self._regression)
        self._samples += 1
        if self._samples % _SOLVE_EVERY == 0:
            square, cross, weights, _ = self._regression
            solved = np.linalg.solve(square + _RIDGE * np.eye(len(square)), cross.reshape(len(square), -1))
            weights[:] = solved.reshape(weights.shape)

    def settle(self, state: TrackState, t_ns: int) -> None:
        """The state after a view at t_ns, once no earlier view can come: perhaps predict from it."""
        if self._waiting and t_ns - self._waiting[-1][0] < _EVERY_NS:
            return
        made = self._predicted(state)
        if made is not None:
            self._waiting.append((t_ns, made))

    def begin_again(self) -> None:
        """What was predicted so far was about something else."""
        self._waiting.clear()

    def correct(self, state: TrackState, since_s: float, xyz: Array) -> None:
        """Add to a pose (K, 3) in the world, predicted since_s from the state, what is known that it will miss."""
        if self._samples < _SOLVE_EVERY or since_s <= 0:
            return
        made = self._predicted(state)
        if made is not None:
            kernels.correct(made, self._regression, since_s, xyz)

    def _predicted(self, state: TrackState) -> kernels.Prediction | None:
        if len(self._watched.trunk) < len(_TRUNK):
            return None
        k = len(self._skeleton)
        made = kernels.Prediction(np.empty((3, 3)), np.empty(len(self._regression.square)), np.empty((k, 3)), np.empty(k))
        known = kernels.anticipate(state, self._session, self._watched, made)
        return made if known else None
