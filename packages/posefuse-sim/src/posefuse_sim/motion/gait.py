"""Walking: footfalls planned along the route, the pelvis carried over them, the legs solved between the two.

Published magnitudes used: walk ratio, duty factor 0.62 at 1.35 m/s, pelvis: vertical 2 cm, sideways 2 cm, turn 4,
drop 4 degrees (Perry 1992; Winter 1991), foot rockers, swing knee flexion 60 degrees at 1.35 m/s.
Constants of one body (pelvis height that just lets the leg reach, lift of the foot that gives the swing knee flexion) are
solved once per speed on a straight way, see `tuned_gait`.

The cycle of a foot starts at its heel strike (part 0) and its stance ends at `duty`. In stance the heel's or the ball's
contact point is a fixed point of the floor (the three rockers of Perry 1992): the foot turns about the heel while the
toes come down, lies flat, then turns about the toe joints, the toes staying flat.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicHermiteSpline, PchipInterpolator
from scipy.ndimage import convolve1d, maximum_filter1d

from posefuse.core import ConfigError
from posefuse.core.arrays import Array
from posefuse.core.skeleton import SIDES
from posefuse_sim.body import SimulatedBody
from posefuse_sim.body.anatomy import turn

from .posture import BodyPosture, hip_offset, leg_axes, lengths_m
from .routes import Route, straight_on
from .standing import easy_arm, leaned, level_axes

_REFERENCE_MPS = 1.35
_MID_STANCE = 0.31
# the hip passes over the ankle at this part of the cycle
_OVER_ANKLE = 0.222
_STEP_WIDTH_HIPS = 0.5
_TOE_OUT_RAD = np.deg2rad(6.0)
_GRAVITY = 9.81
# v^2 / (g leg) at which people change from walking to running (Kram et al. 1997)
_RUNNING_FROUDE = 0.5
_BOB_M, _SWAY_M, _SURGE_M = 0.018, 0.021, 0.009
_TURN_RAD, _DROP_RAD, _COUNTER_RAD = np.deg2rad(4.0), np.deg2rad(4.5), np.deg2rad(4.0)
_LEAN_RAD, _ARM_SWING_RAD = np.deg2rad(3.0), np.deg2rad(17.0)
_STRAIGHTEST_KNEE_RAD = np.deg2rad(5.0)
_KNEE_SWING_DEG = ((0.2, 0.6, 1.0, 1.35, 2.2), (38.0, 52.0, 59.0, 62.0, 66.0))
_SIDE_LIFT_M, _FEET_APART_M, _SIDE_CROUCH_M = 0.07, 0.14, 0.03
_TUNED_MPS = 5
_TUNING_SAMPLES = 100
_TUNING_ROUNDS = 14
_GLANCE_AHEAD_M = 0.35
_CLEARANCE_M = 0.025
# parts of the lean into a curve that the legs and the pelvis take
_LEG_LEAN, _PELVIS_LEAN = 0.6, 0.15
_DIP_LAPS, _DIP_S, _DIP_STEP_S, _DIP_STEP_M, _DIP_REACH_M = 12, 120.0, 0.01, 0.05, 0.4


@dataclass(frozen=True, eq=False)
class Tuning:
    """Solved constants of a body over walking speed, and of its route over distance.

    Attributes:
        speed_mps: (n,). hips_m: (n,) mean height of the hip centres. lift_m: (n,) extra rise of the swinging ankle.
        dip_m: (d,) how much lower the hips go at equal distances over the lap, where turns make the legs reach further.
    """

    speed_mps: Array
    hips_m: Array
    lift_m: Array
    dip_m: Array


@dataclass(frozen=True, eq=False, kw_only=True)
class GaitMotion:
    """A walker on a route."""

    body: SimulatedBody
    route: Route
    pace: WalkPace
    sole: Sole
    duty: float
    tuning: Tuning

    def posture(self, t_s: Array) -> BodyPosture:
        """Body postures at times (T,)."""
        phase, size = self.pace.phase(t_s), self._size(t_s)
        pelvis, thorax, head = self._trunk(t_s, phase, size)
        steps = [self._foot(side, phase) for side in SIDES]
        centre = self._centre(t_s, phase, size)
        centre[:, 2] = np.minimum(centre[:, 2], self._highest(centre, pelvis, [ankle for ankle, *_ in steps]))
        axes = {"pelvis": pelvis, "thorax": thorax, "head": head}
        for side, (ankle, foot, _) in zip(SIDES, steps, strict=True):
            ahead = foot[..., 0] * [1, 1, 0] + pelvis[..., 0]
            axes |= leg_axes(self.body, side, centre, pelvis, ankle, foot, ahead=ahead)
            axes |= self._arm(side, thorax, phase, size)
        return BodyPosture(centre, axes, np.stack([toes for *_, toes in steps], axis=-1))

    def facing(self, distance_m: Array) -> Array:
        """Direction (T,) the person faces."""
        if self.route.facing_rad is None:
            return self.route.heading(distance_m)
        return np.full_like(distance_m, self.route.facing_rad)

    def speed_mps(self, t_s: Array) -> Array:
        """Speed (T,) over the floor."""
        step = 1e-3
        ends = [self.route.place(self.pace.distance_m(t_s + s)) for s in (-step, step)]
        return np.asarray(np.linalg.norm(ends[1] - ends[0], axis=-1) / (2 * step))

    def _size(self, t_s: Array) -> Array:
        """How large the movements are (T,): 0 standing, 1 at 1.35 m/s."""
        return np.minimum(self.speed_mps(t_s) / _REFERENCE_MPS, 1.4) ** 0.7

    @property
    def _ahead(self) -> float:
        """1 when walking the way one faces, 0 sideways."""
        return 1.0 if self.route.facing_rad is None else 0.0

    def _trunk(self, t_s: Array, phase: Array, size: Array) -> tuple[Array, Array, Array]:
        distance = self.pace.distance_m(t_s)
        cycle = 2 * np.pi * phase
        inward = self._ahead * self.route.curvature(distance) * self.pace.speed_mps(t_s) ** 2 / _GRAVITY
        base = level_axes(self.facing(distance))
        swing = self._ahead * size
        drop = _DROP_RAD * swing * np.cos(cycle - 2 * np.pi * 0.13)
        pelvis = leaned(
            base,
            np.deg2rad(1.2) * swing * np.cos(2 * cycle - 0.6),
            drop - _PELVIS_LEAN * inward,
            -_TURN_RAD * swing * np.cos(cycle),
        )
        thorax = leaned(base, _LEAN_RAD * swing, -0.35 * drop - 0.9 * inward, _COUNTER_RAD * swing * np.cos(cycle - 0.2))
        glance = level_axes(self.facing(distance + _GLANCE_AHEAD_M * np.minimum(size, 1)))
        return pelvis, thorax, leaned(glance, 0.02 + 0.012 * swing * np.cos(2 * cycle), -0.3 * inward)

    def _centre(self, t_s: Array, phase: Array, size: Array) -> Array:
        distance = self.pace.distance_m(t_s)
        base = level_axes(self.facing(distance))
        cycle = 2 * np.pi * phase
        swing = self._ahead * size
        surge = _SURGE_M * swing * np.sin(2 * cycle - 0.6)
        sway = -_SWAY_M * np.minimum(swing * 1.5, 1.0) * np.cos(cycle - 2 * np.pi * _MID_STANCE)
        centre = np.zeros((len(t_s), 3))
        centre[:, :2] = self.route.place(distance)
        centre += base[..., 0] * surge[:, None] + base[..., 2] * sway[:, None]
        centre[:, 2] = np.interp(self.speed_mps(t_s), self.tuning.speed_mps, self.tuning.hips_m) + self.bob(phase, size)
        centre[:, 2] -= self._dip_m(distance)
        return centre

    def _dip_m(self, distance_m: Array) -> Array:
        part = np.mod(distance_m, self.pace.lap_m) if self.route.loops else distance_m
        dip = np.append(self.tuning.dip_m, self.tuning.dip_m[:1])
        return np.asarray(np.interp(part, np.linspace(0.0, self.pace.lap_m, len(dip)), dip))

    def bob(self, phase: Array, size: Array) -> Array:
        """Rise and fall (T,) of the pelvis, lowest just after each heel strike, growing as the square of the step."""
        reach = self.body.points_rest["left_hip"][2] / 0.92
        return np.asarray(-_BOB_M * reach * (0.3 + 0.7 * self._ahead) * size**2 * np.cos(4 * np.pi * (phase - 0.025)))

    def _highest(self, centre: Array, pelvis: Array, ankles: list[Array]) -> Array:
        """Greatest height (T,) of the pelvis centre at which both legs reach their ankles."""
        limits = []
        for side, ankle in zip(SIDES, ankles, strict=True):
            thigh, shank = lengths_m(self.body, side, "leg")
            longest = np.sqrt(thigh**2 + shank**2 + 2 * thigh * shank * np.cos(_STRAIGHTEST_KNEE_RAD))
            offset = pelvis @ hip_offset(self.body, side)
            flat = np.sum((centre + offset - ankle)[:, :2] ** 2, axis=-1)
            limits.append(ankle[:, 2] + np.sqrt(np.maximum(longest**2 - flat, 0.01)) - offset[:, 2])
        return np.asarray(np.minimum(*limits))

    def _foothold(self, side: str, count: Array) -> tuple[Array, Array]:
        """Floor place (T, 2) and yaw (T,) of a side's stance number `count` (T,)."""
        middle = self.pace.time_s(count + (0.0 if side == "left" else 0.5) + _OVER_ANKLE)
        distance = self.pace.distance_m(middle)
        facing = self.facing(distance)
        out = 1.0 if side == "left" else -1.0
        aside = np.stack([-np.sin(facing), np.cos(facing)], axis=-1)
        hips_m = self.body.points_rest["left_hip"][2]
        outward = self._ahead * hips_m * self.route.curvature(distance) * self.pace.speed_mps(middle) ** 2 / _GRAVITY
        offset = out * self._half_width_m(middle) - _LEG_LEAN * outward
        return self.route.place(distance) + aside * offset[:, None], facing + out * _TOE_OUT_RAD

    def _half_width_m(self, t_s: Array) -> Array:
        """Half of the distance (T,) between the feet across the facing direction."""
        hips = abs(self.body.points_rest["left_hip"][1])
        narrow = hips * (1.0 - (1 - _STEP_WIDTH_HIPS) * np.minimum(self.speed_mps(t_s) / 0.8, 1.0))
        if self._ahead:
            return np.asarray(narrow)
        stride = self.pace.lap_m / self.pace.lap_cycles
        return np.full_like(t_s, _FEET_APART_M / 2 + stride / 4)

    def _planted(self, side: str, count: Array, part: Array) -> tuple[Array, Array, Array]:
        """Ankle (T, 3), yaw and pitch (T,) of a stance."""
        place, yaw = self._foothold(side, count)
        phase = count + part + (0.0 if side == "left" else 0.5)
        size = self._ahead * np.minimum(self._size(self.pace.time_s(phase)), 1.15)
        pitch = stance_pitch(part, self.duty, size)
        return stance_ankle(self.sole, place, yaw, pitch), yaw, pitch

    def _foot(self, side: str, phase: Array) -> tuple[Array, Array, Array]:
        """Ankle (T, 3), foot axes (T, 3, 3) and toes bent up (T,)."""
        own = phase - (0.0 if side == "left" else 0.5)
        count = np.floor(own)
        part = own - count
        planted = part < self.duty
        ankle, yaw, pitch = self._planted(side, count, np.minimum(part, self.duty))
        swung = np.clip((part - self.duty) / (1 - self.duty), 0.0, 1.0)
        air = self._swing(side, count, swung)
        ankle = np.where(planted[:, None], ankle, air[0])
        yaw, pitch = np.where(planted, yaw, air[1]), np.where(planted, pitch, air[2])
        return ankle, foot_axes(yaw, pitch), toes_up(pitch, planted, swung)

    def _swing(self, side: str, count: Array, swung: Array) -> tuple[Array, Array, Array]:
        """Ankle (T, 3), yaw and pitch (T,) between stance `count` and the next."""
        d = 1e-4
        span = 1 - self.duty
        end_of, start_of = np.full_like(swung, self.duty), np.zeros_like(swung)
        leave, yaw0, _ = self._planted(side, count, end_of)
        before, *_ = self._planted(side, count, end_of - d)
        land, yaw1, _ = self._planted(side, count + 1, start_of)
        after, *_ = self._planted(side, count + 1, start_of + d)
        ankle = hermite(swung, leave, land, (leave - before) / d * span, (after - land) / d * span)
        middle = self.pace.time_s(count + (0.0 if side == "left" else 0.5) + (1 + self.duty) / 2)
        speed = self.speed_mps(middle)
        ankle[:, 2] += np.interp(speed, self.tuning.speed_mps, self.tuning.lift_m) * lift(swung)
        blend = swung**2 * (3 - 2 * swung)
        phase = count + self.duty + swung * span + (0.0 if side == "left" else 0.5)
        size = self._ahead * np.minimum(self._size(self.pace.time_s(phase)), 1.15)
        return ankle, yaw0 + blend * (yaw1 - yaw0), swing_pitch(swung, self.duty, size)

    def _arm(self, side: str, thorax: Array, phase: Array, size: Array) -> Mapping[str, Array]:
        # the arm swings with the leg of the other side
        forth = np.cos(2 * np.pi * (phase - 0.03)) * (-1.0 if side == "left" else 1.0)
        swing = self._ahead * size
        elbow = np.deg2rad(18.0 + 8.0 * size + 9.0 * swing * np.clip(forth + 0.2, -0.6, 1.2))
        return easy_arm(self.body, side, thorax, np.deg2rad(-4.0) * swing + _ARM_SWING_RAD * swing * forth, elbow)


