"""Detectors by networks: what all have in common, and the plug-in ``onnx``, a user's network by its model card.

A network is added by a card (`detection/cards` lists ours), one of another layout in `detection.decode`, and another kind of
detector by an entry point of `posefuse.detectors` (docs/howto/plugins.md).

People are in regions that are given, or all who are found in whole images. A user's network looks at one person per crop
(top-down) or at the whole image at once.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from annotated_types import Ge

from posefuse.core import ConfigError, Detections2D, Frame, Progress, Region, Skeleton, silent
from posefuse.core.arrays import Array
from posefuse.core.duplicates import duplicates
from posefuse.core.protocols import NOISE_NOT_FITTED
from posefuse.formats.joint_centres import read_joint_centres
from posefuse.foundation.platform import default_cache_dir, usable_cores
from posefuse.foundation.settings import settings

from .boxes import keypoints_of
from .card import PERSONS, OnnxCard, PersonCard, persons_card, read_card
from .crops import check_regions, img_from_input, input_crop_from_img, nearest_to, region_from_keypoints, warp_to_input
from .decode import Keypoints, People
from .device import Precision, device_of
from .download import file_sha256
from .engines import OnnxNetwork
from .files import fetch_all
from .noise import keypoint_noise_features, read_noise
from .search import BoxFinder, PersonFinder, SquareFinder, people_in_images, upright_first


@dataclass(frozen=True, eq=False)
class DetectedPerson:
    """One person in px of an image or a crop, pixel centres at integers.

    Attributes:
        xy: (K, 2). score: (K,) probability that a keypoint is there and not hidden.
        sigma_px: (K,) standard deviation of each coordinate. presence: probability that there is a person.
    """

    xy: Array
    score: Array
    sigma_px: Array
    presence: float = 1.0

    @staticmethod
    def missing(count: int) -> DetectedPerson:
        """No person, of so many keypoints."""
        return DetectedPerson(np.full((count, 2), np.nan), np.zeros(count), np.full(count, np.nan))


# looked for per image when no regions are given
_MOST_PEOPLE = 16
# as of `core.duplicates`: a body that is cut off at the edge of one square and whole in another differs by up to a tenth
_SAME_PERSON = 0.12


class NetworkDetector(ABC):
    """Implements `core.Detector` but for `_found` and `_given`. Not for use from several threads at once; build one for each.

    Attributes:
        skeleton: the network's keypoints. joint_centres: the table that was fitted to it, if there is one.
    """

    def __init__(self, skeleton: Skeleton, table: Path | None, up_rad: Mapping[str, float]) -> None:
        self.skeleton, self.joint_centres = skeleton, read_joint_centres(table) if table else None
        self._up_rad = up_rad

    def detect(self, frames: Sequence[Frame], regions: Sequence[Sequence[Region] | None]) -> list[Detections2D]:
        """One Detections2D per frame: the people in the given regions, in that order, or all who are found (best first)."""
        check_regions(frames, regions)
        searched = [i for i, given in enumerate(regions) if given is None]
        asked = [(i, given) for i, given in enumerate(regions) if given is not None]
        people = dict(zip(searched, self._found([frames[i] for i in searched]), strict=True))
        people |= zip([i for i, _ in asked], self._given([(frames[i], given) for i, given in asked]), strict=True)
        return [self._result(frame, people[i]) for i, frame in enumerate(frames)]

    @abstractmethod
    def _found(self, frames: Sequence[Frame]) -> list[list[DetectedPerson]]:
        """All people who are found in each image, best first."""

    @abstractmethod
    def _given(self, asked: Sequence[tuple[Frame, Sequence[Region]]]) -> list[list[DetectedPerson]]:
        """For each image one person per region, in that order."""

    def _result(self, frame: Frame, people: Sequence[DetectedPerson]) -> Detections2D:
        parts = ([getattr(person, name) for person in people] for name in ("xy", "score", "sigma_px"))
        return Detections2D.of(frame.camera, frame.t_ns, self.skeleton, *parts)


class CropDetector(NetworkDetector):
    """A network that looks at one person per crop, and what finds people for it (`_finder`); implements all but `_look`."""

    _finder: PersonFinder

    @abstractmethod
    def _look(self, crops: Sequence[tuple[Frame, Region]]) -> list[DetectedPerson]:
        """One person per crop, in raw px."""

    def _found(self, frames: Sequence[Frame]) -> list[list[DetectedPerson]]:
        """Looks again where the search found people: after one look keypoints of rendered people are off by a tenth more."""
        found = [[region_from_keypoints(one.xy, self.skeleton) for one in people] for people in self._search(frames)]
        regions = [[region for region in some if region is not None] for some in found]
        looked_at = self._given(list(zip(frames, regions, strict=True)))
        return [[person for person in people if person.score.any()] for people in looked_at]

    def _given(self, asked: Sequence[tuple[Frame, Sequence[Region]]]) -> list[list[DetectedPerson]]:
        looked = iter(self._look([(frame, region) for frame, regions in asked for region in regions]))
        return [[next(looked) for _ in regions] for _, regions in asked]

    def _search(self, frames: Sequence[Frame]) -> list[list[DetectedPerson]]:
        """Everybody in whole images, each once, stage by stage; what the keypoint network does not confirm was no person.

        Those who are found first are not all: closer stages follow until one of them finds no new person.
        """
        found: list[list[DetectedPerson]] = [[] for _ in frames]
        plans = [self._finder.stages(frame.size_wh, self._up_rad.get(frame.camera, 0.0)) for frame in frames]
        due = list(range(len(frames)))
        while squares := {i: parts for i in due if (parts := next(plans[i], None))}:
            before = [len(people) for people in found]
            regions = self._finder.people([(frames[i], parts) for i, parts in squares.items()])
            looks = iter(self._look([(frames[i], region) for i, some in zip(squares, regions, strict=True) for region in some]))
            for i, some in zip(squares, regions, strict=True):
                found[i] = self._each_once(frames[i], [*found[i], *(next(looks) for _ in some)])
            due = [i for i in squares if not before[i] or len(found[i]) > before[i]]
        return found

    def _each_once(self, frame: Frame, looks: Sequence[DetectedPerson]) -> list[DetectedPerson]:
        """The people among looks at one image, by the first look at each."""
        people = [one for one in looks if region_from_keypoints(one.xy, self.skeleton)]
        again = duplicates(self._result(frame, people), _SAME_PERSON, sure=-np.arange(len(people)))
        return [one for one, twice in zip(people, again, strict=True) if not twice][:_MOST_PEOPLE]


@settings
class OnnxConfig:
    """A user's network by its model card.

    Attributes:
        card: name of a card, or the TOML file of one of your own, see docs/networks.md.
        device: processor: ``auto`` (a graphics card of NVIDIA if one runs it, else the CPU), ``cpu``, ``cuda:1`` and others.
        precision: of the CPU; ``auto`` is bf16 where it computes that natively.
        streams: images worked on at once; 0: one per core.
        up_rad: per camera, direction of gravity's up in its image, clockwise from the image's up
            (`up_angle_rad` of a calibrated camera); cameras not named are taken as upright.
    """

    card: str
    device: str = "auto"
    precision: Precision = "auto"
    streams: Annotated[int, Ge(0)] = 0
    up_rad: dict[str, float] = field(default_factory=dict)

    def fetch(self, progress: Progress = silent) -> list[Path]:
        """The files of the network and of its person detector, those with a source fetched; see `fetch_all`."""
        device_of(self.device)
        return fetch_all(self.cards(), default_cache_dir(), progress)

    def build(self) -> TopDownDetector | OneStageDetector:
        """Read the cards, check and compile their files.

        Raises:
            ConfigError: an invalid card. ModelError: a network that is missing or differs from its card.
            DependencyError: the device needs ONNX Runtime, and that is not installed.
        """
        card, *persons = self.cards()
        path, *persons_path = self.fetch()
        network = self._network(card, path)
        if not persons:
            return OneStageDetector(network, self.up_rad)
        return TopDownDetector(network, self._finder(card, persons[0], persons_path[0]), self.up_rad)

    def cards(self) -> tuple[OnnxCard] | tuple[OnnxCard, OnnxCard | PersonCard]:
        """Of the network, and of the one that finds people for it."""
        card = read_card(self.card, OnnxCard)
        if card.kind in PERSONS:
            raise ConfigError(f"{self.card}: layout {card.kind} finds people only; name it as `persons` in a card of keypoints")
        finder = persons_card(card)
        if finder is None:
            return (card,)
        if not isinstance(finder, PersonCard) and not (isinstance(finder, OnnxCard) and finder.kind in PERSONS):
            kinds = ", ".join((*PERSONS, "person_ssd"))
            raise ConfigError(f"{self.card}: persons: expected a card of a kind of {kinds}, got {card.persons} of {finder.kind}")
        return card, finder

    def _network(self, card: OnnxCard, path: Path) -> OnnxNetwork:
        # the result names the file that was used, also where its makers state no hash
        known = replace(card, sha256=card.sha256.lower() or file_sha256(path))
        return OnnxNetwork(known, path, self.device, self.precision, self._threads)

    def _finder(self, card: OnnxCard, persons: OnnxCard | PersonCard, path: Path) -> PersonFinder:
        if isinstance(persons, PersonCard):
            return SquareFinder(persons, path, self.precision, self._threads)
        return BoxFinder(self._network(persons, path), card.input.size_wh, card.input.padding)

    @property
    def _threads(self) -> int:
        return self.streams or usable_cores()


# distance of a person's middle from the centre of the region given for them, over its side
_IN_REGION = 0.35


@dataclass(frozen=True, eq=False)
class Observed:
    """One person as the network gives them, before any noise model.

    Attributes:
        keypoints: of one person, px of the network's input. input_from_img: (2, 3) affine map from raw px.
        height_px: of the crop that just holds the person, px of the input.
    """

    keypoints: Keypoints
    input_from_img: Array
    height_px: float


class _Networked(NetworkDetector):
    """What both kinds of a card's network have in common."""

    def __init__(self, network: OnnxNetwork, up_rad: Mapping[str, float]) -> None:
        super().__init__(network.card.skeleton, network.card.joint_centres_file, up_rad)
        self._network = network
        self._noise = read_noise(network.card.noise_file)

    @property
    def network(self) -> dict[str, str]:
        """Which network it is, where it runs, under which terms, and what was not fitted to it; for people."""
        card = self._network.card
        noise = None if card.noise_file else NOISE_NOT_FITTED
        centres = None if self.joint_centres else "keypoints as the network marks them, not joint centres"
        unknown = ", ".join(filter(None, (noise, centres)))
        return {
            "name": card.name,
            "sha256": card.sha256,
            "device": self._network.processor,
            "licence": card.licence,
            **({"unknown": unknown} if unknown else {}),
        }

    def _person(self, seen: Observed) -> DetectedPerson:
        """A person in raw px; no person where the keypoints score too little on average."""
        score = seen.keypoints.score[0]
        if score.mean() < self._network.card.least_keypoint_score:
            return DetectedPerson.missing(len(self.skeleton))
        features = keypoint_noise_features(seen.keypoints, seen.height_px)
        both = seen.height_px * self._noise.sigma(features, self.skeleton.keypoints)[0]
        # one number for both axes of the image: the crop may be turned
        sigma = np.sqrt((both**2).mean(-1) / abs(np.linalg.det(seen.input_from_img[:, :2])))
        xy = img_from_input(seen.input_from_img, seen.keypoints.xy[0])
        return DetectedPerson(xy, score, np.where(score > 0, sigma, np.nan))


