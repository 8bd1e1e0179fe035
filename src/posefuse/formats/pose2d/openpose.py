"""OpenPose JSON, also as Pose2Sim writes it: a folder with one file per frame."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from posefuse.core import SKELETONS, InputError, Skeleton
from posefuse.core.arrays import Array
from posefuse.foundation.parsing import short

from .frames import (
    BODY_POINTS,
    UNTRACKED,
    People2D,
    Pose2DFrames,
    check_distance,
    frame_number,
    in_coco17_order,
    read_json,
    skeleton_of_count,
)

NAME = "openpose"
LOOKS_FOR = "a folder of JSON files with people[].pose_keypoints_2d (OpenPose, Pose2Sim)"
# of a person's size in the image: mid_hip is nearer to the middle of the hips, an elbow farther from what BODY_25B has there
_MOST_OFFSET = 0.08
_ENOUGH_PEOPLE = 200


def fits(path: Path) -> bool:
    """Whether this is a folder whose first JSON file has OpenPose's ``people``."""
    first = next(iter(sorted(path.glob("*.json"))), None) if path.is_dir() else None
    if first is None:
        return False
    content = read_json(first)
    return isinstance(content, dict) and isinstance(content.get("people"), list)


def read_openpose_folder(folder: Path, camera: str, skeleton: Skeleton | None = None) -> Pose2DFrames:
    """Understand a folder of OpenPose JSON files.

    A person without keypoints (an empty list) is dropped.

    Args:
        folder: with one .json per frame; the last number in a file's name (``cam01_000000000042_keypoints``) is the frame's.
        camera: name in the rig.
        skeleton: order of the keypoints; None: recognised by their number in the first person found
            (25 is ``body_25`` or ``body_25b`` by which midpoint lies where it belongs).

    Raises:
        InputError: no such folder, no files, a name without a number or two with the same, no person in any file.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: camera {camera}: no such folder of OpenPose JSON")
    paths = sorted(folder.glob("*.json"))
    if not paths:
        raise InputError(f"{folder}: camera {camera}: expected one .json per frame, got none")
    numbered = sorted((frame_number(path.stem, str(path)), path) for path in paths)
    for (number, path), (following, other) in itertools.pairwise(numbered):
        if number == following:
            raise InputError(f"{other}: same frame number {number} as {path.name}")
    numbers, ordered = zip(*numbered, strict=True)
    chosen = skeleton or _skeleton_of(folder, camera, ordered)
    return Pose2DFrames(camera, NAME, chosen, numbers, lambda place: _people(ordered[place], chosen))


read = read_openpose_folder


def body_order(folders: Iterable[Path]) -> Skeleton | None:
    """BODY_25 or BODY_25B, from the people of all cameras together; None where no folder has people of 25 keypoints and hips."""
    offsets = [offset for folder in folders for offset in _hip_offsets(sorted(folder.glob("*.json")))]
    return SKELETONS["body_25b" if np.median(offsets) > _MOST_OFFSET else "body_25"] if offsets else None


def _skeleton_of(folder: Path, camera: str, paths: tuple[Path, ...]) -> Skeleton:
    first = next((len(person) for path in paths for person in _read(path)), 0)
    order = body_order([folder]) if first in (0, BODY_POINTS) else skeleton_of_count(first, str(folder))
    if order is None:
        raise InputError(
            f"{folder}: camera {camera}: no person with hips in any of {len(paths)} files: the order of keypoints is unknown"
        )
    return order


def _hip_offsets(paths: Sequence[Path]) -> list[float]:
    """How far point 8 is from the middle of points 9 and 12, as a share of the person's size: 0 where 8 is BODY_25's mid_hip.

    In BODY_25B the three are the right elbow, the left wrist and the right hip. Seen from the side, hips are at one place, so
    their distance does not show the size.
    """
    offsets: list[float] = []
    for path, person in ((file, person) for file in paths for person in _read(file)):
        if len(person) != BODY_POINTS or len(offsets) >= _ENOUGH_PEOPLE:
            break
        check_distance(person, str(path))
        if (person[[8, 9, 12], 2] > 0).all():
            point, right, left = person[[8, 9, 12], :2]
            size = float(np.linalg.norm(np.ptp(person[person[:, 2] > 0, :2], axis=0)))
            offsets.append(float(np.linalg.norm(point - (right + left) / 2)) / max(size, 1.0))
    return offsets


def _read(path: Path) -> list[Array]:
    """Keypoints (K, 3) x, y, score of each person in a file who has any; raises InputError for another form."""
    try:
        lists = [person["pose_keypoints_2d"] for person in read_json(path)["people"]]
        return [np.array(points, np.float64).reshape(-1, 3) for points in lists if len(points)]
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise InputError(
            f"{path}: not OpenPose JSON: expected people[].pose_keypoints_2d of x, y, score triples ({short(error)})"
        ) from None


def _people(path: Path, skeleton: Skeleton) -> People2D:
    people = [in_coco17_order(person) if skeleton.name == "coco17" else person for person in _read(path)]
    for person in people:
        if len(person) != len(skeleton):
            raise InputError(f"{path}: expected {len(skeleton)} keypoints ({skeleton.name}), got a person with {len(person)}")
    return People2D.of([(person, UNTRACKED) for person in people], len(skeleton))
