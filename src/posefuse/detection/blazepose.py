"""The default detector: BlazePose networks by OpenVINO on the CPU, many images and people at once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from annotated_types import Ge

from posefuse.core import ConfigError, Detections2D, Frame, JointCentres, Region, Skeleton
from posefuse.core.arrays import Array
from posefuse.formats.joint_centres import read_joint_centres
from posefuse.foundation.places import default_cache_dir
from posefuse.foundation.platform import usable_cores
from posefuse.foundation.settings import settings

from .card import BLAZEPOSE_PERSONS, Card, EnsembleCard, LandmarkCard, NetworkCard, PersonCard, read_card
from .crops import Crops, check_regions, img_from_crop, region_from_keypoints
from .decode import landmarks_from_outputs
from .device import Device, Precision, openvino_device
from .engines import BlazePoseNetwork
from .files import fetch_all
from .noise import NoiseModel, landmark_noise_features, read_noise
from .search import PersonNetwork, stages

# of a crop that shows a person; below it the keypoints carry no information
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
    def compiled(cls, card: LandmarkCard, file: Path, precision: Precision, streams: int, device: Device) -> LandmarkNetwork:
        """The card's network, ready."""
        decoding = card.decoding
        outputs = (decoding.landmarks, decoding.presence, decoding.heatmaps)
        network = BlazePoseNetwork(file, outputs, card.input, precision, streams, device)
        if card.noise_file is None:
            raise ConfigError(f"{card.name}: a network of BlazePose's layout needs a noise model: `noise = FILE` in its card")
        return cls(network, read_noise(card.noise_file), card.skeleton)

    def look(self, crops: Sequence[Array]) -> list[Look]:
        """One look at each crop (side, side, 3) uint8."""
        landmarks, presence, heatmaps = self.network(crops)
        seen = landmarks_from_outputs(landmarks, presence, heatmaps, len(self.skeleton), self.network.side_px)
        sigma = self.noise.sigma(landmark_noise_features(seen), self.skeleton.keypoints)
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


# two looks whose keypoints are closer than this share of the longer side of the person (median) show one person. A body that
# is cut off at the edge of one square and whole in another differs by up to a tenth.
_SAME_PERSON = 0.12


# looked for per image when no regions are given
_MOST_PEOPLE = 16


