"""A prediction as the regression of `tracking.online.own_motion` wants it, and one sample of it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from posefuse.core.arrays import Array
from posefuse.foundation.compiled import kernel

from .pose import places
from .state import all_models

# somewhat longer than a pose is predicted in a live session: over shorter times more of what is missed is noise
HORIZON_S, SAMPLE_EVERY_S = 0.1, 0.025
# who stops at once, or begins another movement, is corrected wrongly until the tests of the last moments show it
_MEMORY_S, _TESTED_MEMORY_S = 30.0, 0.5
_KEEP, _KEEP_TESTED = math.exp(-SAMPLE_EVERY_S / _MEMORY_S), math.exp(-SAMPLE_EVERY_S / _TESTED_MEMORY_S)
# sum of squared corrections at which they count half, (m/s)^2
_TESTED = 0.05
# what is farther off is another thing taken for the keypoint, and no motion; no correction is larger
MOST_M = 0.2
# views older than this do not count in the age of what is known; corrections do not grow beyond that of a pose so old
_NEWEST_S, _OLDEST_S = 0.15, 0.15
# usual sizes of what is regressed on, m and m/s
_SCALE_M, _SCALE_M_S = 0.3, 1.5
_LEAST_M = 0.05


class WatchedKeypoints(NamedTuple):
    """joints: (J,) keypoints whose places and velocities against the hips are regressed on. trunk: (4,) hips and shoulders."""

    joints: Array
    trunk: Array


class Prediction(NamedTuple):
    """A person some time after a state.

    frame: (3, 3) the axes of the trunk as rows. features: (D,), D = 4 + 6 J. places: (K, 3) predicted.
    ages: (K,) mean age of the views of each keypoint at the time of the state, s.
    """

    frame: Array
    features: Array
    places: Array
    ages: Array


class Regression(NamedTuple):
    """Of what predictions missed on their features.

    square: (D, D) and cross: (D, K, 3), the normal equations. weights: (D, K, 3), their solution.
    tested: (K, 2) sums of expected times missed, and of expected squared.
    """

    square: Array
    cross: Array
    weights: Array
    tested: Array


@kernel()
def anticipate(person, session, watched, made):
    """Predict a person by `HORIZON_S` from the time of a state into `made`; False where the trunk is not known."""
    joints, trunk = watched
    frame, features, expected, ages = made
    seen, time = person.seen, person.time[0]
    k, count = seen.shape
    now = np.empty((k, 3))
    places(person, all_models(0.0, session.models)[0], now)
    places(person, all_models(HORIZON_S, session.models)[0], expected)
    if not _trunk_axes(now, trunk, frame):
        return False
    middle, moved = np.empty(3), np.empty(3)
    for a in range(3):
        middle[a] = 0.5 * (now[trunk[0], a] + now[trunk[1], a])
        moved[a] = 0.5 * (expected[trunk[0], a] + expected[trunk[1], a]) - middle[a]
    features[0] = 1.0
    _turned(frame, moved, 1.0 / (HORIZON_S * _SCALE_M_S), features[1:4])
    away, faster = np.empty(3), np.empty(3)
    for n in range(len(joints)):
        i = joints[n]
        for a in range(3):
            away[a] = now[i, a] - middle[a]
            faster[a] = expected[i, a] - now[i, a] - moved[a]
        _turned(frame, away, 1.0 / _SCALE_M, features[4 + 6 * n : 7 + 6 * n])
        _turned(frame, faster, 1.0 / (HORIZON_S * _SCALE_M_S), features[7 + 6 * n : 10 + 6 * n])
    for d in range(len(features)):
        # what is not known of the body counts as usual
        if not math.isfinite(features[d]):
            features[d] = 0.0
    for i in range(k):
        total, views = 0.0, 0
        for c in range(count):
            if time - seen[i, c] <= _NEWEST_S:
                total += time - seen[i, c]
                views += 1
        ages[i] = total / views if views > 0 else _NEWEST_S
    return True


@kernel()
def _trunk_axes(now, trunk, frame):
    """Across the hips, and up to the shoulders; False where they are not known."""
    across, up = np.empty(3), np.empty(3)
    for a in range(3):
        across[a] = now[trunk[0], a] - now[trunk[1], a]
        up[a] = now[trunk[2], a] + now[trunk[3], a] - now[trunk[0], a] - now[trunk[1], a]
    length = math.sqrt(across @ across)
    if not length > _LEAST_M:
        return False
    across /= length
    up -= (up @ across) * across
    length = math.sqrt(up @ up)
    if not length > _LEAST_M:
        return False
    up /= length
    frame[0], frame[1] = across, up
    frame[2, 0] = across[1] * up[2] - across[2] * up[1]
    frame[2, 1] = across[2] * up[0] - across[0] * up[2]
    frame[2, 2] = across[0] * up[1] - across[1] * up[0]
    return True


@kernel()
def _turned(frame, vector, scale, out):
    for i in range(3):
        out[i] = scale * (frame[i, 0] * vector[0] + frame[i, 1] * vector[1] + frame[i, 2] * vector[2])


@kernel()
def correct(made, regression, since_s, xyz):
    """Add to positions (K, 3), predicted since_s from a state, what predictions from this state are expected to miss."""
    tested = regression.tested
    speed = np.empty(xyz.shape)
    missing_per_second(made.features, regression.weights, speed)
    for i in range(len(xyz)):
        # by how much corrections have to be multiplied to be right on average, as far as they were tested
        right = min(max(tested[i, 0] / (tested[i, 1] + _TESTED), 0.0), 1.0)
        age_s = min(made.ages[i] + since_s, _OLDEST_S)
        for a in range(3):
            along = 0.0
            for d in range(3):
                along += speed[i, d] * made.frame[d, a]
            xyz[i, a] += min(max(age_s * right * along, -MOST_M), MOST_M)


@kernel()
def missing_per_second(features, weights, out):
    """What the regression expects predictions to miss: out (K, 3) from features (D,) and weights (D, K, 3)."""
    out[:] = 0.0
    for d in range(len(features)):
        for i in range(out.shape[0]):
            for a in range(3):
                out[i, a] += features[d] * weights[d, i, a]


@kernel()
def learn(features, missed, good, regression):
    """One sample: features (D,) and what the prediction missed per second (K, 3), in the axes of the trunk.

    Older samples count `_KEEP` times less in the normal equations, and `_KEEP_TESTED` times less in the tests. Keypoints that are
    not `good` (K,) count as if the weights were right about them.
    """
    square, cross, weights, tested = regression
    d, k = len(features), len(missed)
    for i in range(d):
        for j in range(d):
            square[i, j] = _KEEP * square[i, j] + features[i] * features[j]
    expected = np.empty((k, 3))
    missing_per_second(features, weights, expected)
    for i in range(k):
        both, own = 0.0, 0.0
        for a in range(3):
            both += missed[i, a] * expected[i, a]
            own += expected[i, a] ** 2
        if good[i]:
            tested[i, 0] = _KEEP_TESTED * tested[i, 0] + both
            tested[i, 1] = _KEEP_TESTED * tested[i, 1] + own
        for a in range(3):
            seen = missed[i, a] if good[i] else expected[i, a]
            for j in range(d):
                cross[j, i, a] = _KEEP * cross[j, i, a] + features[j] * seen
