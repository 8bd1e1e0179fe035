"""Motions of every day: both arms overhead, sitting down and getting up, turning on the spot."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from posefuse.core.arrays import Array
from posefuse.simulation.body import SimulatedBody
from posefuse.simulation.body.angles import turn

from .limbs import bend_leg, lengths_m
from .posture import BodyPosture
from .settings import OverheadSettings, SitSettings, TurnSettings
from .standing import SIDES, Footing, easy_arm, hip_offset, leaned, level_axes, minimum_jerk, straight_up

_RAISED_RAD = np.deg2rad(165.0)
# of one period of sitting: standing, going down, seated, getting up
_DOWN_AT, _SEATED_AT, _UP_AT = 0.1, 0.38, 0.68
# seated thighs are level and shanks lean back a little; the trunk leans forward most halfway
_SEATED_KNEE_RAD, _SEATED_SHANK_RAD, _MOST_LEAN_RAD = np.deg2rad(93.0), np.deg2rad(4.0), np.deg2rad(42.0)
_STEPS_PER_TURN = 6
_LIFT_M, _BENT_M = 0.05, 0.02


def overhead(body: SimulatedBody, settings: OverheadSettings) -> Callable[[Array], BodyPosture]:
    """Both arms forward and up above the head, and down again."""
    footing = Footing(body, np.deg2rad(settings.heading_deg), np.array(settings.position_m))

    def posture(t_s: Array) -> BodyPosture:
        up = 0.5 - 0.5 * np.cos(2 * np.pi * t_s / settings.period_s)
        centre, axes = straight_up(footing, len(t_s))
        for side in SIDES:
            axes |= easy_arm(body, side, axes["thorax"], _RAISED_RAD * up, np.deg2rad(16.0) + np.deg2rad(14.0) * up)
        return BodyPosture(centre, axes, np.zeros((len(t_s), 2)))

    return posture


def sit(body: SimulatedBody, settings: SitSettings) -> Callable[[Array], BodyPosture]:
    """Stands, sits down on something as high as the knee, rests, gets up; hands come to the thighs. There is no chair."""
    footing = Footing(body, np.deg2rad(settings.heading_deg), np.array(settings.position_m))

    def posture(t_s: Array) -> BodyPosture:
        part = np.mod(t_s / settings.period_s, 1.0)
        down = minimum_jerk((part - _DOWN_AT) / (_SEATED_AT - _DOWN_AT)) - minimum_jerk((part - _UP_AT) / (1.0 - _UP_AT))
        knee, shin = _SEATED_KNEE_RAD * down, _SEATED_SHANK_RAD * down
        lean = _MOST_LEAN_RAD * np.sin(np.pi * down) + np.deg2rad(4.0) * down
        base, centre, _ = footing.bent(knee, shin)
        pelvis, thorax = leaned(base, 0.6 * lean), leaned(base, lean)
        axes = {"pelvis": pelvis, "thorax": thorax, "head": leaned(base, 0.3 * lean)} | footing.legs(centre, pelvis)
        for side in SIDES:
            axes |= easy_arm(body, side, thorax, lean + np.deg2rad(25) * down, np.deg2rad(16.0) + np.deg2rad(50.0) * down)
        return BodyPosture(centre, axes, np.zeros((len(t_s), 2)))

    return posture


def turning(body: SimulatedBody, settings: TurnSettings) -> Callable[[Array], BodyPosture]:
    """Turns to the left on the spot, one foot after the other."""
    footing = Footing(body, np.deg2rad(settings.heading_deg), np.array(settings.position_m))
    ankles, feet = footing.ankles(), footing.feet()
    lengths = {side: lengths_m(body, side, "leg") for side in SIDES}
    ground = np.array([*settings.position_m, 0.0])

    def posture(t_s: Array) -> BodyPosture:
        steps = _STEPS_PER_TURN * t_s / settings.period_s
        whole, part = np.floor(steps), steps - np.floor(steps)
        swing = {"left": np.clip(2 * part, 0, 1), "right": np.clip(2 * part - 1, 0, 1)}
        angle = {side: 2 * np.pi / _STEPS_PER_TURN * (whole + minimum_jerk(one)) for side, one in swing.items()}
        base = level_axes(footing.heading_rad + (angle["left"] + angle["right"]) / 2)
        centre = np.tile(ground + [0, 0, footing.hip_height_m() - _BENT_M], (len(t_s), 1))
        axes = {"pelvis": base, "thorax": base, "head": base}
        for side in SIDES:
            turned = turn("z", angle[side])
            ankle = ground + turned @ (ankles[side] - ground)
            ankle[:, 2] += _LIFT_M * np.sin(np.pi * swing[side]) ** 2
            foot = turned @ feet[side]
            hip = centre + base @ hip_offset(body, side)
            thigh_axes, shank_axes = bend_leg(hip, ankle, foot[..., 0], lengths[side])
            axes |= {f"{side}_thigh": thigh_axes, f"{side}_shank": shank_axes, f"{side}_foot": foot}
            axes |= easy_arm(body, side, base)
        return BodyPosture(centre, axes, np.zeros((len(t_s), 2)))

    return posture
