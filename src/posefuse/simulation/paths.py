"""How things that are not people move: settings, and exact poses at any time."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Gt, MinLen
from pydantic import Field
from scipy.interpolate import CubicSpline

from posefuse.core import SE3, ConfigError
from posefuse.core.arrays import Array
from posefuse.core.se3 import wxyz_from_matrix
from posefuse.foundation.settings import settings

Point = tuple[float, float, float]
# incommensurate, so that the wave does not repeat within a session
_OVERTONES = np.array([1.0, 1.618, 2.414])


@settings
class StillPath:
    """Stays where it is.

    Attributes:
        position_m: of its centre. yaw_deg, pitch_deg, roll_deg: turned about its own z, then y, then x axis.
    """

    kind: Literal["still"]
    position_m: Point = (0.0, 0.0, 0.0)
    yaw_deg: float = 0.0
    pitch_deg: float = 0.0
    roll_deg: float = 0.0


@settings
class WavedPath:
    """Waved smoothly and irregularly through a box, turning all the while, as one calibrates cameras by hand.

    Attributes:
        centre_m, extent_m: the box its centre stays in.
        speed_mps: typical speed. turn_dps: typical rate of turn in degrees per second.
        seed: None takes the scene's.
    """

    kind: Literal["waved"]
    centre_m: Point = (0.0, 0.0, 1.1)
    extent_m: tuple[Annotated[float, Ge(0)], Annotated[float, Ge(0)], Annotated[float, Ge(0)]] = (2.0, 2.0, 1.2)
    speed_mps: Annotated[float, Ge(0)] = 0.6
    turn_dps: Annotated[float, Ge(0)] = 45.0
    seed: int | None = None


@settings
class WaypointPath:
    """Along a smooth curve through points, at a constant mean speed, there and back.

    Attributes:
        waypoints_m: at least two points. turn_dps: steady turn about the vertical.
    """

    kind: Literal["waypoints"]
    waypoints_m: Annotated[tuple[Point, ...], MinLen(2)]
    speed_mps: Annotated[float, Gt(0)] = 0.6
    turn_dps: float = 0.0


@settings
class CarriedPath:
    """Held by a person.

    Attributes:
        person: place in the scene's list of people, from 0. side: whose hand, the person's.
        beyond_wrist_m: distance of its centre from the wrist, along the forearm.
    """

    kind: Literal["carried"]
    person: Annotated[int, Ge(0)] = 0
    side: Literal["left", "right"] = "right"
    beyond_wrist_m: Annotated[float, Ge(0)] = 0.18


PathSettings = Annotated[StillPath | WavedPath | WaypointPath | CarriedPath, Field(discriminator="kind")]


def poses_on_path(path: StillPath | WavedPath | WaypointPath, t_s: Array, seed: int) -> SE3:
    """World poses (T,) at times (T,) in seconds since the start of the scene."""
    t_s = np.asarray(t_s, np.float64)
    if isinstance(path, StillPath):
        angles = np.broadcast_to(np.deg2rad([path.yaw_deg, path.pitch_deg, path.roll_deg]), (len(t_s), 3))
        return _turned(angles, np.broadcast_to(path.position_m, (len(t_s), 3)))
    if isinstance(path, WavedPath):
        return _waved(path, t_s, seed if path.seed is None else path.seed)
    return _along(path, t_s)


def _waved(path: WavedPath, t_s: Array, seed: int) -> SE3:
    rng = np.random.default_rng([seed, 11])
    half = np.array(path.extent_m) / 2
    # a sine of amplitude A and rate w has the mean speed 2 A w / pi; three axes and overtones share it
    rate_hz = path.speed_mps / max(4 * float(np.linalg.norm(half)), 1e-9)
    place = np.array(path.centre_m) + half * _waves(rng, rate_hz, t_s)
    # rolling on and on shows every side; a pitch near a right angle would make yaw and roll one
    turn = np.deg2rad(path.turn_dps) * t_s[:, None] * np.array([0.8, 0.0, 0.6])
    sway = np.array([0.6, 1.1, 0.6]) * _waves(rng, path.turn_dps / 360.0, t_s)
    return _turned(turn + sway, place)


def _waves(rng: np.random.Generator, rate_hz: float, t_s: Array) -> Array:
    """(T, 3) smooth irregular curves within [-1, 1]."""
    weight = rng.uniform(0.4, 1.0, (3, 3))
    weight = weight / weight.sum(axis=0)
    rates = rate_hz * _OVERTONES[:, None] * rng.uniform(0.8, 1.25, (3, 3))
    phase = rng.uniform(0, 2 * np.pi, (3, 3))
    waves = np.sin(2 * np.pi * rates * t_s[:, None, None] + phase)
    return np.asarray((weight * waves).sum(axis=1))


def _along(path: WaypointPath, t_s: Array) -> SE3:
    points = np.array(path.waypoints_m)
    lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
    if (lengths == 0).any():
        raise ConfigError("props: path.waypoints_m: two waypoints in a row are the same point")
    at_m = np.concatenate([[0.0], np.cumsum(lengths)])
    curve = CubicSpline(at_m, points, bc_type="clamped")
    travelled = np.mod(t_s * path.speed_mps, 2 * at_m[-1])
    place = curve(np.minimum(travelled, 2 * at_m[-1] - travelled))
    yaw = np.deg2rad(path.turn_dps) * t_s
    return _turned(np.stack([yaw, np.zeros_like(yaw), np.zeros_like(yaw)], axis=-1), place)


def _turned(yaw_pitch_roll: Array, xyz: Array) -> SE3:
    """Poses whose rotation is Rz(yaw) Ry(pitch) Rx(roll)."""
    zero = np.zeros(xyz.shape[:-1])
    yaw = SE3.from_rotvec(np.stack([zero, zero, yaw_pitch_roll[..., 0]], axis=-1), xyz)
    pitch = SE3.from_rotvec(np.stack([zero, yaw_pitch_roll[..., 1], zero], axis=-1), np.zeros_like(xyz))
    roll = SE3.from_rotvec(np.stack([yaw_pitch_roll[..., 2], zero, zero], axis=-1), np.zeros_like(xyz))
    return yaw @ pitch @ roll


def poses_in_hand(world_from_bone: Array, hand: int, bone_from_prop: SE3) -> SE3:
    """World poses (T,) of a thing fixed to bone number `hand` of (T, B, 4, 4) bone poses."""
    bone = world_from_bone[:, hand]
    return SE3(wxyz_from_matrix(bone[:, :3, :3]), bone[:, :3, 3]) @ SE3(
        np.broadcast_to(bone_from_prop.wxyz, (len(bone), 4)), np.broadcast_to(bone_from_prop.xyz, (len(bone), 3))
    )
