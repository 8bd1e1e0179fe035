"""A walking person as keypoints, with the exact truth: calibration from a person tried without images."""

from __future__ import annotations

import numpy as np

from bench.faults.walkers import BODY, walking_body
from posefuse.calibration.person.views import PersonViews
from posefuse.core import Rig
from posefuse.core.arrays import Array

STATURE_M = 1.75


def walker(t_s: Array, middle_m: tuple[float, float] = (0.0, 0.0), lap_rad_s: float = 0.9) -> Array:
    """(T, 17, 3) keypoints in m, at times t_s (T,), of a person of ordinary build who walks round an ellipse."""
    angle = lap_rad_s * t_s
    place = np.stack([1.3 * np.cos(angle) + middle_m[0], 0.8 * np.sin(angle) + middle_m[1], 0 * angle], axis=-1)
    heading = np.arctan2(0.8 * np.cos(angle), -1.3 * np.sin(angle))
    return walking_body(place, heading, np.sin(5.5 * t_s), STATURE_M)


def watch_walker(
    rig: Rig, seconds: float = 12.0, rate_hz: float = 4.0, noise_px: float = 1.0, seed: int = 0, lap_rad_s: float = 0.9
) -> PersonViews:
    """What synchronised cameras see of the walker, with noise."""
    t_s = np.arange(round(seconds * rate_hz)) / rate_hz
    xy = np.stack([camera.project(walker(t_s, lap_rad_s=lap_rad_s)) for camera in rig])
    xy = xy + np.random.default_rng(seed).normal(0, noise_px, xy.shape)
    every = np.ones(xy.shape[:-1])
    return PersonViews(rig.names, BODY, np.round(t_s * 1e9).astype(np.int64), xy, 0.9 * every, noise_px * every)
