"""What all detectors by networks have in common: people in regions that are given, or all who are found in whole images."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from posefuse.core import Detections2D, Frame, Region, Skeleton
from posefuse.core.arrays import Array
from posefuse.formats.joint_centres import read_joint_centres

from .crops import check_regions


@dataclass(frozen=True, eq=False)
class DetectedPerson:
    """One person in raw px: keypoints (K, 2), scores (K,), standard deviations (K,)."""

    xy: Array
    score: Array
    sigma_px: Array

    @staticmethod
    def missing(count: int) -> DetectedPerson:
        """No person, of so many keypoints."""
        return DetectedPerson(np.full((count, 2), np.nan), np.zeros(count), np.full(count, np.nan))


class NetworkDetector(ABC):
    """Implements `core.Detector` but for `_found` and `_given`. Not for use from several threads at once; build one for each.

    Attributes:
        skeleton: the network's keypoints. joint_centres: the table that was fitted to it, if there is one.
    """

    def __init__(self, skeleton: Skeleton, table: Path | None) -> None:
        self.skeleton, self.joint_centres = skeleton, read_joint_centres(table) if table else None

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
