"""A hand at rest made steady: noise is smoothed away while the hand rests, and let through unchanged while it moves.

A low-pass filter whose time constant falls to nothing as soon as there is evidence of motion, as in the One-Euro filter (Casiez,
Roussel and Vogel 2012). The evidence is measured in standard deviations of the noise, so that a hand known exactly is not
filtered at all: how far the hand is from the filtered one, which shows quick motions at once, and its mean speed, which shows
slow ones.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from posefuse.core.arrays import Array

from .values import OperatorView

_S = 1e9
# time constant at rest, and of the mean speed
_REST_S, _SPEED_S = 0.6, 0.35
# errors of networks last for some frames
_NOISE_S = 0.1
# evidence begins at so many standard deviations, and nothing is filtered so many later; chosen on seeds and paths that
# `bench/teleoperation.py` does not use
_FAR, _FAR_RANGE = 2.5, 1.0
_FAST, _FAST_RANGE = 2.0, 1.5
# hands with less noise than this need no more than a part of the filter
_LEAST_M = 0.002
# views farther apart do not continue each other
_GAP_S = 0.1


@dataclass(frozen=True, eq=False, kw_only=True)
class Steady:
    """Hands of one person, filtered.

    Attributes:
        t_ns: of the newest view. person_id: whose. xyz_world: (H, 3). slow_xyz: (H, 3) low-pass whose distance shows the speed.
    """

    t_ns: int
    person_id: int
    xyz_world: Array
    slow_xyz: Array


def steadied(steady: Steady | None, view: OperatorView, noise_m: float) -> Steady:
    """The hands with a new view taken in.

    Args:
        noise_m: noise to expect at most, root mean square distance; less where the view states less; 0 filters nothing.
    """
    passed_s = (view.t_ns - steady.t_ns) / _S if steady is not None else 0.0
    goes_on = steady is not None and steady.person_id == view.person_id and 0 <= passed_s <= _GAP_S
    if steady is None or not goes_on or not np.isfinite(steady.xyz_world + view.xyz_world + view.sigma_m[:, None]).all():
        return Steady(t_ns=view.t_ns, person_id=view.person_id, xyz_world=view.xyz_world, slow_xyz=view.xyz_world)
    noise = np.minimum(noise_m, math.sqrt(3.0) * view.sigma_m)[:, None]
    slow = steady.slow_xyz + passed_s / (_SPEED_S + passed_s) * (view.xyz_world - steady.slow_xyz)
    with np.errstate(divide="ignore", invalid="ignore"):
        far = _length(view.xyz_world - steady.xyz_world) / noise
        # of noise that lasts for _NOISE_S, what is left in the difference from its own low-pass
        fast = _length(view.xyz_world - slow) / noise * math.sqrt(1 + _NOISE_S / _SPEED_S)
        motion = np.maximum((far - _FAR) / _FAR_RANGE, (fast - _FAST) / _FAST_RANGE)
    rests = np.where(noise > 0, 1 - np.clip(np.nan_to_num(motion, nan=1.0), 0.0, 1.0), 0.0) ** 3
    constant_s = _REST_S * rests * np.minimum(1.0, noise / _LEAST_M)
    share = passed_s / (constant_s + passed_s) if passed_s > 0 else np.zeros_like(noise)
    xyz = steady.xyz_world + share * (view.xyz_world - steady.xyz_world)
    return Steady(t_ns=view.t_ns, person_id=view.person_id, xyz_world=xyz, slow_xyz=slow)


def _length(vectors: Array) -> Array:
    return np.asarray(np.linalg.norm(vectors, axis=-1, keepdims=True))
