"""Motions on planted feet: at ease, squatting, sitting down, turning on the spot; one hand waving, reaching."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from posefuse.core.arrays import Array
from posefuse.core.skeleton import SIDES
from posefuse_sim.body import SimulatedBody, rotation_of
from posefuse_sim.body.anatomy import turn, unit_vectors

from .posture import EASY_PRONATION_RAD, BodyPosture, arm_axes, bend_arm, leg_axes, lengths_m
from .settings import StandSettings

AXES_LEVEL = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
_TOE_OUT_RAD = np.deg2rad(7.0)
_EASY_KNEE_RAD = np.deg2rad(4.0)
_SWAY_FORWARD_M, _SWAY_ASIDE_M = 0.005, 0.004
_BREATHS_HZ = 0.25
_ARM_ASIDE_RAD = np.deg2rad(9.0)
_EASY_ELBOW_RAD = np.deg2rad(16.0)
_HAND_PRONATION_RAD = np.deg2rad(110.0)
# sines of the small movements of a standing person
_PARTIALS = 6
_RAISED_RAD = np.deg2rad(165.0)
# of one period of sitting: standing, going down, seated, getting up
_DOWN_AT, _SEATED_AT, _UP_AT = 0.1, 0.38, 0.68
# seated thighs are level and shanks lean back a little; the trunk leans forward most halfway
_SEATED_KNEE_RAD, _SEATED_SHANK_RAD, _MOST_LEAN_RAD = np.deg2rad(93.0), np.deg2rad(4.0), np.deg2rad(42.0)
_STEPS_PER_TURN = 6
_LIFT_M, _BENT_M = 0.05, 0.02
_USUAL_PERIOD_S = {"reach": 3.0, "squat": 4.0, "wave": 0.9, "overhead": 3.0, "sit": 6.0, "turn": 6.0}
# the middle of the hip centres (T, 3), and the axes (T, 3, 3) of each segment
Stance = tuple[Array, dict[str, Array]]


def wander(rng: np.random.Generator, slowest_hz: float, fastest_hz: float, t_s: Array) -> Array:
    """(T,) a sum of sines of random phases with unit variance; rates spread evenly in logarithm between the two."""
    edges = np.linspace(np.log(slowest_hz), np.log(fastest_hz), _PARTIALS + 1)
    rate_hz, phase_rad = np.exp(rng.uniform(edges[:-1], edges[1:])), rng.uniform(0, 2 * np.pi, _PARTIALS)
    return np.asarray(np.sin(2 * np.pi * t_s[:, None] * rate_hz + phase_rad).sum(axis=1) / np.sqrt(_PARTIALS / 2))


def minimum_jerk(x: Array) -> Array:
    """0 before 0, 1 after 1, in between one smooth push of speed (Flash & Hogan 1985)."""
    x = np.clip(x, 0.0, 1.0)
    return np.asarray(x**3 * (10 - 15 * x + 6 * x**2))


def level_axes(heading_rad: Array) -> Array:
    """Axes (T, 3, 3) of an upright segment that faces a heading: X ahead, Y up, Z right."""
    return np.asarray(turn("z", heading_rad) @ AXES_LEVEL)


def leaned(axes: Array, forward_rad: Array, right_rad: Array | float = 0.0, left_turn_rad: Array | float = 0.0) -> Array:
    """Axes (T, 3, 3) bent forward, to the right, and turned to the left in their own frame (the trunk's ZXY)."""
    angles = np.stack(np.broadcast_arrays(forward_rad, right_rad, left_turn_rad), axis=-1)
    return axes @ rotation_of("trunk", angles)


@dataclass(frozen=True, eq=False, kw_only=True)
class Stander:
    """A body that stands on two feet, planted side by side, and what it does there."""

    body: SimulatedBody
    settings: StandSettings
    seed: int

    @property
    def period_s(self) -> float:
        """Of one repetition."""
        return self.settings.period_s or _USUAL_PERIOD_S[self.settings.kind]

    @property
    def heading_rad(self) -> float:
        """Where the person faces."""
        return float(np.deg2rad(self.settings.heading_deg))

    @property
    def ground(self) -> Array:
        """(3,) the floor point between the feet."""
        return np.array([*self.settings.position_m, 0.0])

    def base(self) -> Array:
        """(3, 3) level axes of the person."""
        return level_axes(np.array(self.heading_rad))

    def ankles(self) -> dict[str, Array]:
        """(3,) world position of each ankle."""
        points, base = self.body.points_rest, self.base()
        half = abs(points["left_hip"][1]) * 1.05
        return {
            side: np.array([*self.settings.position_m, points[f"{side}_ankle"][2]])
            + base[:, 2] * (half if side == "right" else -half)
            for side in SIDES
        }

    def feet(self) -> dict[str, Array]:
        """(3, 3) axes of each foot, toes a little out."""
        return {s: level_axes(np.array(self.heading_rad + (_TOE_OUT_RAD if s == "left" else -_TOE_OUT_RAD))) for s in SIDES}

    def hip_height_m(self) -> float:
        """Height of the hips above the floor with easy knees."""
        thigh, shank = lengths_m(self.body, "left", "leg")
        chain = np.sqrt(thigh**2 + shank**2 + 2 * thigh * shank * np.cos(_EASY_KNEE_RAD))
        aside = abs(self.body.points_rest["left_hip"][1]) * 0.05
        return float(np.sqrt(chain**2 - aside**2) + self.body.points_rest["left_ankle"][2])

    def legs(self, centre: Array, pelvis: Array) -> dict[str, Array]:
        """Axes of thighs, shanks and feet, each (T, 3, 3), for a pelvis at centre (T, 3) with axes (T, 3, 3)."""
        axes: dict[str, Array] = {}
        for side in SIDES:
            foot = np.broadcast_to(self.feet()[side], pelvis.shape)
            ankle = np.broadcast_to(self.ankles()[side], centre.shape)
            axes |= leg_axes(self.body, side, centre, pelvis, ankle, foot)
        return axes

    def bent(self, knee: Array, shin: Array) -> tuple[Array, Array, Array]:
        """Pelvis axes (T, 3, 3) and centre (T, 3) over flat feet, knees bent, and (T,) how far the hips are behind the ankles.

        Args:
            knee: (T,) flexion in rad. shin: (T,) how far the shanks lean forward, in rad.
        """
        thigh, shank = lengths_m(self.body, "left", "leg")
        back = thigh * np.sin(knee - shin) - shank * np.sin(shin)
        height = shank * np.cos(shin) + thigh * np.cos(knee - shin) + self.body.points_rest["left_ankle"][2]
        base = np.broadcast_to(self.base(), (len(knee), 3, 3))
        centre = self.ground - base[..., 0] * back[:, None]
        centre[:, 2] = np.minimum(height, self.hip_height_m())
        return base, centre, back


def easy_arm(
    body: SimulatedBody, side: str, thorax: Array, flexion: Array | float = 0.0, elbow: Array | float = _EASY_ELBOW_RAD
) -> dict[str, Array]:
    """Axes of a relaxed arm."""
    # Cardan ZXY angles against the thorax, mirrored on the left as at the hip
    angles = np.stack(np.broadcast_arrays(flexion, -_ARM_ASIDE_RAD, 0.15), axis=-1)
    return arm_axes(body, side, thorax @ rotation_of(f"{side}_hip", angles), elbow, EASY_PRONATION_RAD)


def straight_up(stander: Stander, count: int) -> Stance:
    """A person standing upright, arms at ease, at `count` times."""
    centre = np.tile([*stander.settings.position_m, stander.hip_height_m()], (count, 1))
    level = np.broadcast_to(stander.base(), (count, 3, 3))
    axes = {"pelvis": level, "thorax": level, "head": level} | stander.legs(centre, level)
    for side in SIDES:
        axes |= easy_arm(stander.body, side, level)
    return centre, axes


def standing_motion(body: SimulatedBody, settings: StandSettings, seed: int) -> Callable[[Array], BodyPosture]:
    """Postures at times (T,)."""
    stander = Stander(body=body, settings=settings, seed=seed)

    def posture(t_s: Array) -> BodyPosture:
        centre, axes = _STANCES[settings.kind](stander, t_s)
        return BodyPosture(centre, axes, np.zeros((len(t_s), 2)))

    return posture


def _tpose(stander: Stander, t_s: Array) -> Stance:
    """Arms exactly horizontal and straight, palms down."""
    centre, axes = straight_up(stander, len(t_s))
    for side in SIDES:
        axes |= _horizontal_arm(axes["thorax"], side)
    return centre, axes


def _horizontal_arm(thorax: Array, side: str) -> dict[str, Array]:
    # the elbow's hinge looks up when the palm looks down: turned in by a quarter from palm forward
    upper = thorax @ rotation_of(f"{side}_shoulder", np.deg2rad([0.0, 90.0, 0.0]))
    forearm = upper @ rotation_of(f"{side}_elbow", np.array([0.0, 0.0, np.pi / 2]))
    return {f"{side}_upper_arm": upper, f"{side}_forearm": forearm, f"{side}_hand": forearm}


def _idle(stander: Stander, t_s: Array) -> Stance:
    """Sway of a few millimetres, breathing, slow glances."""
    rng, size = np.random.default_rng(stander.seed), stander.settings.sway
    forward, aside, lean = (wander(rng, 0.05, 0.8, t_s) for _ in range(3))
    gaze, nod = wander(rng, 0.03, 0.25, t_s), wander(rng, 0.03, 0.2, t_s)
    base = np.broadcast_to(stander.base(), (len(t_s), 3, 3))
    ahead, aside = size * _SWAY_FORWARD_M * forward, size * _SWAY_ASIDE_M * aside
    centre = np.tile([*stander.settings.position_m, stander.hip_height_m() - 0.004], (len(t_s), 1))
    centre += base[..., 0] * ahead[:, None] + base[..., 2] * aside[:, None]
    pelvis = leaned(base, 0.01 * size * lean, aside * 0.8)
    breath = size * 0.012 * np.sin(2 * np.pi * _BREATHS_HZ * t_s)
    thorax = leaned(base, 0.012 * size * lean - breath, -aside)
    head = leaned(base, 0.05 * size * nod, 0.0, 0.22 * size * gaze)
    axes = {"pelvis": pelvis, "thorax": thorax, "head": head} | stander.legs(centre, pelvis)
    for side in SIDES:
        axes |= easy_arm(stander.body, side, thorax, 0.03 * size * wander(rng, 0.05, 0.5, t_s))
    return centre, axes


def _wave(stander: Stander, t_s: Array) -> Stance:
    """The upper arm out and up, the forearm to and fro."""
    side = stander.settings.side
    centre, axes = _idle(stander, t_s)
    swing = np.deg2rad(28.0) * np.sin(2 * np.pi * t_s / stander.period_s)
    # raised in the plane 25 degrees before the shoulders, forearm up: turned out by a quarter
    angles = np.deg2rad(25), np.deg2rad(85) + 0.1 * swing, -np.deg2rad(85)
    shoulder = np.stack(np.broadcast_arrays(*angles), axis=-1)
    upper = axes["thorax"] @ rotation_of(f"{side}_shoulder", shoulder)
    elbow = np.deg2rad(80.0) + swing
    return centre, axes | arm_axes(stander.body, side, upper, elbow, np.deg2rad(80.0))


def _squat(stander: Stander, t_s: Array) -> Stance:
    """Down and up on flat feet; the trunk leans so that the weight stays over them, the arms come forward."""
    deepest = np.deg2rad(stander.settings.knee_flexion_deg)
    down = 0.5 - 0.5 * np.cos(2 * np.pi * t_s / stander.period_s)
    knee = _EASY_KNEE_RAD + (deepest - _EASY_KNEE_RAD) * down
    shin = 0.28 * knee + _EASY_KNEE_RAD / 4 * (1 - down)
    base, centre, back = stander.bent(knee, shin)
    lean = np.arcsin(np.clip((back + 0.03 * down) / 0.42, -1, 0.85))
    pelvis, thorax = leaned(base, 0.6 * lean), leaned(base, lean)
    axes = {"pelvis": pelvis, "thorax": thorax, "head": leaned(base, 0.35 * lean)} | stander.legs(centre, pelvis)
    for side in SIDES:
        axes |= easy_arm(stander.body, side, thorax, lean * 0.9 + np.deg2rad(60) * down, _EASY_ELBOW_RAD * (1 - 0.5 * down))
    return centre, axes


def _overhead(stander: Stander, t_s: Array) -> Stance:
    """Both arms forward and up above the head, and down again."""
    up = 0.5 - 0.5 * np.cos(2 * np.pi * t_s / stander.period_s)
    centre, axes = straight_up(stander, len(t_s))
    for side in SIDES:
        axes |= easy_arm(stander.body, side, axes["thorax"], _RAISED_RAD * up, np.deg2rad(16.0) + np.deg2rad(14.0) * up)
    return centre, axes


def _sit(stander: Stander, t_s: Array) -> Stance:
    """Stands, sits down on something as high as the knee, rests, gets up; hands come to the thighs. There is no chair."""
    part = np.mod(t_s / stander.period_s, 1.0)
    down = minimum_jerk((part - _DOWN_AT) / (_SEATED_AT - _DOWN_AT)) - minimum_jerk((part - _UP_AT) / (1.0 - _UP_AT))
    lean = _MOST_LEAN_RAD * np.sin(np.pi * down) + np.deg2rad(4.0) * down
    base, centre, _ = stander.bent(_SEATED_KNEE_RAD * down, _SEATED_SHANK_RAD * down)
    pelvis, thorax = leaned(base, 0.6 * lean), leaned(base, lean)
    axes = {"pelvis": pelvis, "thorax": thorax, "head": leaned(base, 0.3 * lean)} | stander.legs(centre, pelvis)
    for side in SIDES:
        elbow = np.deg2rad(16.0) + np.deg2rad(50.0) * down
        axes |= easy_arm(stander.body, side, thorax, lean + np.deg2rad(25) * down, elbow)
    return centre, axes


def _turn(stander: Stander, t_s: Array) -> Stance:
    """Turns to the left on the spot, one foot after the other."""
    body, ground = stander.body, stander.ground
    ankles, feet = stander.ankles(), stander.feet()
    steps = _STEPS_PER_TURN * t_s / stander.period_s
    whole, part = np.floor(steps), steps - np.floor(steps)
    swing = {"left": np.clip(2 * part, 0, 1), "right": np.clip(2 * part - 1, 0, 1)}
    angle = {side: 2 * np.pi / _STEPS_PER_TURN * (whole + minimum_jerk(one)) for side, one in swing.items()}
    base = level_axes(stander.heading_rad + (angle["left"] + angle["right"]) / 2)
    centre = np.tile(ground + [0, 0, stander.hip_height_m() - _BENT_M], (len(t_s), 1))
    axes = {"pelvis": base, "thorax": base, "head": base}
    for side in SIDES:
        turned = turn("z", angle[side])
        ankle = ground + turned @ (ankles[side] - ground)
        ankle[:, 2] += _LIFT_M * np.sin(np.pi * swing[side]) ** 2
        axes |= leg_axes(body, side, centre, base, ankle, turned @ feet[side]) | easy_arm(body, side, base)
    return centre, axes


def _reach(stander: Stander, t_s: Array) -> Stance:
    """From the side of the thigh to a point, a short stop, and back; straight in space with one smooth push of speed."""
    side, seed = stander.settings.side, stander.seed
    centre, axes = _idle(stander, t_s)
    cycle = np.floor(t_s / stander.period_s)
    out = _there_and_back(t_s / stander.period_s - cycle)
    targets = {c: _target(seed, int(c), side) for c in np.unique(cycle)}
    target = np.stack([targets[c] for c in cycle])
    thorax = leaned(axes["thorax"], 0.12 * out, 0.0, (0.18 if side == "right" else -0.18) * out)
    axes = axes | {"thorax": thorax}
    for s in SIDES:
        axes |= easy_arm(stander.body, s, thorax)
    return centre, axes | _reaching_arm(stander.body, axes, side, out, target)


def _reaching_arm(body: SimulatedBody, axes: dict[str, Array], side: str, out: Array, target: Array) -> dict[str, Array]:
    """The arm between hanging (out 0) and the wrist at `target` (T, 3), in arm lengths from the shoulder in thorax axes."""
    thorax, upper, lower = axes["thorax"], axes[f"{side}_upper_arm"], axes[f"{side}_forearm"]
    lengths = lengths_m(body, side, "arm")
    hanging = -lengths[0] * upper[..., 1] - lengths[1] * lower[..., 1]
    there = (thorax @ target[..., None])[..., 0] * sum(lengths)
    ahead = thorax[..., 0] * (0.35 * sum(lengths) * np.sin(np.pi * out) ** 2)[:, None]
    wrist = hanging + out[:, None] * (there - hanging) + ahead * 0.5
    start = np.zeros_like(wrist)
    outward = thorax[..., 2] * (1.0 if side == "right" else -1.0)
    elbow_side = unit_vectors(-thorax[..., 1] * 0.9 + outward * 0.45 - thorax[..., 0] * (1.2 - out)[:, None])
    upper, _ = bend_arm(start, wrist, elbow_side, lengths)
    middle = -lengths[0] * upper[..., 1]
    bend = np.arccos(np.clip(np.sum(unit_vectors(wrist - middle) * unit_vectors(middle), axis=-1), -1, 1))
    pronation = EASY_PRONATION_RAD + (_HAND_PRONATION_RAD - EASY_PRONATION_RAD) * out
    return arm_axes(body, side, upper, bend, pronation)


def _target(seed: int, cycle: int, side: str) -> Array:
    """(3,) of one reach, in arm lengths from the shoulder in thorax axes: ahead, between waist and eyes."""
    rng = np.random.default_rng([seed, cycle & 0xFFFFFFFF])
    across = rng.uniform(-0.35, 0.4) * (1.0 if side == "right" else -1.0)
    direction = unit_vectors(np.array([1.0, rng.uniform(-0.45, 0.35), across]))
    return direction * rng.uniform(0.78, 0.93)


def _there_and_back(part: Array) -> Array:
    """0 -> 1 -> 0 over one period by two minimum-jerk moves (Flash & Hogan 1985) with a stop between and after."""
    go, stay, back = 0.35, 0.5, 0.85
    return minimum_jerk(part / go) - minimum_jerk((part - stay) / (back - stay))


_STANCES: dict[str, Callable[[Stander, Array], Stance]] = {
    "tpose": _tpose,
    "idle": _idle,
    "reach": _reach,
    "squat": _squat,
    "wave": _wave,
    "overhead": _overhead,
    "sit": _sit,
    "turn": _turn,
}
