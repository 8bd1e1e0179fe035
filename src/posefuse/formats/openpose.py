"""2D poses other people's tools have written: folders of OpenPose JSON, one file per frame.

BODY_25, BODY_25B, COCO-17 and the 18-point COCO order of OpenPose and AlphaPose are told apart by their length; 18 points are
reordered to COCO-17 (the neck, a midpoint, is dropped).
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from posefuse.core import SKELETONS, Detections2D, InputError, Skeleton
from posefuse.core.arrays import Array
from posefuse.foundation.parsing import parse_json, read_text, short

# OpenPose's COCO order: nose, neck, right arm, left arm, right leg, left leg, eyes, ears; places of COCO-17's keypoints in it
_COCO17_IN_COCO18 = (0, 15, 14, 17, 16, 5, 2, 6, 3, 7, 4, 11, 8, 12, 9, 13, 10)
_COCO18 = 18
_BODY = 25
# mid_hip lies within a quarter of the hips' distance of their middle, however the person stands
_HIP_SHARE = 4.0
_POINT = 3
# people whose hips are looked at to tell BODY_25 from BODY_25B; more of them tell no more
_ENOUGH_PEOPLE = 200
# no image has so many pixels across; larger numbers are damage, and their squares overflow
_FARTHEST_PX = 1e6
# a keypoint's noise grows with the person's size in the image: this part of the box diagonal at score 1, as 1 / score below
_SIGMA_OF_DIAGONAL = 0.006
_LEAST_SIGMA_PX = 0.5


@dataclass(frozen=True)
class OpenPoseFolder:
    """One camera's files, read when asked for.

    Attributes:
        camera: its name in the rig. skeleton: of all files.
        paths: one file per frame, by number.
        numbers: the number in each file's name, strictly increasing.
    """

    camera: str
    skeleton: Skeleton
    paths: tuple[Path, ...]
    numbers: tuple[int, ...]

    def __len__(self) -> int:
        return len(self.paths)

    @cached_property
    def _place(self) -> dict[int, int]:
        return {number: i for i, number in enumerate(self.numbers)}

    def frame(self, number: int, t_ns: int) -> Detections2D:
        """Everybody in the file of this frame number, stamped t_ns; nobody where there is no such file.

        Raises:
            InputError: a file that cannot be read, or is not what the others are.
        """
        place = self._place.get(number)
        if place is None:
            return Detections2D.nobody(self.camera, t_ns, self.skeleton)
        return _detections(self.camera, t_ns, self.skeleton, _read(self.paths[place]), self.paths[place])

    def frames(self, rate_hz: float) -> Iterator[Detections2D]:
        """All files in order, each stamped with its number at this rate."""
        for number in self.numbers:
            yield self.frame(number, round(number * 1e9 / rate_hz))


def read_openpose_folder(folder: Path, camera: str, skeleton: Skeleton | None = None) -> OpenPoseFolder:
    """Understand a folder of OpenPose JSON files.

    Args:
        folder: with one .json per frame; the last number in a file's name (``cam01_000000000042_keypoints``) is the frame's.
        camera: name in the rig.
        skeleton: order of the keypoints; None: told by their number from the first person found
            (25 is ``body_25`` or ``body_25b`` by which midpoint lies where it belongs).

    Raises:
        InputError: no such folder, no files, a name without a number or two with the same, no person in any file.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: camera {camera}: no such folder of OpenPose JSON")
    paths = sorted(folder.glob("*.json"))
    if not paths:
        raise InputError(f"{folder}: camera {camera}: expected one .json per frame, got none")
    numbered = sorted((_number(path), path) for path in paths)
    for (number, path), (following, other) in itertools.pairwise(numbered):
        if number == following:
            raise InputError(f"{other}: same frame number {number} as {path.name}")
    numbers, ordered = zip(*numbered, strict=True)
    return OpenPoseFolder(camera, skeleton or _told_skeleton(folder, camera, ordered), ordered, numbers)


