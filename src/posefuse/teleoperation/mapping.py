"""Relative displacement of the hand -> target of the end effector, with a clutch. Pure functions.

As in the paper, only what the hand has moved since the clutch engaged counts. At that moment the target is where the robot
was commanded to be, so engaging moves nothing, at any scale and any number of times.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from posefuse.core.arrays import Array
from posefuse.core.se3 import quaternion_product, wxyz_from_matrix, wxyz_from_rotvec

from .settings import LimitSettings, MappingSettings

# a target is turned no farther ahead of the robot than this, as `lead_m` for its position
_LEAD_RAD = 0.5


@dataclass(frozen=True, eq=False, kw_only=True)
class Clutch:
    """Where hands and end effectors were when the clutch engaged, and the target since.

    Attributes:
        hand_xyz: (H, 3) hands. hand_rotation: (H, 3, 3) forearm frames; NaN until one is known.
        home_xyz: (H, 3) end effectors, moved along when the target was held back. home_wxyz: (H, 4).
        xyz, wxyz: (H, 3), (H, 4) the target.
    """

    hand_xyz: Array
    hand_rotation: Array
    home_xyz: Array
    home_wxyz: Array
    xyz: Array
    wxyz: Array


def engaged(hand_xyz: Array, hand_rotation: Array, robot_xyz: Array, robot_wxyz: Array) -> Clutch:
    """The clutch at the moment it engages: the target is the robot's commanded pose, exactly."""
    return Clutch(
        hand_xyz=hand_xyz,
        hand_rotation=hand_rotation,
        home_xyz=robot_xyz,
        home_wxyz=robot_wxyz,
        xyz=robot_xyz,
        wxyz=robot_wxyz,
    )


def moved(
    clutch: Clutch,
    hand_xyz: Array,
    hand_rotation: Array,
    robot_xyz: Array,
    robot_wxyz: Array,
    *,
    mapping: MappingSettings,
    limits: LimitSettings,
) -> Clutch:
    """The clutch after the hands moved: the target follows, stays in the box and near the robot, and winds nothing up.

    Where the target is held back, `home` moves along, so that it follows immediately when the hand reverses.
    """
    turn = _about_vertical(np.deg2rad(mapping.turn_deg))
    wanted = clutch.home_xyz + mapping.scale * (hand_xyz - clutch.hand_xyz) @ turn.T
    held = _held_back(wanted, robot_xyz, mapping.lead_m, limits)
    clutch = replace(clutch, home_xyz=clutch.home_xyz + (held - wanted), xyz=held)
    return _turned(clutch, hand_rotation, robot_wxyz, turn) if mapping.orientation == "forearm" else clutch


def _held_back(wanted: Array, robot_xyz: Array, lead_m: float, limits: LimitSettings) -> Array:
    ahead = wanted - robot_xyz
    far = np.linalg.norm(ahead, axis=-1, keepdims=True)
    near = robot_xyz + ahead * np.minimum(1.0, lead_m / np.maximum(far, 1e-12))
    # a robot that stands outside of the box may stay, and come in
    low, high = np.minimum(limits.box_low_m, robot_xyz), np.maximum(limits.box_high_m, robot_xyz)
    return np.asarray(np.clip(np.where(far > lead_m, near, wanted), low, high))


def _turned(clutch: Clutch, hand_rotation: Array, robot_wxyz: Array, turn: Array) -> Clutch:
    """The target turned as the forearms turned; a forearm whose frame is undefined turns nothing."""
    wxyz, home, origin = clutch.wxyz.copy(), clutch.home_wxyz.copy(), clutch.hand_rotation.copy()
    for h in range(len(wxyz)):
        if not np.isfinite(hand_rotation[h]).all():
            continue
        if not np.isfinite(origin[h]).all():
            # known for the first time: from here on it counts
            origin[h], home[h] = hand_rotation[h], wxyz[h]
            continue
        turned = wxyz_from_matrix(turn @ hand_rotation[h] @ origin[h].T @ turn.T)
        wanted = quaternion_product(turned, home[h])
        wxyz[h] = near = _near(wanted, robot_wxyz[h])
        home[h] = quaternion_product(conjugate(turned), near)
    return replace(clutch, wxyz=wxyz, home_wxyz=home, hand_rotation=origin)


def _near(wanted: Array, robot: Array) -> Array:
    error = rotvec_between(robot, wanted)
    angle = float(np.linalg.norm(error))
    if angle <= _LEAD_RAD:
        return wanted
    return quaternion_product(wxyz_from_rotvec(error * (_LEAD_RAD / angle)), robot)


def rotvec_between(start: Array, end: Array) -> Array:
    """(3,) rotation vector, world axes, from one unit quaternion to the other along the shorter path."""
    q = quaternion_product(end, conjugate(start))
    q = -q if q[0] < 0 else q
    sine = float(np.linalg.norm(q[1:]))
    return np.asarray(q[1:] * (2 * np.arctan2(sine, q[0]) / sine if sine > 1e-9 else 2.0))


def conjugate(wxyz: Array) -> Array:
    """The inverse of a unit quaternion."""
    return np.asarray(wxyz * np.array([1.0, -1.0, -1.0, -1.0]))


def _about_vertical(angle_rad: float) -> Array:
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
