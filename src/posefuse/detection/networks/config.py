"""The plug-in ``onnx``: a user's network by its model card."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import field
from pathlib import Path
from typing import Annotated

from annotated_types import Ge, Gt

from posefuse.core import ConfigError
from posefuse.detection.blazepose.persons import PersonNetwork
from posefuse.detection.models import fetch_all, read_card
from posefuse.detection.openvino_cpu import Precision
from posefuse.foundation.places import default_cache_dir
from posefuse.foundation.platform import usable_cores
from posefuse.foundation.settings import settings

from .card import ONE_STAGE, PERSONS, TOP_DOWN, NetworkCard, read_network_card
from .detector import OneStageDetector, TopDownDetector
from .people import BoxFinder, PersonFinder, SquareFinder
from .runtime import DEFAULT_PROVIDERS, Engine, OnnxNetwork


@settings
class OnnxConfig:
    """A user's network by its model card.

    Attributes:
        card: TOML file that describes it, see docs/networks.md.
        engine: what runs it: ``openvino``, or ``onnxruntime`` (the extra ``onnx``).
        providers: execution providers of ONNX Runtime, best first, e.g. ``CUDAExecutionProvider``.
        precision: of OpenVINO; ``auto`` is bf16 where the CPU computes it natively.
        streams: images worked on at once; 0: one per core.
        most_people: people looked for per image when no regions are given.
        cache: where that detector is kept; None: the user's cache folder.
        up_rad: per camera, direction of gravity's up in its image, clockwise from the image's up
            (`up_angle_rad` of a calibrated camera); cameras not named are taken as upright.
    """

    card: Path
    engine: Engine = "openvino"
    providers: tuple[str, ...] = DEFAULT_PROVIDERS
    precision: Precision = "auto"
    streams: Annotated[int, Ge(0)] = 0
    most_people: Annotated[int, Gt(0)] = 4
    cache: Path | None = None
    up_rad: dict[str, float] = field(default_factory=dict)

    def fetch(
        self, progress: Callable[[str], None] | None = None, advance: Callable[[int, int], None] | None = None
    ) -> list[Path]:
        """The default person detector's file where the card needs it; see `fetch_all`. Networks of cards are never fetched."""
        card = read_network_card(self.card)
        if card.kind not in TOP_DOWN or card.persons_card is not None:
            return []
        return fetch_all([read_card(card.persons)], self.cache or default_cache_dir(), None, progress, advance)

    def build(self) -> TopDownDetector | OneStageDetector:
        """Read the card, check and compile its files.

        Raises:
            ConfigError: an invalid card. ModelError: a network that is missing or differs from its card.
            DependencyError: ONNX Runtime is asked for and not installed.
        """
        card = read_network_card(self.card)
        if card.kind in PERSONS:
            raise ConfigError(f"{self.card}: layout {card.kind} finds people only; name it as `persons` in a card of keypoints")
        network = self._network(card)
        if card.kind in ONE_STAGE:
            return OneStageDetector(network, self.most_people, self.up_rad)
        return TopDownDetector(network, self._finder(card), self.most_people, self.up_rad)

    def _network(self, card: NetworkCard) -> OnnxNetwork:
        return OnnxNetwork(card, self.engine, self.precision, self.providers, self._threads)

    def _finder(self, card: NetworkCard) -> PersonFinder:
        path = card.persons_card
        if path is None:
            persons = read_card(card.persons)
            return SquareFinder(PersonNetwork.compiled(persons, self.fetch()[0], self.precision, self._threads))
        finder = read_network_card(path)
        if finder.kind not in PERSONS:
            kinds = " or ".join(PERSONS)
            raise ConfigError(f"{self.card}: persons: expected a card of layout {kinds}, got {path} of layout {finder.kind}")
        return BoxFinder(self._network(finder), card.input.size_wh, card.input.padding)

    @property
    def _threads(self) -> int:
        return self.streams or usable_cores()