def _number(path: Path) -> int:
    numbers = re.findall(r"\d+", path.stem)
    if not numbers:
        raise InputError(f"{path}: expected a frame number in the file's name, got none")
    return int(numbers[-1])


def _told_skeleton(folder: Path, camera: str, paths: tuple[Path, ...]) -> Skeleton:
    offsets: list[float] = []
    for path, person in ((file, person) for file in paths for person in _read(file)):
        if len(person) in (len(_COCO17_IN_COCO18), _COCO18):
            return SKELETONS["coco17"]
        if len(person) != _BODY:
            raise InputError(f"{path}: expected people of 17, 18 or 25 keypoints, got {len(person)}")
        offsets.extend(_hip_offset(person))
        if len(offsets) >= _ENOUGH_PEOPLE:
            break
    if not offsets:
        raise InputError(
            f"{folder}: camera {camera}: no person with hips in any of {len(paths)} files: the order of keypoints is unknown"
        )
    return SKELETONS["body_25b" if np.median(offsets) > 1 else "body_25"]


def _hip_offset(person: Array) -> list[float]:
    """How far point 8 is from the middle of points 9 and 12, by their distance: 0 where 8 is BODY_25's mid_hip.

    In BODY_25B the three are the right elbow, the left wrist and the right hip.
    """
    if not (person[[8, 9, 12], 2] > 0).all():
        return []
    point, right, left = person[[8, 9, 12], :2]
    across = max(float(np.linalg.norm(right - left)), 1.0)
    return [float(np.linalg.norm(point - (right + left) / 2)) / across * _HIP_SHARE]


def _read(path: Path) -> list[Array]:
    """Keypoints (K, 3) x, y, score of each person in a file."""
    content = parse_json(str(path), read_text(path))
    try:
        people = [np.array(person["pose_keypoints_2d"], np.float64).reshape(-1, _POINT) for person in content["people"]]
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise InputError(
            f"{path}: not OpenPose JSON: expected people[].pose_keypoints_2d of x, y, score triples ({short(error)})"
        ) from None
    far = next((float(x) for person in people for x in person[:, :2].flat if abs(x) > _FARTHEST_PX), None)
    if far is not None:
        raise InputError(f"{path}: expected keypoints within {_FARTHEST_PX:g} px of the image, got {far:.3g}")
    return people


def _detections(camera: str, t_ns: int, skeleton: Skeleton, people: list[Array], path: Path) -> Detections2D:
    if not people:
        return Detections2D.nobody(camera, t_ns, skeleton)
    for i, person in enumerate(people):
        if len(person) == _COCO18 and len(skeleton) == len(_COCO17_IN_COCO18):
            people[i] = person[list(_COCO17_IN_COCO18)]
        elif len(person) != len(skeleton):
            raise InputError(f"{path}: expected {len(skeleton)} keypoints ({skeleton.name}), got a person with {len(person)}")
    points = np.stack(people)
    score = np.clip(np.nan_to_num(points[..., 2]), 0, 1)
    xy = np.where(score[..., None] > 0, points[..., :2], np.nan)
    score = np.where(np.isfinite(xy).all(-1), score, 0.0)
    kept = (score > 0).any(-1)
    if not kept.any():
        return Detections2D.nobody(camera, t_ns, skeleton)
    xy, score = xy[kept], score[kept]
    box = np.concatenate([np.nanmin(xy, axis=1), np.nanmax(xy, axis=1)], axis=-1)
    return Detections2D(
        camera=camera, t_ns=t_ns, skeleton=skeleton, xy_img=xy, score=score, sigma_px=_sigma_px(score, box), box_img=box
    )


def _sigma_px(score: Array, box_img: Array) -> Array:
    """(P, K) noise where nothing but a score is known: a part of the person's size at score 1, growing as 1 / score."""
    diagonal = np.linalg.norm(box_img[:, 2:] - box_img[:, :2], axis=-1)
    at_best = np.maximum(_SIGMA_OF_DIAGONAL * diagonal, _LEAST_SIGMA_PX)
    with np.errstate(divide="ignore"):
        return np.where(score > 0, at_best[:, None] / score, np.nan)
