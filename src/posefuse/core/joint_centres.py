"""How far anatomical joint centres lie from the keypoints that a detector marks."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from .arrays import Array, frozen
from .errors import ConfigError, ShapeError, choices
from .skeleton import LIMB_ENDS

# joint (without its side) -> directions it may be moved along, see `tracking.body_directions`
JOINT_DIRECTIONS = {
    "shoulder": ("forward", "up", "outward", "arm", "raising"),
    "elbow": ("upper_arm", "forearm", "bend", "lowering"),
    "wrist": ("forearm", "hand", "palm"),
    "hip": ("forward", "up", "outward", "thigh", "sinking"),
    "knee": ("thigh", "bend", "outward", "forward"),
    "ankle": ("shank", "foot", "outward", "forward"),
    "ear": ("face", "crown", "outward"),
    "nose": ("face", "crown"),
}
# segment -> the keypoints at its ends
SEGMENT_ENDS = {
    **{segment: (f"{{side}}_{upper}", f"{{side}}_{lower}") for segment, (upper, lower) in LIMB_ENDS.items()},
    "shoulders": ("left_shoulder", "right_shoulder"),
    "hips": ("left_hip", "right_hip"),
    "trunk": ("mid_hip", "neck"),
}
_DIRECTIONS = tuple((joint, name) for joint, names in JOINT_DIRECTIONS.items() for name in names)


@dataclass(frozen=True, eq=False, kw_only=True)
class LengthPrior:
    """What is known of people's segments before a person is seen.

    Attributes:
        names: of (S) segments: upper_arm, forearm, thigh, shank, shoulders, hips, trunk, in any order.
        mean_m, cov_m2: (S,) and (S, S).
    """

    names: tuple[str, ...]
    mean_m: Array
    cov_m2: Array


@dataclass(frozen=True, kw_only=True)
class JointCentres:
    """Offsets from a detector's keypoints to joint centres, along directions of the body itself.

    Attributes:
        made_by: for people: whose keypoints these are (network or keypoint set), and what the offsets were fitted to.
        offsets: joint of `JOINT_DIRECTIONS` -> direction -> metres; what is left out is not moved.
        lengths: segment of `SEGMENT_ENDS` -> metres between joint centres, of the people of the fit on average.
        by_length: joint -> direction -> segment -> metres more per metre that the person's segment is longer than that.

    Raises:
        ConfigError: a joint, direction or segment that does not exist. ShapeError: no finite number of metres.
    """

    made_by: str
    offsets: Mapping[str, Mapping[str, float]]
    lengths: Mapping[str, float] = field(default_factory=dict)
    by_length: Mapping[str, Mapping[str, Mapping[str, float]]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        _check_names("lengths", "segment", self.lengths, SEGMENT_ENDS)
        for part, joints in (("offsets", self.offsets), ("by_length", self.by_length)):
            _check_names(part, "joint", joints, JOINT_DIRECTIONS)
            for joint, along in joints.items():
                _check_names(f"{part}.{joint}", "direction", along, JOINT_DIRECTIONS[joint])
        for joint, slopes in self.by_length.items():
            for direction, segments in slopes.items():
                _check_names(f"by_length.{joint}.{direction}", "segment", segments, self.lengths)
        known = np.array([segment in self.lengths for segment in SEGMENT_ENDS])
        for name, values in (("offsets", self.metres), ("lengths", self.usual[known]), ("by_length", self.slopes)):
            if not np.isfinite(values).all():
                raise ShapeError(f"JointCentres.{name}: expected finite numbers")

    @cached_property
    def metres(self) -> Array:
        """(D,) offset along each of the directions of `JOINT_DIRECTIONS` in a row."""
        return frozen([self.offsets.get(joint, {}).get(name, 0.0) for joint, name in _DIRECTIONS], np.float64, "offsets")

    @cached_property
    def usual(self) -> Array:
        """(S,) `lengths` in the order of `SEGMENT_ENDS`; NaN where unknown."""
        return frozen([self.lengths.get(segment, np.nan) for segment in SEGMENT_ENDS], np.float64, "lengths")

    @cached_property
    def slopes(self) -> Array:
        """(D, S) `by_length` in these orders."""
        known = [self.by_length.get(joint, {}).get(name, {}) for joint, name in _DIRECTIONS]
        return frozen([[one.get(segment, 0.0) for segment in SEGMENT_ENDS] for one in known], np.float64, "by_length")


def _check_names(where: str, what: str, got: Iterable[str], known: Iterable[str]) -> None:
    for name in got:
        if name not in known:
            raise ConfigError(f"{where}: no {what} {name!r}; there are: {choices(known)}")
