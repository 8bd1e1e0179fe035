"""The default detector: BlazePose networks by OpenVINO on the CPU, many images and people at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from annotated_types import Ge

from posefuse.core import ConfigError, Frame, Progress, Region, silent
from posefuse.core.arrays import Array
from posefuse.foundation.platform import default_cache_dir, usable_cores
from posefuse.foundation.settings import settings

from .card import BLAZEPOSE_PERSONS, LandmarkCard, NetworkCard, PersonCard, read_card
from .crops import Crops, img_from_crop
from .decode import landmarks_from_outputs
from .device import Device, Precision, openvino_device
from .engines import BlazePoseNetwork
from .files import fetch_all
from .networks import CropDetector, DetectedPerson
from .noise import landmark_noise_features, read_noise
from .search import SquareFinder

# of a look at one person; below it the keypoints carry no information
_LEAST_PRESENCE = 0.5


class LandmarkNetwork:
    """A landmark network, compiled, its card, the noise model fitted to it, and the skeleton it marks."""

    def __init__(self, card: LandmarkCard, file: Path, precision: Precision, streams: int, device: Device) -> None:
        decoding = card.decoding
        outputs = (decoding.landmarks, decoding.presence, decoding.heatmaps)
        self.network = BlazePoseNetwork(file, outputs, card.input, precision, streams, device)
        if card.noise_file is None:
            raise ConfigError(f"{card.name}: a network of BlazePose's layout needs a noise model: `noise = FILE` in its card")
        self.card, self.noise, self.skeleton = card, read_noise(card.noise_file), card.skeleton

    def look(self, crops: Sequence[Array]) -> list[DetectedPerson]:
        """One look at each crop (side, side, 3) uint8."""
        landmarks, presence, heatmaps = self.network(crops)
        seen = landmarks_from_outputs(landmarks, presence, heatmaps, len(self.skeleton), self.network.side_px)
        sigma = self.noise.sigma(landmark_noise_features(seen), self.skeleton.keypoints)
        return [
            DetectedPerson(seen.xy_crop[b], seen.visibility[b] * presence, sigma[b], float(presence))
            for b, presence in enumerate(seen.presence)
        ]

    def look_in_mirror(self, crops: Sequence[Array]) -> list[DetectedPerson]:
        """The same on the mirrored crops, in pixels and sides of the original crops."""
        other = self.skeleton.mirror
        last = self.network.side_px - 1
        looks = self.look([np.ascontiguousarray(crop[:, ::-1]) for crop in crops])
        back = [last, 0.0] + np.array([-1.0, 1.0]) * np.stack([look.xy[other] for look in looks])
        return [
            DetectedPerson(xy, look.score[other], look.sigma_px[other], look.presence)
            for look, xy in zip(looks, back, strict=True)
        ]


def averaged(looks: Sequence[DetectedPerson]) -> DetectedPerson:
    """One look from several at the same crop, weighted by 1/sigma^2.

    The errors of one network in both are correlated, so the average is not more certain than its parts; what they
    disagree by is added to its variance. Looks that see no person are left out, unless none sees any person.
    """
    counted = [look for look in looks if look.presence >= _LEAST_PRESENCE] or list(looks)
    if len(counted) == 1:
        return counted[0]
    xy, variance = np.stack([look.xy for look in counted]), np.stack([look.sigma_px for look in counted]) ** 2
    weight = 1 / variance / (1 / variance).sum(axis=0)
    mean = (weight[..., None] * xy).sum(axis=0)
    apart = (weight * ((xy - mean) ** 2).mean(axis=-1)).sum(axis=0)
    return DetectedPerson(
        mean,
        np.mean([look.score for look in counted], axis=0),
        np.sqrt((weight * variance).sum(axis=0) + apart),
        float(np.mean([look.presence for look in counted])),
    )


@settings
class BlazePoseConfig:
    """BlazePose by OpenVINO.

    Attributes:
        landmarks: model card by name, or a TOML file of your own.
        device: processor: ``auto`` and ``cpu`` are the CPU; ``openvino:gpu``, ``openvino:npu``.
        precision: of the CPU; ``auto`` is bf16 where it computes that natively.
        streams: images worked on at once; 0: one per core.
        up_rad: per camera, direction of gravity's up in its image, clockwise from the image's up
            (`up_angle_rad` of a calibrated camera); cameras not named are taken as upright.
    """

    landmarks: str = "blazepose_full"
    device: str = "auto"
    precision: Precision = "auto"
    streams: Annotated[int, Ge(0)] = 0
    up_rad: dict[str, float] = field(default_factory=dict)

    def cards(self) -> tuple[PersonCard, LandmarkCard]:
        """Of the networks that it needs: for people, and for landmarks."""
        return read_card(BLAZEPOSE_PERSONS, PersonCard), read_card(self.landmarks, LandmarkCard)

    def fetch(self, progress: Progress = silent) -> list[Path]:
        """The network files, fetched where they are missing; see `fetch_all` for what is reported and raised."""
        openvino_device(self.device)
        return fetch_all(self.cards(), default_cache_dir(), progress)

    def build(self) -> BlazePoseDetector:
        """Fetch what is missing, compile, and be ready; raises ModelError when a network cannot be had."""
        persons, card = self.cards()
        persons_file, file = self.fetch()
        machine = self.precision, self.streams or usable_cores(), openvino_device(self.device)
        finder = SquareFinder(persons, persons_file, *machine)
        return BlazePoseDetector(LandmarkNetwork(card, file, *machine), finder, self.up_rad)


def default_cards() -> list[NetworkCard]:
    """The networks used when no one chooses others."""
    return list(BlazePoseConfig().cards())


class BlazePoseDetector(CropDetector):
    """People by a person network and a landmark network.

    Args:
        landmarks: the network. finder: of people in whole images. up_rad: per camera, see `BlazePoseConfig`.
    """

    def __init__(self, landmarks: LandmarkNetwork, finder: SquareFinder, up_rad: Mapping[str, float]) -> None:
        super().__init__(landmarks.skeleton, landmarks.card.joint_centres_file, up_rad)
        self._landmarks, self._finder = landmarks, finder

    def _look(self, crops: Sequence[tuple[Frame, Region]]) -> list[DetectedPerson]:
        if not crops:
            return []
        side = self._landmarks.network.side_px
        inputs = Crops([(frame.image, region) for frame, region in crops], side)
        looks = self._landmarks.look(inputs)
        if self._landmarks.card.mirrored:
            looks = [averaged(both) for both in zip(looks, self._landmarks.look_in_mirror(inputs), strict=True)]
        return [_in_image(look, region, side) for look, (_, region) in zip(looks, crops, strict=True)]


def _in_image(look: DetectedPerson, region: Region, side_px: int) -> DetectedPerson:
    """The same in raw px instead of crop px; no person where it hardly shows one."""
    if look.presence < _LEAST_PRESENCE:
        return DetectedPerson.missing(len(look.xy))
    return replace(look, xy=img_from_crop(region, side_px, look.xy), sigma_px=look.sigma_px * region.side_px / side_px)
