"""What every reader of 2D poses gives: one camera's frames by number, each with everybody in it, of a known keypoint set.

Which set it is shows in how many points there are, or in what they are called.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from posefuse.core import SKELETONS, Detections2D, InputError, Skeleton
from posefuse.core.arrays import Array
from posefuse.core.errors import choices
from posefuse.core.values import NO_TRACK, keypoint_boxes
from posefuse.foundation.parsing import parse_json, read_text

# OpenPose's COCO order: nose, neck, right arm, left arm, right leg, left leg, eyes, ears; places of COCO-17's keypoints in it
_COCO17_IN_COCO18 = (0, 15, 14, 17, 16, 5, 2, 6, 3, 7, 4, 11, 8, 12, 9, 13, 10)
_COCO18 = 18
# of BODY_25 and BODY_25B alike
BODY_POINTS = 25
COUNTS = {
    17: "coco17",
    18: "coco17",
    23: "anatomical23",
    25: "body_25",
    26: "halpe_26",
    33: "blazepose33",
    52: "synthpose_52",
    133: "coco_wholebody_133",
    136: "halpe_136",
}
_SIDES = {"l": "left", "left": "left", "r": "right", "right": "right"}
_NAMES = {
    "foot_index": "foot_index",
    "toe": "big_toe",
    "bigtoe": "big_toe",
    "smalltoe": "small_toe",
    "little_toe": "small_toe",
    "pelvis": "mid_hip",
    "midhip": "mid_hip",
    "hip_center": "mid_hip",
    "root": "mid_hip",
    "head_top": "head",
}


def skeleton_of_count(count: int, where: str) -> Skeleton:
    """The keypoint set of so many points; raises InputError for a number no set has."""
    if count not in COUNTS:
        known = ", ".join(str(number) for number in COUNTS)
        raise InputError(f"{where}: expected people of {known} keypoints, got {count}")
    return SKELETONS[COUNTS[count]]


def agreed_skeleton(skeleton: Skeleton | None, count: int, where: str) -> Skeleton:
    """The keypoint set of the people so far, or None, and of one more with so many points; raises InputError if they differ."""
    skeleton = skeleton or skeleton_of_count(count, where)
    if count != len(skeleton):
        raise InputError(f"{where}: expected {len(skeleton)} keypoints ({skeleton.name}), got {count}")
    return skeleton


def in_coco17_order(points: Array) -> Array:
    """COCO-17's points of OpenPose's 18 (the neck, a midpoint, is dropped); others as they are."""
    return points[list(_COCO17_IN_COCO18)] if len(points) == _COCO18 else points


def skeleton_of_names(names: Sequence[str], tool: str, where: str) -> Skeleton:
    """A keypoint set of named points, which bear our names where they can be recognised.

    One of `SKELETONS` where all names are its own; else one called after the tool with the bones known of any set.

    Raises:
        InputError: two points with the same name.
    """
    ours = tuple(keypoint_name(name) for name in names)
    if len(set(ours)) != len(ours):
        twice = next(name for name in ours if ours.count(name) > 1)
        given = [name for name, own in zip(names, ours, strict=True) if own == twice]
        raise InputError(f"{where}: expected every keypoint once, got {choices(given)}, all of which mean {twice}")
    for skeleton in SKELETONS.values():
        if skeleton.keypoints == ours:
            return skeleton
    bones = dict.fromkeys(bone for skeleton in SKELETONS.values() for bone in skeleton.bones)
    return Skeleton(tool, ours, tuple(bone for bone in bones if bone[0] in ours and bone[1] in ours))


def keypoint_name(name: str) -> str:
    """``RKnee``, ``knee_r``, ``Right Knee`` and ``RIGHT_KNEE`` are ``right_knee``."""
    split = re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", "_", name)
    words = [word for word in re.split(r"[^A-Za-z0-9]+", split.lower()) if word]
    # "leftknee": the side is not set apart
    if words and words[0] not in _SIDES:
        for side in ("left", "right"):
            if words[0].startswith(side):
                words = [side, words[0].removeprefix(side), *words[1:]]
                break
    side = next((_SIDES[word] for word in words if word in _SIDES), "")
    rest = "_".join(word for word in words if word not in _SIDES)
    rest = _NAMES.get(rest, rest)
    return f"{side}_{rest}" if side and rest else rest or name


def points_of(row: Sequence[float] | Array, where: str) -> Array:
    """(K, 3) of a flat list x, y, score, x, y, score ...; raises InputError for a list of another length."""
    flat = np.asarray(row, np.float64).ravel()
    if not len(flat) or len(flat) % 3:
        raise InputError(f"{where}: expected keypoints as x, y, score triples, got {len(flat)} numbers")
    return flat.reshape(-1, 3)


# a keypoint's noise grows with the person's size in the image: this part of the box diagonal at score 1, as 1 / score below
_SIGMA_OF_DIAGONAL = 0.006
_LEAST_SIGMA_PX = 0.5
# no image has so many pixels across; larger numbers are damage, and their squares overflow
_FARTHEST_PX = 1e6
# in one image; more are damage, too
_MOST_PEOPLE = 1000
UNTRACKED = NO_TRACK
# of an image: its number, a name for messages, and its people as points (K, 3) and track id
ImagePeople = tuple[int, str, Sequence[tuple[Array, int]]]


@dataclass(frozen=True, eq=False)
class People2D:
    """Everybody in one image.

    Attributes:
        points: (P, K, 3) x, y in raw px and score; score 0 or NaN where a keypoint is missing.
        track_id: (P,) number the other tool tracks each person by; `UNTRACKED` where it has none.
    """

    points: Array
    track_id: Array

    @staticmethod
    def of(people: Sequence[tuple[Array, int]], count: int) -> People2D:
        """People by their points (K, 3) and track id; `count` is K, for when there are none."""
        points, ids = [points for points, _ in people], [track_id for _, track_id in people]
        return People2D(np.array(points, np.float64).reshape(len(people), count, 3), np.array(ids, np.int64))


@dataclass(frozen=True, eq=False)
class Pose2DFrames:
    """One camera's 2D poses, read when asked for.

    Attributes:
        camera: its name in the rig. format: the reader's name.
        skeleton: of all frames.
        numbers: frame numbers that are there, strictly increasing.
        people: place in `numbers` -> everybody in that frame; may raise InputError.
    """

    camera: str
    format: str
    skeleton: Skeleton
    numbers: tuple[int, ...]
    people: Callable[[int], People2D]

    def __len__(self) -> int:
        return len(self.numbers)

    @cached_property
    def _place(self) -> dict[int, int]:
        return {number: i for i, number in enumerate(self.numbers)}

    def frame(self, number: int, t_ns: int) -> Detections2D:
        """All people in the frame of this number, stamped t_ns; no person if the frame does not exist.

        Raises:
            InputError: a file that cannot be read, or is not what the others are.
        """
        place = self._place.get(number)
        if place is None:
            return Detections2D.empty(self.camera, t_ns, self.skeleton)
        people = self.people(place)
        points, where = people.points, f"camera {self.camera}: 2D poses of frame {number}"
        if len(points) > _MOST_PEOPLE:
            raise InputError(f"{where}: expected at most {_MOST_PEOPLE} people, got {len(points)}")
        check_distance(points, where)
        everybody = _detections(self.camera, t_ns, self.skeleton, people)
        return everybody.people(np.flatnonzero((everybody.score > 0).any(-1)))

    def frames(self, rate_hz: float) -> Iterator[Detections2D]:
        """All frames in order, each stamped with its number at this rate."""
        for number in self.numbers:
            yield self.frame(number, round(number * 1e9 / rate_hz))


def frames_from_mapping(camera: str, format: str, skeleton: Skeleton, people: Mapping[int, People2D]) -> Pose2DFrames:
    """Frames that are in memory already, by number."""
    numbers = tuple(sorted(people))
    return Pose2DFrames(camera, format, skeleton, numbers, lambda place: people[numbers[place]])


def frames_of_images(
    path: Path, camera: str, format: str, skeleton: Skeleton | None, images: Iterable[ImagePeople], *, searched: str
) -> Pose2DFrames:
    """Frames of the people of each image.

    Raises:
        InputError: people of different keypoint sets, or no person at all in what was `searched`.
    """
    people: dict[int, list[tuple[Array, int]]] = defaultdict(list)
    for number, image, found in images:
        people[number] += found
        for points, _ in found:
            skeleton = agreed_skeleton(skeleton, len(points), image)
    if skeleton is None:
        raise InputError(f"{path}: camera {camera}: no person in any of {searched}")
    made = {number: People2D.of(found, len(skeleton)) for number, found in people.items()}
    return frames_from_mapping(camera, format, skeleton, made)


def read_json(path: Path) -> Any:
    """A JSON file's content, not to be changed; raises InputError in one line for one that cannot be read."""
    try:
        state = path.stat()
    except OSError:  # `read_text` words it
        return parse_json(str(path), read_text(path))
    return parsed_json(path, state.st_mtime_ns, state.st_size)


