"""COCO results JSON: one list of people, each with the number of its image."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from posefuse.core import InputError, Skeleton
from posefuse.core.arrays import Array

from .frames import UNTRACKED, ImagePeople, Pose2DFrames, frame_number, frames_of_images, in_coco17_order, points_of, read_json

# One list of people for all images: COCO results JSON, and AlphaPose's default form, which is like it.

# of COCO's annotations: 0 not labelled, 1 hidden, 2 visible; scores that half of a certain one is worth
_ANNOTATED_SCORE = {0.0: 0.0, 1.0: 0.5, 2.0: 1.0}


def is_results_list(content: Any) -> bool:
    """Whether content is a list of entries with an image and keypoints."""
    first = content[0] if isinstance(content, list) and content else None
    return isinstance(first, dict) and "image_id" in first and "keypoints" in first


def read_list(path: Path, camera: str, format: str, skeleton: Skeleton | None) -> Pose2DFrames:
    """Frames of the file of a results list, by the number in each image's name or by the image's number.

    Raises:
        InputError: an entry that is not of this form, or people of different keypoint sets.
    """
    content = read_json(path)
    people: list[ImagePeople] = []
    for i, entry in enumerate(content):
        where = f"{path}: entry {i}"
        try:
            image, flat = entry["image_id"], entry["keypoints"]
        except (KeyError, TypeError):
            raise InputError(f"{where}: expected image_id and keypoints") from None
        if not len(flat):
            continue
        number = image if isinstance(image, int) else frame_number(str(image).rpartition("/")[2], where)
        person = in_coco17_order(points_of(flat, where)), _track_id(entry.get("idx", entry.get("track_id")))
        people.append((number, where, [person]))
    _visibility_to_score([points for *_, [(points, _)] in people])
    return frames_of_images(path, camera, format, skeleton, people, searched=f"{len(content)} entries")


def _visibility_to_score(people: Sequence[Array]) -> None:
    """Annotations have 0, 1 or 2 instead of a score; recognised by the absence of other values and at least one 2."""
    scores = np.concatenate([[], *(person[:, 2] for person in people)])
    if np.isin(scores, list(_ANNOTATED_SCORE)).all() and (scores == 2).any():
        for person in people:
            person[:, 2] = np.select([person[:, 2] == v for v in _ANNOTATED_SCORE], list(_ANNOTATED_SCORE.values()))


def _track_id(value: Any) -> int:
    """AlphaPose writes a number, or a list of one."""
    while isinstance(value, list) and value:
        value = value[0]
    return int(value) if isinstance(value, int | float) else UNTRACKED


NAME = "coco"
LOOKS_FOR = "a JSON list with image_id and keypoints"


def fits(path: Path) -> bool:
    """Whether this is a JSON file with a list of image_id, category_id and keypoints."""
    return path.is_file() and path.suffix == ".json" and is_results_list(read_json(path))


def read(path: Path, camera: str, skeleton: Skeleton | None = None) -> Pose2DFrames:
    """Frames numbered by image_id; raises InputError for another form."""
    return read_list(path, camera, NAME, skeleton)
