"""The likely error of a keypoint, from the outputs of the network.

BlazePose: log sigma = offset[k] + weights . features,   sigma in px of the crop's own 256 px, per image coordinate
cards of users: the same for each image axis,            sigma in shares of the height of the crop

Coefficients and how they were fitted stand in a TOML file next to the model card (`posefuse fit-noise` for those of users);
without a fit a rule of thumb applies.
"""

from __future__ import annotations

from dataclasses import field
from pathlib import Path
from typing import Annotated

import numpy as np
from annotated_types import Gt

from posefuse.core import ConfigError
from posefuse.core.arrays import Array
from posefuse.foundation.settings import read_settings, settings

from .decode import Keypoints, Landmarks


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


def read_noise(path: Path | None) -> NoiseModel:
    """Read fitted coefficients; raises ConfigError naming the file and key, or that a card names none."""
    if path is None:
        raise ConfigError("a network of BlazePose's layout needs a noise model: `noise = FILE` in its card")
    return read_settings(path, NoiseModel)


# a distribution this wide, as a share of the crop's height, counts as usual: that of the labels networks are trained with
_USUAL_SPREAD = 0.011
FEATURES = ("doubt", "spread", "rival")


@settings
class KeypointNoise:
    """Coefficients.

    Attributes:
        made_by: command and data of the fit, for people.
        weights: of the features, by name: see `keypoint_noise_features`.
        offset: of each keypoint, by name; "" for all that are not named.
        least, most: limits of sigma, shares of the crop's height.
    """

    made_by: str
    weights: dict[str, float]
    offset: dict[str, float] = field(default_factory=dict)
    least: Annotated[float, Gt(0)] = 0.002
    most: Annotated[float, Gt(0)] = 0.15

    def sigma(self, seen: Keypoints, names: tuple[str, ...], height_px: float) -> Array:
        """(B, K, 2) standard deviation along x and y in the units of `height_px`, which is the height of the crop."""
        values = keypoint_noise_features(seen, height_px)
        offset = np.array([self.offset.get(name, self.offset.get("", np.log(_RULE_SIGMA))) for name in names])
        log_sigma = offset[:, None] + sum(weight * values[name] for name, weight in self.weights.items())
        return np.asarray(height_px * np.exp(np.clip(log_sigma, np.log(self.least), np.log(self.most))))


# at score 1, as for 2D files that state nothing but a score; about 1.5 px of a crop of 256
_RULE_SIGMA = 0.006
RULE_OF_THUMB = KeypointNoise(made_by="rule of thumb: not fitted to this network", weights={"doubt": 1.0, "spread": 1.0})


def keypoint_noise_features(seen: Keypoints, height_px: float) -> dict[str, Array]:
    """The predictors of sigma, each (B, K, 2) and 0 for a certain keypoint, or where the network has no such output."""
    with np.errstate(invalid="ignore"):
        spread = np.log(np.maximum(seen.spread_px / (height_px * _USUAL_SPREAD), 0.1))
    doubt = -np.log(np.clip(seen.score, 0.02, 1.0))
    return {
        "doubt": np.stack([doubt, doubt], axis=-1),
        "spread": np.nan_to_num(spread),
        "rival": np.stack([seen.rival, seen.rival], axis=-1),
    }


def read_keypoint_noise(path: Path | None) -> KeypointNoise:
    """Fitted coefficients, or the rule of thumb; raises ConfigError naming the file and key."""
    return RULE_OF_THUMB if path is None else read_settings(path, KeypointNoise)
