"""Where most cameras see a keypoint that some camera keeps placing elsewhere.

A filter that takes one view after the other believes what it believed before: should it have begun with a wrong view, the right
ones lie beyond its gate for good. So the newest ray of every camera is kept, and a camera that is refused again and again may ask
which place explains the rays best, the tracked one or one where its own ray meets another.
"""

from __future__ import annotations

import math

import numpy as np

from posefuse.foundation.compiled import kernel
from posefuse.tracking.matrix_kernels import inverse3

from .rays import ray

RAY = 5  # of a camera's newest ray: x, y on the ideal image plane, 1/variance there, time, views refused in a row
ASK_AFTER = 3.0  # views refused in a row
_OLDEST_S = 0.15  # of a ray that counts
_MOVES_M_S = 1.0  # by so much, against the body, a keypoint may have moved since
_OUTLIER_M = 0.3  # size of the place in which wrong rays end up
_WIDER = 4.0  # variance of a ray of a hidden keypoint over what the network states
_BONE_M = 0.04  # by so much both sides differ, as a network marks them
_BONE_MOST = 3.0  # most that a bone can say
_BETTER = 2.0  # by so much the logarithm of the likelihood has to be better


@kernel()
def _certain(one, distance, t):
    """1/variance of a ray at time t; 0 where it is too old or was never there."""
    age = t - one[3]
    if not one[2] > 0.0 or age > _OLDEST_S:
        return 0.0
    return 1.0 / (_WIDER / one[2] + (_MOVES_M_S * age / distance) ** 2)


@kernel()
def support(cameras, newest, t, velocity, point):
    """Logarithm of the likelihood of all newest rays (C, RAY) for a keypoint at point (3,) that moves like the body.

    A ray explains the keypoint, or it is an outlier that ends anywhere near it. Returns it and how many rays explain it.
    """
    total, agree = 0.0, 0
    there, h, slope = np.empty(3), np.empty(2), np.empty((2, 3))
    for c in range(len(newest)):
        for a in range(3):
            there[a] = point[a] + velocity[a] * (newest[c, 3] - t)
        distance2 = 0.0
        for a in range(3):
            distance2 += (there[a] - cameras[c, 12 + a]) ** 2
        w = _certain(newest[c], math.sqrt(distance2), t)
        if w <= 0.0 or not ray(cameras[c], there, h, slope):
            continue
        far = w * ((newest[c, 0] - h[0]) ** 2 + (newest[c, 1] - h[1]) ** 2)
        gain = math.log(max(w * _OUTLIER_M**2 / distance2, 1.0)) - 0.5 * far
        if gain > 0.0:
            total += gain
            agree += 1
    return total, agree


@kernel()
def _add_ray(camera, one, t, velocity, information, pull):
    """Two linear equations of a world point at time t, weighted alike."""
    row = np.empty(3)
    for r in range(2):
        right = one[r] * camera[11] - camera[9 + r]
        for a in range(3):
            row[a] = camera[3 * r + a] - one[r] * camera[6 + a]
        # the ray belongs to where the point was then
        for a in range(3):
            right -= row[a] * velocity[a] * (one[3] - t)
        for a in range(3):
            pull[a] += row[a] * right
            for d in range(3):
                information[a, d] += row[a] * row[d]


@kernel()
def _symmetry(i, place, means, neighbours, mirror):
    """Logarithm of the likelihood of the bones of keypoint i at a place (3,), as long as those of the other side are now."""
    total, other = 0.0, mirror[i]
    if other == i or not math.isfinite(means[other, 0]):
        return 0.0
    for o in neighbours[i]:
        if o < 0 or o == other or not (math.isfinite(means[o, 0]) and math.isfinite(means[mirror[o], 0])):
            continue
        own2, other2 = 0.0, 0.0
        for a in range(3):
            own2 += (place[a] - means[o, a]) ** 2
            other2 += (means[other, a] - means[mirror[o], a]) ** 2
        longer = math.sqrt(own2) - math.sqrt(other2)
        total -= min(0.5 * (longer / _BONE_M) ** 2, _BONE_MOST)
    return total


@kernel()
def _meeting(cameras, newest, c, o, t, velocity, place):
    """Where the newest rays (C, RAY) of two cameras meet, in `place` (3,); False where one is missing."""
    for one in (c, o):
        if not newest[one, 2] > 0.0 or t - newest[one, 3] > _OLDEST_S:
            return False
    information, inverse, pull = np.zeros((3, 3)), np.empty((3, 3)), np.zeros(3)
    _add_ray(cameras[c], newest[c], t, velocity, information, pull)
    _add_ray(cameras[o], newest[o], t, velocity, information, pull)
    inverse3(information, inverse)
    for a in range(3):
        place[a] = 0.0
        for d in range(3):
            place[a] += inverse[a, d] * pull[d]
    return True


@kernel()
def elsewhere(i, cameras, newest, c, t, velocity, means, neighbours, mirror, found):
    """Whether keypoint i is likelier where the ray of camera c meets that of another; `found` (3,) is where, in the world.

    Args:
        newest: (C, RAY) of the keypoint. velocity: (3,) of the body. means: (K + 1, 3), see `step`.
    """
    body, place = means[-1], np.empty(3)
    best, _ = support(cameras, newest, t, velocity, means[i] + body)
    best += _BETTER + _symmetry(i, means[i], means, neighbours, mirror)
    better = False
    for o in range(len(newest)):
        if o == c or not _meeting(cameras, newest, c, o, t, velocity, place):
            continue
        total, agree = support(cameras, newest, t, velocity, place)
        total += _symmetry(i, place - body, means, neighbours, mirror)
        if agree > 1 and total > best:
            best, better = total, True
            found[:] = place
    return better
