"""Motions on planted feet: T-pose, idle, squat, wave; `arms` has those that move one hand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from posefuse.core.arrays import Array
from posefuse.simulation.body import SEGMENTS, SimulatedBody, rotation_of
from posefuse.simulation.body.angles import turn

from .limbs import bend_leg, elevated_arm, forearm_and_hand, lengths_m
from .noise import Wander
from .posture import BodyPosture
from .settings import IdleSettings, SquatSettings, TPoseSettings, WaveSettings

SIDES = ("left", "right")
AXES_LEVEL = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
_TOE_OUT_RAD = np.deg2rad(7.0)
_EASY_KNEE_RAD = np.deg2rad(4.0)
_SWAY_FORWARD_M, _SWAY_ASIDE_M = 0.005, 0.004
_BREATHS_HZ = 0.25
_ARM_ASIDE_RAD = np.deg2rad(9.0)
_EASY_ELBOW_RAD = np.deg2rad(16.0)
EASY_PRONATION_RAD = np.deg2rad(85.0)


def level_axes(heading_rad: Array) -> Array:
    """Axes (T, 3, 3) of an upright segment that faces a heading: X ahead, Y up, Z right."""
    return np.asarray(turn("z", heading_rad) @ AXES_LEVEL)


def leaned(axes: Array, forward_rad: Array, right_rad: Array | float = 0.0, left_turn_rad: Array | float = 0.0) -> Array:
    """Axes (T, 3, 3) bent forward, to the right, and turned to the left in their own frame (the trunk's ZXY)."""
    angles = np.stack(np.broadcast_arrays(forward_rad, right_rad, left_turn_rad), axis=-1)
    return axes @ rotation_of("trunk", angles)


@dataclass(frozen=True, eq=False)
class Footing:
    """Two feet planted side by side.

    Attributes:
        body: whose. heading_rad: where the person faces. place: (2,) floor point between the feet.
    """

    body: SimulatedBody
    heading_rad: float
    place: Array

    def base(self) -> Array:
        """(3, 3) level axes of the person."""
        return level_axes(np.array(self.heading_rad))

    def ankles(self) -> dict[str, Array]:
        """(3,) world position of each ankle."""
        points, base = self.body.points_rest, self.base()
        half = abs(points["left_hip"][1]) * 1.05
        return {
            side: np.array([*self.place, points[f"{side}_ankle"][2]]) + base[:, 2] * (half if side == "right" else -half)
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
            hip = centre + pelvis @ self.hip_offset(side)
            foot = np.broadcast_to(self.feet()[side], pelvis.shape)
            ankle = np.broadcast_to(self.ankles()[side], centre.shape)
            thigh, shank = bend_leg(hip, ankle, foot[..., 0], lengths_m(self.body, side, "leg"))
            axes |= {f"{side}_thigh": thigh, f"{side}_shank": shank, f"{side}_foot": foot}
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
        centre = np.array([*self.place, 0.0]) - base[..., 0] * back[:, None]
        centre[:, 2] = np.minimum(height, self.hip_height_m())
        return base, centre, back

    def hip_offset(self, side: str) -> Array:
        """(3,) hip centre in pelvis axes, from the middle of both."""
        return hip_offset(self.body, side)


def hip_offset(body: SimulatedBody, side: str) -> Array:
    """(3,) hip centre in pelvis axes, from the middle of both hip centres."""
    pelvis = body.segment_axes[SEGMENTS.index("pelvis")]
    middle = (body.points_rest["left_hip"] + body.points_rest["right_hip"]) / 2
    return np.asarray(pelvis.T @ (body.points_rest[f"{side}_hip"] - middle))


def easy_arm(
    body: SimulatedBody, side: str, thorax: Array, flexion: Array | float = 0.0, elbow: Array | float = _EASY_ELBOW_RAD
) -> dict[str, Array]:
    """Axes of a relaxed arm."""
    count = thorax.shape[:-2]
    flexion = np.broadcast_to(np.asarray(flexion, np.float64), count)
    upper = elevated_arm(thorax, side, flexion, np.full(count, -_ARM_ASIDE_RAD), np.full(count, 0.15))
    lower, hand = forearm_and_hand(body, side, upper, elbow, np.full(count, EASY_PRONATION_RAD))
    return {f"{side}_upper_arm": upper, f"{side}_forearm": lower, f"{side}_hand": hand}


def straight_up(footing: Footing, count: int) -> tuple[Array, dict[str, Array]]:
    """Pelvis centre (T, 3) and the axes of a person standing upright, arms at ease."""
    centre = np.tile([*footing.place, footing.hip_height_m()], (count, 1))
    level = np.broadcast_to(footing.base(), (count, 3, 3))
    axes = {"pelvis": level, "thorax": level, "head": level} | footing.legs(centre, level)
    for side in SIDES:
        axes |= easy_arm(footing.body, side, level)
    return centre, axes


def tpose(body: SimulatedBody, settings: TPoseSettings) -> Callable[[Array], BodyPosture]:
    """Arms exactly horizontal and straight, palms down."""
    footing = Footing(body, np.deg2rad(settings.heading_deg), np.array(settings.position_m))

    def posture(t_s: Array) -> BodyPosture:
        centre, axes = straight_up(footing, len(t_s))
        for side in SIDES:
            axes |= _horizontal_arm(axes["thorax"], side)
        return BodyPosture(centre, axes, np.zeros((len(t_s), 2)))

    return posture


def _horizontal_arm(thorax: Array, side: str) -> dict[str, Array]:
    arm = thorax @ rotation_of(f"{side}_shoulder", np.deg2rad([0.0, 90.0, 0.0]))
    # the elbow's hinge looks up when the palm looks down: turned in by a quarter from palm forward
    upper = arm @ rotation_of(f"{side}_hip", np.array([0.0, 0.0, 0.0]))
    forearm = upper @ rotation_of(f"{side}_elbow", np.array([0.0, 0.0, np.pi / 2]))
    return {f"{side}_upper_arm": upper, f"{side}_forearm": forearm, f"{side}_hand": forearm}


def idle(body: SimulatedBody, settings: IdleSettings, seed: int) -> Callable[[Array], BodyPosture]:
    """Sway of a few millimetres, breathing, slow glances."""
    footing = Footing(body, np.deg2rad(settings.heading_deg), np.array(settings.position_m))
    sway = Ease(np.random.default_rng(seed), settings.sway)

    def posture(t_s: Array) -> BodyPosture:
        centre, axes = sway.applied(footing, t_s)
        return BodyPosture(centre, axes, np.zeros((len(t_s), 2)))

    return posture


class Ease:
    """The small movements of a standing person."""

    def __init__(self, rng: np.random.Generator, size: float) -> None:
        self._size = size
        self._forward, self._aside, self._lean = (Wander.drawn(rng, 0.05, 0.8) for _ in range(3))
        self._gaze, self._nod = Wander.drawn(rng, 0.03, 0.25), Wander.drawn(rng, 0.03, 0.2)
        self._arms = [Wander.drawn(rng, 0.05, 0.5) for _ in SIDES]

    def applied(self, footing: Footing, t_s: Array) -> tuple[Array, dict[str, Array]]:
        """Pelvis centre (T, 3) and all axes."""
        base = np.broadcast_to(footing.base(), (len(t_s), 3, 3))
        size = self._size
        ahead, aside = size * _SWAY_FORWARD_M * self._forward.at(t_s), size * _SWAY_ASIDE_M * self._aside.at(t_s)
        centre = np.tile([*footing.place, footing.hip_height_m() - 0.004], (len(t_s), 1))
        centre += base[..., 0] * ahead[:, None] + base[..., 2] * aside[:, None]
        pelvis = leaned(base, 0.01 * size * self._lean.at(t_s), aside * 0.8)
        breath = size * 0.012 * np.sin(2 * np.pi * _BREATHS_HZ * t_s)
        thorax = leaned(base, 0.012 * size * self._lean.at(t_s) - breath, -aside)
        head = leaned(base, 0.05 * size * self._nod.at(t_s), 0.0, 0.22 * size * self._gaze.at(t_s))
        axes = {"pelvis": pelvis, "thorax": thorax, "head": head} | footing.legs(centre, pelvis)
        for side, wander in zip(SIDES, self._arms, strict=True):
            axes |= easy_arm(footing.body, side, thorax, 0.03 * size * wander.at(t_s))
        return centre, axes


def wave(body: SimulatedBody, settings: WaveSettings, seed: int) -> Callable[[Array], BodyPosture]:
    """The upper arm out and up, the forearm to and fro."""
    footing = Footing(body, np.deg2rad(settings.heading_deg), np.array(settings.position_m))
    sway = Ease(np.random.default_rng(seed), 1.0)
    side = settings.side

    def posture(t_s: Array) -> BodyPosture:
        centre, axes = sway.applied(footing, t_s)
        swing = np.deg2rad(28.0) * np.sin(2 * np.pi * t_s / settings.period_s)
        still = np.zeros_like(swing)
        # raised in the plane 25 degrees before the shoulders, forearm up: turned out by a quarter
        shoulder = np.stack([still + np.deg2rad(25), still + np.deg2rad(85) + 0.1 * swing, still - np.deg2rad(85)], axis=-1)
        upper = axes["thorax"] @ rotation_of(f"{side}_shoulder", shoulder)
        elbow = np.deg2rad(80.0) + swing
        forearm, hand = forearm_and_hand(body, side, upper, elbow, still + np.deg2rad(80))
        axes |= {f"{side}_upper_arm": upper, f"{side}_forearm": forearm, f"{side}_hand": hand}
        return BodyPosture(centre, axes, np.zeros((len(t_s), 2)))

    return posture


def squat(body: SimulatedBody, settings: SquatSettings) -> Callable[[Array], BodyPosture]:
    """Down and up on flat feet; the trunk leans so that the weight stays over them, the arms come forward."""
    footing = Footing(body, np.deg2rad(settings.heading_deg), np.array(settings.position_m))
    deepest = np.deg2rad(settings.knee_flexion_deg)

    def posture(t_s: Array) -> BodyPosture:
        down = 0.5 - 0.5 * np.cos(2 * np.pi * t_s / settings.period_s)
        knee = _EASY_KNEE_RAD + (deepest - _EASY_KNEE_RAD) * down
        shin = 0.28 * knee + _EASY_KNEE_RAD / 4 * (1 - down)
        base, centre, back = footing.bent(knee, shin)
        lean = np.arcsin(np.clip((back + 0.03 * down) / 0.42, -1, 0.85))
        pelvis, thorax = leaned(base, 0.6 * lean), leaned(base, lean)
        axes = {"pelvis": pelvis, "thorax": thorax, "head": leaned(base, 0.35 * lean)} | footing.legs(centre, pelvis)
        for side in SIDES:
            axes |= easy_arm(body, side, thorax, lean * 0.9 + np.deg2rad(60) * down, _EASY_ELBOW_RAD * (1 - 0.5 * down))
        return BodyPosture(centre, axes, np.zeros((len(t_s), 2)))

    return posture


def minimum_jerk(x: Array) -> Array:
    """0 before 0, 1 after 1, in between one smooth push of speed (Flash & Hogan 1985)."""
    x = np.clip(x, 0.0, 1.0)
    return np.asarray(x**3 * (10 - 15 * x + 6 * x**2))