@lru_cache(maxsize=1)
def parsed_json(path: Path, modified_ns: int, size: int) -> Any:
    """The content of a file in this state: every format that may fit looks at it before one reads it."""
    return parse_json(str(path), read_text(path))


def check_distance(points: Array, where: str) -> None:
    """Raise InputError where a keypoint of (..., K, 3) points is farther from the image than any can be."""
    far = points[..., :2][np.abs(np.nan_to_num(points[..., :2], posinf=np.inf)) > _FARTHEST_PX]
    if len(far):
        raise InputError(f"{where}: expected keypoints within {_FARTHEST_PX:g} px of the image, got {far[0]:.3g}")


def frame_number(name: str, where: str) -> int:
    """The last number in a file's or image's name: ``cam01_000000000042_keypoints`` is frame 42."""
    numbers = re.findall(r"\d+", name)
    if not numbers:
        raise InputError(f"{where}: expected a frame number in the name {name!r}, got none")
    return int(numbers[-1])


def _detections(camera: str, t_ns: int, skeleton: Skeleton, people: People2D) -> Detections2D:
    xy = people.points[..., :2]
    score = np.where(np.isfinite(xy).all(-1), np.clip(np.nan_to_num(people.points[..., 2]), 0, 1), 0.0)
    xy = np.where(score[..., None] > 0, xy, np.nan)
    sigma_px = _sigma_px(score, keypoint_boxes(xy, score))
    return replace(Detections2D.of(camera, t_ns, skeleton, xy, score, sigma_px), track_id=people.track_id)


def _sigma_px(score: Array, box_img: Array) -> Array:
    """(P, K) noise where nothing but a score is known: a part of the person's size at score 1, growing as 1 / score."""
    diagonal = np.linalg.norm(box_img[:, 2:] - box_img[:, :2], axis=-1)
    at_best = np.maximum(_SIGMA_OF_DIAGONAL * diagonal, _LEAST_SIGMA_PX)
    with np.errstate(divide="ignore"):
        return np.where(score > 0, at_best[:, None] / score, np.nan)
