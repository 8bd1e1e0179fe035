"""People who walk about in ways of their own, as cameras with lasting and with random errors of a 2D network see them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from posefuse.calibration.clocks.person_tracks import PersonTrack
from posefuse.calibration.person.scale import STATURE_SHARES
from posefuse.core import SKELETONS, Rig
from posefuse.core.arrays import Array

BODY = SKELETONS["coco17"]
RATE_HZ, _SPARE_S = 12.0, 8
# of a keypoint: seconds after which its lasting error is another one
_LASTS_S = 1.0


@dataclass(frozen=True)
class Gait:
    """How a person walks.

    Attributes:
        seed: of the way over the floor. stature_m: height. cadence_rad_s, swing: of the limbs. speed_m_s, reach_m: of the way.
    """

    seed: int
    stature_m: float = 1.75
    cadence_rad_s: float = 5.5
    swing: float = 1.0
    speed_m_s: float = 1.0
    reach_m: float = 1.4


def gait_of(seed: int) -> Gait:
    """A gait that differs from seed to seed."""
    random = np.random.default_rng([seed, 21])
    return Gait(
        seed, 1.75, random.uniform(4.8, 6.4), random.uniform(0.8, 1.2), random.uniform(0.7, 1.2), random.uniform(1.1, 1.6)
    )


def walk(t_s: Array, gait: Gait) -> Array:
    """(T, 17, 3) keypoints in m."""
    way = _way(gait, float(np.max(t_s)))
    velocity = way(t_s, 1)
    heading, step = np.arctan2(velocity[:, 1], velocity[:, 0]), gait.swing * np.sin(gait.cadence_rad_s * t_s)
    return walking_body(np.column_stack([way(t_s), 0 * t_s]), heading, step, gait.stature_m)


def walking_body(place: Array, heading: Array, step: Array, stature_m: float) -> Array:
    """(T, 17, 3) keypoints in m of a person at places (T, 3) who faces headings (T,); step: (T,) of the left leg, -1 to 1."""
    ahead, aside = (np.stack([np.cos(h), np.sin(h), 0 * h], axis=-1) for h in (heading, heading + np.pi / 2))
    up, size = np.array([0, 0, 1.0]), stature_m / 1.75

    def at(forward: float, left: float, height: float) -> Array:
        return place + size * (forward * ahead + left * aside + height * up)

    def limb(name: str, swing: Array) -> Array:
        return np.asarray(STATURE_SHARES[name] * stature_m * (np.sin(swing)[:, None] * ahead - np.cos(swing)[:, None] * up))

    points = {"nose": at(0.1, 0, 1.62)}
    for side, sign in (("left", 1.0), ("right", -1.0)):
        mine = sign * step
        points |= {f"{side}_eye": at(0.09, sign * 0.03, 1.66), f"{side}_ear": at(0, sign * 0.07, 1.63)}
        points |= {f"{side}_shoulder": at(0, sign * 0.19, 1.42), f"{side}_hip": at(0, sign * 0.14, 0.91)}
        points[f"{side}_elbow"] = points[f"{side}_shoulder"] + limb("upper_arm", -0.5 * mine)
        points[f"{side}_wrist"] = points[f"{side}_elbow"] + limb("forearm", -0.5 * mine + 0.4)
        points[f"{side}_knee"] = points[f"{side}_hip"] + limb("thigh", 0.45 * mine + 0.1)
        points[f"{side}_ankle"] = points[f"{side}_knee"] + limb("shank", 0.45 * mine - 0.1 - 0.4 * np.maximum(mine, 0))
    return np.stack([points[name] for name in BODY.keypoints], axis=1)


def _way(gait: Gait, until_s: float) -> CubicSpline:
    """Where the person is, in m by s: turning at random, back to the middle at the edge."""
    random, count = np.random.default_rng([gait.seed, 77]), int(until_s) + 2 * _SPARE_S
    here, heading, places = np.zeros(2), random.uniform(0, 2 * np.pi), []
    for _ in range(count):
        heading += random.normal(0, 0.9)
        step = gait.speed_m_s * random.uniform(0.7, 1.3)
        if np.abs(here + step * np.array([np.cos(heading), np.sin(heading)])).max() > gait.reach_m:
            heading = np.arctan2(-here[1], -here[0])
        here = here + step * np.array([np.cos(heading), np.sin(heading)])
        places.append(here)
    return CubicSpline(np.arange(count) - float(_SPARE_S), places)


def watch(
    rig: Rig, gait: Gait, seconds: float, *, late_s: tuple[float, ...] = (), noise_px: float = 1.5, seed: int = 0,
    rate_hz: float = RATE_HZ,
) -> list[PersonTrack]:  # fmt: skip
    """The walker in every camera, whose stamps are late by `late_s`; as much lasting error as noise."""
    out, stamps = [], np.arange(round(seconds * rate_hz)) / rate_hz
    for c, camera in enumerate(rig):
        random, taken = np.random.default_rng([seed, c, 3]), stamps - (late_s[c] if late_s else 0.0)
        xy = camera.project(walk(taken, gait))
        knots = np.arange(taken[0] - 5, taken[-1] + 5, _LASTS_S)
        lasting = CubicSpline(knots, random.normal(0, noise_px, (len(knots), *xy.shape[1:])))(taken)
        xy = xy + random.normal(0, noise_px, xy.shape) + lasting
        inside = ((xy > 0) & (xy < np.array(camera.size_wh))).all(axis=-1)
        score, sigma = np.where(inside, 0.9, 0.0), np.where(inside, noise_px, np.nan)
        out.append(PersonTrack(camera.name, BODY, np.round(stamps * 1e9), np.where(inside[..., None], xy, np.nan), score, sigma))
    return out
