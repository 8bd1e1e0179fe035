"""The likely error of a keypoint, from the outputs of the network.

log sigma = offset[k] + weights . features, per image coordinate, in px of the crop's own 256 px for BlazePose, and in shares of
the height of the crop, for each image axis, for cards of users.

Coefficients and how they were fitted stand in a TOML file next to the model card (`posefuse fit-noise` for those of users);
without a fit a rule of thumb applies.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from pathlib import Path
from typing import Annotated

import numpy as np
from annotated_types import Gt

from posefuse.core.arrays import Array
from posefuse.foundation.settings import read_settings, settings

from .decode import Keypoints, Landmarks

# at score 1, as for 2D files that state nothing but a score; about 1.5 px of a crop of 256
_RULE_SIGMA = 0.006


@settings
class NoiseModel:
    """Coefficients.

    Attributes:
        made_by: command, data and date of the fit, for people.
        weights: of the features, by name: see `landmark_noise_features` and `keypoint_noise_features`.
        offset: of each keypoint, by name; "" for all that are not named.
        least, most: limits of sigma.
    """

    made_by: str
    weights: dict[str, float]
    offset: dict[str, float] = field(default_factory=dict)
    least: Annotated[float, Gt(0)] = 0.002
    most: Annotated[float, Gt(0)] = 0.15

    def sigma(self, features: Mapping[str, Array], names: tuple[str, ...]) -> Array:
        """(B, K, ...) standard deviation of each coordinate, of features (B, K, ...), in the unit of the coefficients."""
        offset = np.array([self.offset.get(name, self.offset.get("", np.log(_RULE_SIGMA))) for name in names])
        parts = sum(weight * features[name] for name, weight in self.weights.items())
        log_sigma = offset.reshape(-1, *[1] * (np.ndim(parts) - 2)) + parts
        return np.asarray(np.exp(np.clip(log_sigma, np.log(self.least), np.log(self.most))))


RULE_OF_THUMB = NoiseModel(made_by="rule of thumb: not fitted to this network", weights={"doubt": 1.0, "spread": 1.0})


def read_noise(path: Path | None) -> NoiseModel:
    """Fitted coefficients, or the rule of thumb; raises ConfigError naming the file and key."""
    return RULE_OF_THUMB if path is None else read_settings(path, NoiseModel)


def landmark_noise_features(seen: Landmarks) -> dict[str, Array]:
    """What sigma may depend on, each (B, K) and 0 for a keypoint seen without doubt."""
    return {
        "doubt": -np.log(np.clip(seen.visibility, 1e-3, 1.0)),
        "faintness": 1 - seen.peak,
        "spread": np.log(np.maximum(seen.spread_px, 1.0) / 4.0),
        "shift": np.log1p(seen.shift_px / 2.0),
    }


# a distribution this wide, as a share of the crop's height, counts as usual: that of the labels networks are trained with
_USUAL_SPREAD = 0.011
FEATURES = ("doubt", "spread", "rival")


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
