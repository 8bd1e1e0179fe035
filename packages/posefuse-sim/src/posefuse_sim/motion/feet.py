"""One foot through the gait cycle: planted without sliding, rolling over heel and ball, and swung to the next place.

The cycle of a foot starts at its heel strike (part 0) and its stance ends at `duty`. In stance the heel's or the ball's
contact point is a fixed point of the floor (the three rockers of Perry 1992): the foot turns about the heel while the
toes come down, lies flat, then turns about the toe joints, the toes staying flat.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from posefuse.core.arrays import Array
from posefuse_sim.body import SimulatedBody
from posefuse_sim.body.anatomy import turn

_FLAT, _HEEL_OFF = 0.09, 0.33
_STRIKE_RAD, _PUSH_RAD = np.deg2rad(20.0), np.deg2rad(-64.0)
_PUSH_POWER, _LAND_POWER = 2.1, 2.3
_TABLE_RAD = np.deg2rad(np.arange(-85.0, 46.0))


@dataclass(frozen=True, eq=False)
class Sole:
    """Where one foot touches the floor, in level foot axes (x ahead, z up) from the ankle; the same on both sides.

    Attributes:
        heel_m, ball_m: (2,) x, z of the heel's contact point and of the toe joints.
        clearance_m: height of the ankle above the lowest point of the foot, at each of the table's pitch angles.
    """

    heel_m: Array
    ball_m: Array
    clearance_m: Array

    def ankle_height_m(self, pitch_rad: Array) -> Array:
        """Height (T,) of the ankle above the floor when the pitched foot just touches it, toes kept flat."""
        return np.interp(pitch_rad, _TABLE_RAD, self.clearance_m)


def sole_of(body: SimulatedBody) -> Sole:
    """Measure the left foot of the mesh."""
    ankle = body.points_rest["left_ankle"]
    names = ["foot.L", *(n for n in body.bone_names if n.startswith("toe") and n.endswith(".L"))]
    joints = np.array([body.bone_centre[body.bone(f"toe{i}-1.L")] for i in (1, 2)])
    shares = [np.where(body.bone_index == body.bone(n), body.bone_weight, 0.0).sum(axis=1) for n in names]
    foot = np.flatnonzero(sum(shares) > 0.5)
    toes = sum(shares[1:])[foot]
    local = body.vertices_rest[foot] - ankle
    lowest = local[:, 2].min()
    low = local[local[:, 2] < lowest + 0.015]
    ball = joints.mean(axis=0) - ankle
    heights = []
    for pitch in _TABLE_RAD:
        up = turn("y", -pitch)
        hinged = (local - ball) + ball @ up.T if pitch < 0 else local @ up.T
        heights.append(-((1 - toes) * (local @ up.T)[:, 2] + toes * hinged[:, 2]).min())
    return Sole(np.array([low[:, 0].min() + 0.012, lowest]), ball[[0, 2]], np.array(heights))


def stance_pitch(part: Array, duty: float, size: Array) -> Array:
    """Foot pitch (T,) in radians, toes up positive; `size` scales it with speed."""
    landing = np.clip(1 - part / _FLAT, 0.0, 1.0) ** _LAND_POWER
    pushing = np.clip((part - _HEEL_OFF) / (duty - _HEEL_OFF), 0.0, 1.1) ** _PUSH_POWER
    return np.asarray(size * (_STRIKE_RAD * landing + _PUSH_RAD * pushing))


def swing_pitch(swung: Array, duty: float, size: Array) -> Array:
    """Foot pitch (T,) at the part `swung` of the swing, continuous with the stance before and after."""
    leave = _PUSH_POWER * _PUSH_RAD / (duty - _HEEL_OFF) * (1 - duty)
    land = -_LAND_POWER * _STRIKE_RAD / _FLAT * (1 - duty)
    knots = np.array([0.0, 0.12, 0.47, 0.68, 0.86, 1.0])
    values = np.array([_PUSH_RAD, *np.deg2rad([-70.0, -29.0, -5.0, 13.0]), _STRIKE_RAD])
    slopes = np.array([leave, *np.deg2rad([0.0, 135.0, 135.0, 90.0]), 0.3 * land])
    return np.asarray(size * CubicHermiteSpline(knots, values, slopes)(swung))


def toes_up(pitch: Array, planted: Array, swung: Array) -> Array:
    """How far the toes are bent up (T,): flat on the floor in push-off, straightening early in the swing."""
    left = np.maximum(-pitch, 0.0)
    return np.where(planted, left, left * (1 - np.clip(swung / 0.7, 0, 1)) ** 1.5)


def stance_ankle(sole: Sole, place: Array, yaw: Array, pitch: Array) -> Array:
    """World ankle (T, 3) of a foot planted at `place` (T, 2, the floor under the flat foot's ankle) with this yaw and pitch."""
    pivot_x = np.where(pitch > 0, sole.heel_m[0], sole.ball_m[0])
    pivot_z = np.where(pitch > 0, sole.heel_m[1], sole.ball_m[1])
    # where the ankle goes when the foot turns about the pivot by the pitch
    ahead = pivot_x - (np.cos(pitch) * pivot_x - np.sin(pitch) * pivot_z)
    xy = place + ahead[:, None] * np.stack([np.cos(yaw), np.sin(yaw)], axis=-1)
    return np.concatenate([xy, sole.ankle_height_m(pitch)[:, None]], axis=-1)


def hermite(swung: Array, start: Array, end: Array, start_rate: Array, end_rate: Array) -> Array:
    """Quintic (T, n) from start to end (T, n) with these rates per whole swing and no acceleration at either end."""
    s = swung[:, None]
    s3, s4, s5 = s**3, s**4, s**5
    return np.asarray(
        (1 - 10 * s3 + 15 * s4 - 6 * s5) * start
        + (s - 6 * s3 + 8 * s4 - 3 * s5) * start_rate
        + (10 * s3 - 15 * s4 + 6 * s5) * end
        + (-4 * s3 + 7 * s4 - 3 * s5) * end_rate
    )


def lift(swung: Array) -> Array:
    """The rise of the swinging ankle (T,) above the plain curve, 1 at its top, early in the swing."""
    return np.asarray(swung**2 * (1 - swung) ** 4 * 729 / 16)


def foot_axes(yaw: Array, pitch: Array) -> Array:
    """Axes (T, 3, 3) of a foot: X ahead along the sole, Y up from it, Z right."""
    turned = turn("z", yaw) @ turn("y", -pitch)
    return np.stack([turned[..., 0], turned[..., 2], -turned[..., 1]], axis=-1)