class TopDownDetector(_Networked, CropDetector):
    """Crops of one person each through a keypoint network.

    Args:
        network: of layout simcc or heatmap. finder: finds people when no regions are given.
        up_rad: per camera, see `OnnxConfig`.
    """

    def __init__(self, network: OnnxNetwork, finder: PersonFinder, up_rad: Mapping[str, float]) -> None:
        super().__init__(network, up_rad)
        self._finder = finder

    def observed(self, frame: Frame, region: Region) -> Observed:
        """The person in a region, with all outputs of the network. Noise models are fitted to these."""
        return self._observe([(frame, region)])[0]

    def _look(self, crops: Sequence[tuple[Frame, Region]]) -> list[DetectedPerson]:
        return [self._person(seen) for seen in self._observe(crops)]

    def _observe(self, crops: Sequence[tuple[Frame, Region]]) -> list[Observed]:
        card = self._network.card
        affines = [input_crop_from_img(region, card.input.size_wh, card.decoding.udp) for _, region in crops]
        inputs = [warp_to_input(frame.image, affine, card.input) for (frame, _), affine in zip(crops, affines, strict=True)]
        height = float(card.input.size_wh[1])
        # crop by crop: what one takes stays in the processor's cache, and eight at once take three times as long
        return [
            Observed(keypoints_of(card, outputs), affine, height)
            for outputs, affine in zip(self._network(inputs), affines, strict=True)
        ]


