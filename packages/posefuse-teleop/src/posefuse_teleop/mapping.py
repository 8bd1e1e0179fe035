"""The hand, steady while it rests -> target of the end effector, by a relative displacement with a clutch. Pure functions.

As in the paper, only what the hand has moved since the clutch engaged counts. At that moment the target is where the robot
was commanded to be, so engaging moves nothing, at any scale and any number of times.

Noise is smoothed away while the hand rests, and let through unchanged while it moves: by a low-pass filter whose time constant
falls to nothing as soon as there is evidence of motion, as in the One-Euro filter (Casiez, Roussel and Vogel 2012). The evidence
is its mean speed, measured in standard deviations of the noise, so that a hand known exactly is not filtered at all.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from posefuse.core.arrays import Array
from posefuse.core.se3 import quaternion_product

from .settings import REST_NOISE_M, LimitSettings, MappingSettings
from .values import OperatorView


@dataclass(frozen=True, eq=False, kw_only=True)
class Clutch:
    """Where hands and end effectors were when the clutch engaged, and the target since.

    Attributes:
        hand_xyz: (H, 3) hands. home_xyz: (H, 3) end effectors, moved along when the target was held back.
        xyz, wxyz: (H, 3), (H, 4) the target; its orientation stays that of the robot.
    """

    hand_xyz: Array
    home_xyz: Array
    xyz: Array
    wxyz: Array


def engaged(hand_xyz: Array, robot_xyz: Array, robot_wxyz: Array) -> Clutch:
    """The clutch at the moment it engages: the target is the robot's commanded pose, exactly."""
    return Clutch(hand_xyz=hand_xyz, home_xyz=robot_xyz, xyz=robot_xyz, wxyz=robot_wxyz)


def moved(clutch: Clutch, hand_xyz: Array, robot_xyz: Array, mapping: MappingSettings, limits: LimitSettings) -> Clutch:
    """The clutch after the hands moved: the target follows, stays in the box and near the robot, and winds nothing up.

    Where the target is held back, `home` moves along, so that it follows immediately when the hand reverses.
    """
    turn = _about_vertical(np.deg2rad(mapping.turn_deg))
    wanted = clutch.home_xyz + mapping.scale * (hand_xyz - clutch.hand_xyz) @ turn.T
    held = _held_back(wanted, robot_xyz, mapping.lead_m, limits)
    return replace(clutch, home_xyz=clutch.home_xyz + (held - wanted), xyz=held)


def _held_back(wanted: Array, robot_xyz: Array, lead_m: float, limits: LimitSettings) -> Array:
    ahead = wanted - robot_xyz
    far = np.linalg.norm(ahead, axis=-1, keepdims=True)
    near = robot_xyz + ahead * np.minimum(1.0, lead_m / np.maximum(far, 1e-12))
    # a robot that stands outside of the box may stay, and come in
    low, high = np.minimum(limits.box_low_m, robot_xyz), np.maximum(limits.box_high_m, robot_xyz)
    return np.asarray(np.clip(np.where(far > lead_m, near, wanted), low, high))


def rotvec_between(start: Array, end: Array) -> Array:
    """(3,) rotation vector, world axes, from one unit quaternion to the other along the shorter path."""
    back = start * np.array([1.0, -1.0, -1.0, -1.0])
    q = quaternion_product(end, back)
    q = -q if q[0] < 0 else q
    sine = float(np.linalg.norm(q[1:]))
    return np.asarray(q[1:] * (2 * np.arctan2(sine, q[0]) / sine if sine > 1e-9 else 2.0))


def _about_vertical(angle_rad: float) -> Array:
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


# time constant at rest, and of the mean speed
_REST_S, _SPEED_S = 0.6, 0.35
# errors of networks last for some frames
_NOISE_S = 0.1
# evidence begins at so many standard deviations, and nothing is filtered so many later; chosen on seeds and paths that
# `bench/teleoperation.py` does not use
_FAST, _FAST_RANGE = 2.0, 1.5
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


def steadied(steady: Steady | None, view: OperatorView, noise_m: float = REST_NOISE_M) -> Steady:
    """The hands with a new view taken in.

    Args:
        noise_m: noise to expect at most, root mean square distance; less where the view states less; 0 filters nothing.
    """
    passed_s = (view.t_ns - steady.t_ns) / 1e9 if steady is not None else 0.0
    goes_on = steady is not None and steady.person_id == view.person_id and 0 <= passed_s <= _GAP_S
    if steady is None or not goes_on or not np.isfinite(steady.xyz_world + view.xyz_world + view.sigma_m[:, None]).all():
        return Steady(t_ns=view.t_ns, person_id=view.person_id, xyz_world=view.xyz_world, slow_xyz=view.xyz_world)
    noise = np.minimum(noise_m, math.sqrt(3.0) * view.sigma_m)[:, None]
    slow = steady.slow_xyz + passed_s / (_SPEED_S + passed_s) * (view.xyz_world - steady.slow_xyz)
    with np.errstate(divide="ignore", invalid="ignore"):
        # of noise that lasts for _NOISE_S, what is left in the difference from its own low-pass
        fast = _lengths(view.xyz_world - slow) / noise * math.sqrt(1 + _NOISE_S / _SPEED_S)
    motion = np.clip((np.nan_to_num(fast, nan=np.inf) - _FAST) / _FAST_RANGE, 0.0, 1.0)
    constant_s = _REST_S * (1 - motion) ** 3
    share = passed_s / (constant_s + passed_s) if passed_s > 0 else np.zeros_like(noise)
    xyz = steady.xyz_world + share * (view.xyz_world - steady.xyz_world)
    return Steady(t_ns=view.t_ns, person_id=view.person_id, xyz_world=xyz, slow_xyz=slow)


def _lengths(vectors: Array) -> Array:
    return np.asarray(np.linalg.norm(vectors, axis=-1, keepdims=True))
