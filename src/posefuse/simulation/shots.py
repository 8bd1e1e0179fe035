"""When each camera exposes each frame, and what its clock writes on it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posefuse.core import ConfigError
from posefuse.core.arrays import Array, frozen

from .cameras import SensorSettings

# keeps frames in order however strong the jitter
_JITTER_LIMIT_PERIODS = 0.45
_PURPOSE = {"jitter": 1, "stamp": 2, "drop": 3}


@dataclass(frozen=True, eq=False)
class Shots:
    """The frames one camera delivers.

    Attributes:
        camera: its name.
        seq: (F,) running number of each frame, gaps where frames were lost.
        t_ns: (F,) true mid-exposure (of the middle row) on the session clock.
        stamp_ns: (F,) the same moment as the camera's own clock has it.
    """

    camera: str
    seq: Array
    t_ns: Array
    stamp_ns: Array

    def __post_init__(self) -> None:
        for name in ("seq", "t_ns", "stamp_ns"):
            object.__setattr__(self, name, frozen(getattr(self, name), np.int64, f"Shots.{name}"))

    def __len__(self) -> int:
        return len(self.t_ns)


def shots_of(
    camera: str, index: int, sensor: SensorSettings, rate_hz: float, start_s: float, duration_s: float, seed: int
) -> Shots:
    """Frames of camera number `index` between `start_s` and `start_s + duration_s`, the same for the same seed.

    Raises:
        ConfigError: no frame is left, or the camera's clock would show negative times.
    """
    rate_hz = sensor.rate_hz or rate_hz
    # the camera counts its own seconds
    period_s = 1 / rate_hz / (1 + sensor.drift_ppm * 1e-6)
    count = max(0, int(np.ceil((duration_s - sensor.phase_s) / period_s - 1e-9)))
    seq = np.arange(count)
    jitter_s = sensor.jitter_s * _normals(seed, "jitter", index, count)
    jitter_s = np.clip(jitter_s, -_JITTER_LIMIT_PERIODS * period_s, _JITTER_LIMIT_PERIODS * period_s)
    # nothing is exposed before the scene begins
    t_s = np.maximum(start_s + sensor.phase_s + seq * period_s + jitter_s, start_s)
    stamp_s = sensor.offset_s + t_s * (1 + sensor.drift_ppm * 1e-6) + sensor.stamp_noise_s * _normals(seed, "stamp", index, count)
    kept = _rng(seed, "drop", index).random(count) >= sensor.drop_fraction
    if not kept.any():
        raise ConfigError(
            f"camera {camera}: no frame is left between {start_s} s and {start_s + duration_s} s; "
            "make duration_s longer, phase_s or drop_fraction smaller"
        )
    stamp_ns = np.round(stamp_s[kept] * 1e9).astype(np.int64)
    if stamp_ns[0] < 0:
        raise ConfigError(
            f"camera {camera}: its clock starts at {stamp_ns[0] / 1e9:.3f} s, and a video has no times before 0; "
            f"set start_s to at least {start_s - stamp_ns.min() / 1e9:.3f}"
        )
    if (np.diff(stamp_ns) <= 0).any():
        raise ConfigError(f"camera {camera}: stamp_noise_s {sensor.stamp_noise_s} puts frames out of order; make it smaller")
    return Shots(camera, seq[kept], np.round(t_s[kept] * 1e9), stamp_ns)


def _rng(seed: int, purpose: str, index: int) -> np.random.Generator:
    return np.random.default_rng([seed, _PURPOSE[purpose], index])


def _normals(seed: int, purpose: str, index: int, count: int) -> Array:
    return _rng(seed, purpose, index).standard_normal(count)