class OneStageDetector(_Networked):
    """Whole images through a network that gives everybody at once; regions choose among the people it gives.

    Args:
        network: of layout rtmo or yolo_pose.
        up_rad: per camera, see `OnnxConfig`.
    """

    def _found(self, frames: Sequence[Frame]) -> list[list[DetectedPerson]]:
        return [people[:_MOST_PEOPLE] for people in self._everybody(frames)]

    def _given(self, asked: Sequence[tuple[Frame, Sequence[Region]]]) -> list[list[DetectedPerson]]:
        everybody = iter(self._everybody([frame for frame, regions in asked if regions]))
        return [self._chosen(next(everybody), regions) if regions else [] for _, regions in asked]

    def _everybody(self, frames: Sequence[Frame]) -> list[list[DetectedPerson]]:
        """Everybody in each image; a tilted camera's as it is where no person is found upright."""
        found: list[list[DetectedPerson]] = [[] for _ in frames]
        directions = [upright_first(self._up_rad.get(frame.camera, 0.0)) for frame in frames]
        for attempt in range(max(map(len, directions), default=0)):
            due = [i for i, people in enumerate(found) if not people and attempt < len(directions[i])]
            for i, people in zip(due, self._look([(frames[i], directions[i][attempt]) for i in due]), strict=True):
                found[i] = people
        return found

    def observed(self, frame: Frame, region: Region) -> Observed | None:
        """The same; the whole image is looked at, as in use. None for no person."""
        people = self._observe([(frame, 0.0)])[0]
        middles = [img_from_input(seen.input_from_img, np.nanmean(seen.keypoints.xy[0], axis=0)) for seen in people]
        place = nearest_to(region, np.array(middles), _IN_REGION)
        return None if place is None else people[place]

    def _look(self, images: Sequence[tuple[Frame, float]]) -> list[list[DetectedPerson]]:
        made = [[self._person(seen) for seen in people] for people in self._observe(images)]
        return [[person for person in people if person.score.any()] for people in made]

    def _observe(self, images: Sequence[tuple[Frame, float]]) -> list[list[Observed]]:
        return [self._split(people, affine) for people, affine in people_in_images(self._network, images)]

    def _split(self, people: People, input_from_img: Array) -> list[Observed]:
        seen = people.keypoints
        if seen is None:
            return []
        # sigma is given in shares of the crop that holds the person
        heights = self._network.card.input.padding * np.maximum(people.box[:, 3] - people.box[:, 1], 1.0)
        return [
            Observed(seen.only(i), input_from_img, h) for i, h in enumerate(heights.tolist()) if np.isfinite(seen.xy[i]).any()
        ]

    def _chosen(self, people: Sequence[DetectedPerson], regions: Sequence[Region]) -> list[DetectedPerson]:
        """For each region the person whose middle is nearest to its centre, no person where that is too far."""
        middles = np.array([np.nanmean(person.xy, axis=0) for person in people]).reshape(-1, 2)
        places = [nearest_to(region, middles, _IN_REGION) for region in regions]
        return [DetectedPerson.missing(len(self.skeleton)) if place is None else people[place] for place in places]
