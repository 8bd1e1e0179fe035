"""A walking person as keypoints, with the exact truth: calibration from a person tried without images."""

from __future__ import annotations

import numpy as np

from posefuse.calibration.person.scale import STATURE_SHARES
from posefuse.calibration.person.views import PersonViews
from posefuse.core import SKELETONS, Rig
from posefuse.core.arrays import Array

BODY, STATURE_M = SKELETONS["coco17"], 1.75


def walker(t_s: Array, middle_m: tuple[float, float] = (0.0, 0.0), lap_rad_s: float = 0.9) -> Array:
    """(T, 17, 3) keypoints in m, at times t_s (T,), of a person of ordinary build who walks round an ellipse."""
    angle = lap_rad_s * t_s
    place = np.stack([1.3 * np.cos(angle) + middle_m[0], 0.8 * np.sin(angle) + middle_m[1], 0 * angle], axis=-1)
    heading = np.arctan2(0.8 * np.cos(angle), -1.3 * np.sin(angle))
    ahead, aside = (np.stack([np.cos(h), np.sin(h), 0 * h], axis=-1) for h in (heading, heading + np.pi / 2))
    up = np.array([0, 0, 1.0])

    def at(forward: float, left: float, height: float) -> Array:
        return place + forward * ahead + left * aside + height * up

    def limb(name: str, swing: Array) -> Array:
        return np.asarray(STATURE_SHARES[name] * STATURE_M * (np.sin(swing)[:, None] * ahead - np.cos(swing)[:, None] * up))

    points = {"nose": at(0.1, 0, 1.62)}
    for side, sign in (("left", 1.0), ("right", -1.0)):
        step = sign * np.sin(5.5 * t_s)
        points |= {f"{side}_eye": at(0.09, sign * 0.03, 1.66), f"{side}_ear": at(0, sign * 0.07, 1.63)}
        points |= {f"{side}_shoulder": at(0, sign * 0.19, 1.42), f"{side}_hip": at(0, sign * 0.14, 0.91)}
        points[f"{side}_elbow"] = points[f"{side}_shoulder"] + limb("upper_arm", -0.5 * step)
        points[f"{side}_wrist"] = points[f"{side}_elbow"] + limb("forearm", -0.5 * step + 0.4)
        points[f"{side}_knee"] = points[f"{side}_hip"] + limb("thigh", 0.45 * step + 0.1)
        points[f"{side}_ankle"] = points[f"{side}_knee"] + limb("shank", 0.45 * step - 0.1 - 0.4 * np.maximum(step, 0))
    return np.stack([points[name] for name in BODY.keypoints], axis=1)


def watch_walker(rig: Rig, seconds: float = 12.0, rate_hz: float = 4.0, noise_px: float = 1.0, seed: int = 0) -> PersonViews:
    """What synchronised cameras see of the walker, with noise."""
    t_s = np.arange(round(seconds * rate_hz)) / rate_hz
    xy = np.stack([camera.project(walker(t_s)) for camera in rig])
    xy = xy + np.random.default_rng(seed).normal(0, noise_px, xy.shape)
    every = np.ones(xy.shape[:-1])
    return PersonViews(rig.names, BODY, np.round(t_s * 1e9).astype(np.int64), xy, 0.9 * every, noise_px * every)