def walking(body: SimulatedBody, route: Route, speed_mps: float) -> GaitMotion:
    """A walker with everything solved for this body and this speed; raises ConfigError where people of this size run."""
    leg_m = body.points_rest["left_hip"][2]
    fastest = float(np.sqrt(_RUNNING_FROUDE * _GRAVITY * leg_m))
    if speed_mps > fastest:
        raise ConfigError(
            f"speed_mps: expected at most {fastest:.2f} m/s for a hip height of {leg_m:.2f} m (faster is running), "
            f"got {speed_mps}"
        )
    duty = float(np.clip(0.62 - 0.06 * (speed_mps - _REFERENCE_MPS), 0.57, 0.68))
    way = pace(route, speed_mps, leg_m)
    sole = sole_of(body)
    untuned = Tuning(np.zeros(1), np.full(1, leg_m), np.full(1, _SIDE_LIFT_M), np.zeros(1))
    gait = GaitMotion(body=body, route=route, pace=way, sole=sole, duty=duty, tuning=untuned)
    gait = replace(gait, tuning=tuned_gait(gait, speed_mps))
    return replace(gait, tuning=replace(gait.tuning, dip_m=_dips_m(gait)))


def tuned_gait(gait: GaitMotion, speed_mps: float) -> Tuning:
    """Pelvis height and foot lift at several speeds up to the asked one, each solved on a straight way."""
    speeds = np.linspace(0.0, speed_mps, _TUNED_MPS)
    pairs = [_tuned_at(gait, speed) for speed in speeds[1:]]
    pairs.insert(0, (_standing_hips_m(gait), 0.5 * pairs[0][1]))
    hips, lifts = np.array(pairs).T
    return Tuning(speeds, hips, lifts, np.zeros(1))


