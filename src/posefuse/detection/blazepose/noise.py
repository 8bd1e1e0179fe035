"""The likely error of a keypoint, from the outputs of the network.

    log sigma = offset[k] + weights . features,   sigma in px of the crop's own 256 px, per image coordinate

Coefficients and how they were fitted stand in a TOML file next to the model card.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
from annotated_types import Gt

from posefuse.core.arrays import Array
from posefuse.foundation.settings import read_settings, settings

from .landmarks import Landmarks


@settings
class NoiseModel:
    """Fitted coefficients.

    Attributes:
        made_by: command, data and date of the fit, for people.
        weights: of the features, by name: see `landmark_noise_features`.
        offset: of each keypoint, by name.
        least_px, most_px: limits of sigma, crop px.
    """

    made_by: str
    weights: dict[str, float]
    offset: dict[str, float]
    least_px: Annotated[float, Gt(0)]
    most_px: Annotated[float, Gt(0)]

    def sigma_px(self, seen: Landmarks, keypoints: tuple[str, ...]) -> Array:
        """(B, K) standard deviation of each coordinate in crop px."""
        values = landmark_noise_features(seen)
        log_sigma = np.array([self.offset[name] for name in keypoints]) + sum(
            weight * values[name] for name, weight in self.weights.items()
        )
        return np.asarray(np.exp(np.clip(log_sigma, np.log(self.least_px), np.log(self.most_px))))


def landmark_noise_features(seen: Landmarks) -> dict[str, Array]:
    """What sigma may depend on, each (B, K) and 0 for a keypoint seen without doubt."""
    return {
        "doubt": -np.log(np.clip(seen.visibility, 1e-3, 1.0)),
        "faintness": 1 - seen.peak,
        "spread": np.log(np.maximum(seen.spread_px, 1.0) / 4.0),
        "shift": np.log1p(seen.shift_px / 2.0),
    }


def read_noise(path: Path) -> NoiseModel:
    """Read fitted coefficients; raises ConfigError naming the file and key."""
    return read_settings(path, NoiseModel)