@settings
class BlazePoseConfig:
    """BlazePose by OpenVINO.

    Attributes:
        landmarks: model card by name, or a TOML file of your own; it may be an ensemble.
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

    def cards(self) -> list[NetworkCard]:
        """Of the networks that it needs."""
        persons, _, members = self._cards()
        return [persons, *members]

    def fetch(
        self, progress: Callable[[str], None] | None = None, advance: Callable[[int, int], None] | None = None
    ) -> list[Path]:
        """The network files, fetched where they are missing; see `fetch_all` for what is reported and raised."""
        openvino_device(self.device)
        return fetch_all(self.cards(), default_cache_dir(), None, progress, advance)

    def build(self) -> BlazePoseDetector:
        """Fetch what is missing, compile, and be ready; raises ModelError when a network cannot be had."""
        persons, chosen, members = self._cards()
        files = self.fetch()
        streams, device, table = self.streams or usable_cores(), openvino_device(self.device), chosen.joint_centres_file
        return BlazePoseDetector(
            self,
            PersonNetwork.compiled(persons, files[0], self.precision, streams, device),
            [
                LandmarkNetwork.compiled(*member, self.precision, streams, device)
                for member in zip(members, files[1:], strict=True)
            ],
            mirrored=isinstance(chosen, EnsembleCard) and chosen.mirrored,
            joint_centres=read_joint_centres(table) if table else None,
        )

    def _cards(self) -> tuple[PersonCard, Card, list[LandmarkCard]]:
        """Of the person network, of what was chosen for landmarks, and of the landmark networks in it."""
        chosen = read_card(self.landmarks, Card)
        members = chosen.member_cards() if isinstance(chosen, EnsembleCard) else [read_card(self.landmarks, LandmarkCard)]
        return read_card(BLAZEPOSE_PERSONS, PersonCard), chosen, members


def default_cards() -> list[NetworkCard]:
    """The networks used when no one chooses others."""
    return BlazePoseConfig().cards()


class BlazePoseDetector:
    """Implements `core.Detector`. Not for use from several threads at once; build one for each."""

    def __init__(
        self,
        config: BlazePoseConfig,
        persons: PersonNetwork,
        landmarks: Sequence[LandmarkNetwork],
        mirrored: bool,
        joint_centres: JointCentres | None,
    ) -> None:
        self._config, self._persons, self._landmarks, self._mirrored = config, persons, landmarks, mirrored
        self._joint_centres = joint_centres
        self._skeleton = landmarks[0].skeleton
        self._side_px = landmarks[0].network.side_px

    @property
    def skeleton(self) -> Skeleton:
        """The landmark network's keypoints."""
        return self._skeleton

    @property
    def joint_centres(self) -> JointCentres | None:
        """The table that was fitted to the landmark network, if there is one."""
        return self._joint_centres

    def detect(self, frames: Sequence[Frame], regions: Sequence[Sequence[Region] | None]) -> list[Detections2D]:
        """One Detections2D per frame: the people in the given regions, in that order, or all who are found (best first)."""
        check_regions(frames, regions)
        unknown = [i for i, given in enumerate(regions) if given is None]
        found = dict(zip(unknown, self._search([frames[i] for i in unknown]), strict=True))
        todo = [(i, region) for i, given in enumerate(regions) for region in (found[i] if given is None else given)]
        looks = self._look([(frames[i], region) for i, region in todo])
        people: list[list[Look]] = [[] for _ in frames]
        for (i, _), look in zip(todo, looks, strict=True):
            people[i].append(look)
        return [self._result(frame, people[i], keep_all=regions[i] is not None) for i, frame in enumerate(frames)]

    def _search(self, frames: Sequence[Frame]) -> list[list[Region]]:
        """Everybody in whole images, stage by stage; what the landmark network does not confirm was no person.

        Those who are found first are not all: closer stages follow until one of them finds no new person.
        """
        found: list[list[Look]] = [[] for _ in frames]
        plans = [stages(frame.size_wh, self._config.up_rad.get(frame.camera, 0.0)) for frame in frames]
        open_frames = list(range(len(frames)))
        while open_frames:
            before = [len(people) for people in found]
            now = {i: next(plans[i], []) for i in open_frames}
            self._look_at_squares(frames, [(i, square) for i, squares in now.items() for square in squares], found)
            open_frames = [i for i in open_frames if now[i] and (not before[i] or len(found[i]) > before[i])]
        regions = [[region_from_keypoints(look.xy, self._skeleton) for look in people] for people in found]
        return [[region for region in some if region is not None] for some in regions]

    def _look_at_squares(self, frames: Sequence[Frame], squares: Sequence[tuple[int, Region]], found: list[list[Look]]) -> None:
        """Add the people of squares of frames to those found."""
        candidates = self._candidates(frames, squares) if squares else []
        confirmed = self._look([(frames[i], region) for i, region in candidates], thoroughly=False)
        for (i, _), look in zip(candidates, confirmed, strict=True):
            if look.presence < _LEAST_PRESENCE or len(found[i]) >= _MOST_PEOPLE:
                continue
            if region_from_keypoints(look.xy, self._skeleton) is not None and not _known(look, found[i]):
                found[i].append(look)

    def _candidates(self, frames: Sequence[Frame], looks: Sequence[tuple[int, Region]]) -> list[tuple[int, Region]]:
        found = self._persons.scored([(frames[i], square) for i, square in looks])
        scored = [(score, i, region) for (i, _), people in zip(looks, found, strict=True) for score, region in people]
        return [(i, region) for _, i, region in sorted(scored, key=lambda entry: -entry[0])]

    def _look(self, people: Sequence[tuple[Frame, Region]], thoroughly: bool = True) -> list[Look]:
        """Landmarks of each person in raw px; if not `thoroughly`, by the first network alone."""
        if not people:
            return []
        side = self._side_px
        crops = Crops([(frame.image, region) for frame, region in people], side)
        rounds = [member.look(crops) for member in (self._landmarks if thoroughly else self._landmarks[:1])]
        if thoroughly and self._mirrored:
            rounds += [member.look_in_mirror(crops) for member in self._landmarks]
        looks = [averaged(looks) for looks in zip(*rounds, strict=True)]
        return [_in_image(look, region, side) for look, (_, region) in zip(looks, people, strict=True)]

    def _result(self, frame: Frame, people: Sequence[Look], keep_all: bool) -> Detections2D:
        shown = [look for look in people if keep_all or look.presence >= _LEAST_PRESENCE]
        absent = np.array([look.presence < _LEAST_PRESENCE for look in shown], np.bool_)
        xy, score, sigma = (np.array([getattr(look, name) for look in shown]) for name in ("xy", "score", "sigma_px"))
        xy[absent], score[absent], sigma[absent] = np.nan, 0.0, np.nan
        return Detections2D.of(frame.camera, frame.t_ns, self._skeleton, xy, score, sigma)


def _in_image(look: Look, region: Region, side_px: int) -> Look:
    """The same in raw px instead of crop px."""
    return replace(look, xy=img_from_crop(region, side_px, look.xy), sigma_px=look.sigma_px * region.side_px / side_px)


def _known(look: Look, others: Sequence[Look]) -> bool:
    """Whether two detections show the same person: their keypoints coincide."""
    for other in others:
        side = max(np.ptp(look.xy, axis=0).max(), np.ptp(other.xy, axis=0).max())
        if np.median(np.linalg.norm(look.xy - other.xy, axis=-1)) < _SAME_PERSON * side:
            return True
    return False