def _dips_m(gait: GaitMotion) -> Array:
    """How far the legs fall short over a lap at worst, with room before and after, smoothed: no sudden knee in a turn.

    Without it hips on circles jerk by 6000 m/s^3 in place of 40, and joints are accelerated by up to 85 m/s^2 in place of 24.
    """
    way = gait.pace
    laps = min(_DIP_LAPS, max(1, round(_DIP_S / way.lap_s))) if gait.route.loops else 1
    t_s = np.arange(0.0, laps * way.lap_s, _DIP_STEP_S)
    phase, size = way.phase(t_s), gait._size(t_s)
    pelvis, *_ = gait._trunk(t_s, phase, size)
    centre = gait._centre(t_s, phase, size)
    short = np.maximum(centre[:, 2] - gait._highest(centre, pelvis, [gait._foot(side, phase)[0] for side in SIDES]), 0.0)
    count = max(1, round(way.lap_m / _DIP_STEP_M))
    worst = np.zeros(count)
    np.maximum.at(worst, (np.mod(way.distance_m(t_s) / way.lap_m, 1.0) * count).astype(int) % count, short)
    reach = min(round(_DIP_REACH_M / _DIP_STEP_M), count // 2)
    mode = "wrap" if gait.route.loops else "nearest"
    window = np.hanning(2 * reach + 3)[1:-1]
    return np.asarray(convolve1d(maximum_filter1d(worst, 4 * reach + 1, mode=mode), window / window.sum(), mode=mode))


def _standing_hips_m(gait: GaitMotion) -> float:
    thigh, shank = lengths_m(gait.body, "left", "leg")
    chain = np.sqrt(thigh**2 + shank**2 + 2 * thigh * shank * np.cos(2 * _STRAIGHTEST_KNEE_RAD))
    return float(chain + gait.sole.ankle_height_m(np.zeros(1))[0])


def _tuned_at(gait: GaitMotion, speed_mps: float) -> tuple[float, float]:
    leg_m = gait.body.points_rest["left_hip"][2]
    route = replace(straight_on(), facing_rad=None if gait.route.facing_rad is None else np.pi / 2)
    lab = replace(gait, route=route, pace=pace(route, speed_mps, leg_m))
    t_s = np.linspace(0.0, 1.0 / (lab.pace.lap_cycles / lab.pace.lap_s), _TUNING_SAMPLES, endpoint=False)
    phase, size = lab.pace.phase(t_s), lab._size(t_s)
    pelvis, *_ = lab._trunk(t_s, phase, size)
    wanted = np.deg2rad(np.interp(speed_mps, *_KNEE_SWING_DEG))
    low, high = (_least_lift_m(lab) if gait._ahead else 0.0), 0.25
    for _ in range(_TUNING_ROUNDS):
        lift_m = (low + high) / 2 if gait._ahead else _SIDE_LIFT_M
        lab = replace(lab, tuning=Tuning(np.zeros(1), np.full(1, leg_m), np.full(1, lift_m), np.zeros(1)))
        ankles = [lab._foot(side, phase)[0] for side in SIDES]
        flat = lab._centre(t_s, phase, size)
        hips_m = float((lab._highest(flat, pelvis, ankles) - lab.bob(phase, size)).min())
        lab = replace(lab, tuning=Tuning(np.zeros(1), np.full(1, hips_m), np.full(1, lift_m), np.zeros(1)))
        axes = lab.posture(t_s).axes_world
        cosine = np.sum(axes["left_thigh"][..., 1] * axes["left_shank"][..., 1], axis=-1)
        low, high = (lift_m, high) if np.arccos(cosine.min()) < wanted else (low, lift_m)
    return (hips_m if gait._ahead else hips_m - _SIDE_CROUCH_M), lift_m


def _least_lift_m(lab: GaitMotion) -> float:
    """The lift that keeps the whole foot clear of the floor in mid-swing."""
    bare = replace(lab, tuning=Tuning(np.zeros(1), np.zeros(1), np.zeros(1), np.zeros(1)))
    # later the lift has no power over the foot, which comes down heel first
    swung = np.linspace(0.08, 0.7, 33)
    ankle, _, pitch = bare._swing("left", np.zeros_like(swung), swung)
    gap = ankle[:, 2] - lab.sole.ankle_height_m(pitch)
    return float(np.max(_CLEARANCE_M - gap / lift(swung)).clip(0.0))


_STEP_M = 0.005
_SPEED_UP_MPS2 = 0.8
_SIDE_MPS2 = 1.0
_SLOWEST_MPS = 0.35
# step length over cadence is nearly constant at all speeds: 0.0064 m per step/min for adults (Sekiya & Nagasaki 1998)
_WALK_RATIO_M_MIN = 0.0064
_WALK_RATIO_LEG_M = 0.92
_SLOWEST_CYCLES_HZ = 0.55
_FLOOR_POWER = 8
# sides take short quick steps: a stride of this part of the leg length at most
_SIDE_STRIDE_LEGS = 0.6
# both feet on the floor, weight between them
STANDING_PHASE = 0.56


def cycles_hz(speed_mps: Array, leg_m: float) -> Array:
    """Gait cycles (two steps) per second at a walking speed; scaled to the leg as a pendulum (walk ratio ~ leg^1.5)."""
    ratio = _WALK_RATIO_M_MIN * (leg_m / _WALK_RATIO_LEG_M) ** 1.5
    brisk = np.asarray(speed_mps, np.float64) / (2 * np.sqrt(ratio * 60.0 * np.maximum(speed_mps, 1e-6)))
    return np.asarray((brisk**_FLOOR_POWER + _SLOWEST_CYCLES_HZ**_FLOOR_POWER) ** (1 / _FLOOR_POWER))


@dataclass(frozen=True, eq=False, kw_only=True)
class WalkPace:
    """Distance and gait phase over time.

    Phase counts gait cycles: the left heel strikes at whole numbers, the right at halves.

    Attributes:
        lap_s, lap_m, lap_cycles: of one lap, or to the end.
        loops: as the route.
    """

    lap_s: float
    lap_m: float
    lap_cycles: float
    loops: bool
    _distance: PchipInterpolator
    _phase: PchipInterpolator
    _time: PchipInterpolator
    _first_phase: float

    def distance_m(self, t_s: Array) -> Array:
        """Distance walked (T,)."""
        laps, t_s = self._lap(t_s, self.lap_s)
        return np.asarray(laps * self.lap_m + self._distance(t_s))

    def speed_mps(self, t_s: Array) -> Array:
        """Rate of `distance_m` (T,); 0 before the start and after the end."""
        _, within = self._lap(t_s, self.lap_s)
        moving = np.ones_like(within) if self.loops else (t_s > 0) & (t_s < self.lap_s)
        return np.asarray(self._distance(within, 1) * moving)

    def phase(self, t_s: Array) -> Array:
        """Gait cycles (T,) since the left heel strike before time 0."""
        laps, t_s = self._lap(t_s, self.lap_s)
        return np.asarray(self._first_phase + laps * self.lap_cycles + self._phase(t_s))

    def time_s(self, phase: Array) -> Array:
        """Inverse of `phase`."""
        laps, cycles = self._lap(phase - self._first_phase, self.lap_cycles)
        return np.asarray(laps * self.lap_s + self._time(cycles))

    def _lap(self, value: Array, lap: float) -> tuple[Array, Array]:
        if not self.loops:
            return np.zeros_like(value), np.clip(value, 0.0, lap)
        laps = np.floor(value / lap)
        return laps, value - laps * lap


def pace(route: Route, speed_mps: float, leg_m: float) -> WalkPace:
    """The speed asked for, slower in narrow turns and at ends, and the cadence that goes with it."""
    count = max(2, int(np.ceil(route.length_m / _STEP_M)))
    u = np.linspace(0.0, route.length_m, count + 1)
    v = _speed_along(route, u, speed_mps)
    t = np.concatenate([[0.0], np.cumsum(np.diff(u) * 2 / (v[1:] + v[:-1]))])
    hz = cycles_hz(v, leg_m)
    if route.facing_rad is not None:
        hz = np.maximum(hz, v / (_SIDE_STRIDE_LEGS * leg_m))
    phase = np.concatenate([[0.0], np.cumsum(np.diff(t) * (hz[1:] + hz[:-1]) / 2)])
    if not route.loops:
        u, t, phase = _closed_stance(u, t, phase, hz[-1])
    return WalkPace(
        lap_s=float(t[-1]),
        lap_m=float(u[-1]),
        lap_cycles=float(phase[-1]),
        loops=route.loops,
        _distance=PchipInterpolator(t, u),
        _phase=PchipInterpolator(t, phase),
        _time=PchipInterpolator(phase, t),
        _first_phase=0.0 if route.loops else STANDING_PHASE,
    )


def _closed_stance(u: Array, t: Array, phase: Array, hz: float) -> tuple[Array, Array, Array]:
    """Step on the spot after the arrival until both feet stand where the way ends."""
    # a foot is put where the walker is a quarter cycle after this phase or before it
    last = np.ceil((phase[-1] + 0.25) * 2) / 2
    more = np.linspace(0.0, last - phase[-1], 50)[1:]
    return np.append(u, np.full(49, u[-1])), np.append(t, t[-1] + more / hz), np.append(phase, phase[-1] + more)


def _speed_along(route: Route, u: Array, speed_mps: float) -> Array:
    limit = np.full_like(u, speed_mps)
    bend = np.abs(route.curvature(u))
    if np.ptp(bend) > 1e-6:
        limit = np.minimum(limit, np.sqrt(_SIDE_MPS2 / np.maximum(bend, 1e-9)))
    for end in route.ends_m:
        gap = np.abs(u - end)
        gap = np.minimum(gap, route.length_m - gap) if route.loops else gap
        limit = np.minimum(limit, np.sqrt(_SLOWEST_MPS**2 + 2 * _SPEED_UP_MPS2 * gap))
    return np.sqrt(_within_acceleration(limit**2, 2 * _SPEED_UP_MPS2 * (u[1] - u[0]), route.loops))


def _within_acceleration(squared: Array, rise: float, loops: bool) -> Array:
    """The largest squared speeds below `squared` that change by at most `rise` from sample to sample, both ways."""
    line = np.concatenate([squared[:-1]] * 3) if loops else squared
    ramp = rise * np.arange(len(line))
    ahead = np.minimum.accumulate(line - ramp) + ramp
    both = np.minimum.accumulate((ahead + ramp)[::-1])[::-1] - ramp
    if not loops:
        return np.asarray(both)
    count = len(squared) - 1
    return np.append(both[count : 2 * count], both[2 * count])


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
