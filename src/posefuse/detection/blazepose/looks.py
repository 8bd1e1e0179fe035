"""Landmarks in crops: one inference of one network, or the average of several networks, also on mirrored crops."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from posefuse.core import SKELETONS, ModelError, Skeleton
from posefuse.core.arrays import Array
from posefuse.detection.models import LandmarkDecoding, ModelCard
from posefuse.detection.openvino_cpu import Precision

from .landmarks import landmarks_from_outputs
from .network import BlazePoseNetwork
from .noise import NoiseModel, read_noise

# below this presence the keypoints of a network carry no information
_LEAST_PRESENCE = 0.5


@dataclass(frozen=True, eq=False)
class Look:
    """One person in one crop.

    Attributes:
        presence: probability that the crop holds a person.
        xy: (K, 2) px of the crop, pixel centres at integers.
        score: (K,) probability that a keypoint is there and not hidden.
        sigma_px: (K,) standard deviation of each coordinate, crop px.
    """

    presence: float
    xy: Array
    score: Array
    sigma_px: Array


@dataclass(frozen=True, eq=False)
class LandmarkNetwork:
    """A landmark network, the noise model fitted to it, and the skeleton it marks."""

    network: BlazePoseNetwork
    noise: NoiseModel
    skeleton: Skeleton

    @classmethod
    def compiled(cls, card: ModelCard, file: Path, precision: Precision, streams: int) -> LandmarkNetwork:
        """The card's network, ready; raises ModelError when the card is of another kind."""
        decoding = card.decoding
        if not isinstance(decoding, LandmarkDecoding):
            raise ModelError(f"model card {card.name}: expected kind heatmap_landmarks, got {card.kind}")
        outputs = (decoding.landmarks, decoding.presence, decoding.heatmaps)
        network = BlazePoseNetwork(file, outputs, card.input, precision, streams)
        return cls(network, read_noise(card.folder / decoding.noise), SKELETONS[decoding.skeleton])

    def look(self, crops: Sequence[Array]) -> list[Look]:
        """One look at each crop (side, side, 3) uint8."""
        landmarks, presence, heatmaps = self.network(crops)
        seen = landmarks_from_outputs(landmarks, presence, heatmaps, len(self.skeleton), self.network.side_px)
        sigma = self.noise.sigma_px(seen, self.skeleton.keypoints)
        return [
            Look(float(presence), seen.xy_crop[b], seen.visibility[b] * presence, sigma[b])
            for b, presence in enumerate(seen.presence)
        ]

    def look_in_mirror(self, crops: Sequence[Array]) -> list[Look]:
        """The same on the mirrored crops, in pixels and sides of the original crops."""
        other = self.skeleton.mirror
        last = self.network.side_px - 1
        looks = self.look([np.ascontiguousarray(crop[:, ::-1]) for crop in crops])
        back = [last, 0.0] + np.array([-1.0, 1.0]) * np.stack([look.xy[other] for look in looks])
        return [Look(look.presence, xy, look.score[other], look.sigma_px[other]) for look, xy in zip(looks, back, strict=True)]


def averaged(looks: Sequence[Look]) -> Look:
    """One look from several at the same crop, weighted by 1/sigma^2.

    Networks trained on the same images have correlated errors, so the average is not more certain than its parts; what they
    disagree by is added to its variance. Looks that see no person are left out, unless none sees any person.
    """
    counted = [look for look in looks if look.presence >= _LEAST_PRESENCE] or list(looks)
    if len(counted) == 1:
        return counted[0]
    xy, variance = np.stack([look.xy for look in counted]), np.stack([look.sigma_px for look in counted]) ** 2
    weight = 1 / variance / (1 / variance).sum(axis=0)
    mean = (weight[..., None] * xy).sum(axis=0)
    apart = (weight * ((xy - mean) ** 2).mean(axis=-1)).sum(axis=0)
    return Look(
        float(np.mean([look.presence for look in counted])),
        mean,
        np.mean([look.score for look in counted], axis=0),
        np.sqrt((weight * variance).sum(axis=0) + apart),
    )
