"""The likely error of a keypoint of a user's network, from the network's outputs, for each image axis.

    log sigma = offset[k] + weights . features,   sigma in shares of the height of the crop

Fitted by `posefuse fit-noise`; without a fit a rule of thumb applies.
"""

from __future__ import annotations

from dataclasses import field
from pathlib import Path
from typing import Annotated

import numpy as np
from annotated_types import Gt

from posefuse.core.arrays import Array
from posefuse.foundation.settings import read_settings, settings

from .keypoints import Keypoints

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
