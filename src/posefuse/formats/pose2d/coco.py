"""One list of people for all images, each with its image: COCO results JSON, and AlphaPose's ``alphapose-results.json``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from posefuse.core import InputError, Skeleton

from .frames import UNTRACKED, ImagePeople, Pose2DFrames, frame_number, frames_of_images, in_coco17_order, points_of, read_json

NAME = "coco"
LOOKS_FOR = "a JSON list with image_id and keypoints (COCO results; AlphaPose in its usual form)"
_ALPHAPOSE_FILE = "alphapose-results.json"


def fits(path: Path) -> bool:
    """Whether this is a JSON file with a list of entries with an image and keypoints, or AlphaPose's folder with such a file."""
    file = _file(path)
    content = read_json(file) if file.is_file() and file.suffix == ".json" else None
    first = content[0] if isinstance(content, list) and content else None
    return isinstance(first, dict) and "image_id" in first and "keypoints" in first


def read(path: Path, camera: str, skeleton: Skeleton | None = None) -> Pose2DFrames:
    """Frames by the number in each image's name or by the image's number, with the ids of a tracker.

    Raises:
        InputError: an entry that is not of this form, or people of different keypoint sets.
    """
    file = _file(path)
    content = read_json(file)
    people: list[ImagePeople] = []
    for i, entry in enumerate(content):
        where = f"{file}: entry {i}"
        try:
            image, flat = entry["image_id"], entry["keypoints"]
        except (KeyError, TypeError):
            raise InputError(f"{where}: expected image_id and keypoints") from None
        if not len(flat):
            continue
        number = image if isinstance(image, int) else frame_number(str(image).rpartition("/")[2], where)
        person = in_coco17_order(points_of(flat, where)), _track_id(entry.get("idx", entry.get("track_id")))
        people.append((number, where, [person]))
    return frames_of_images(file, camera, NAME, skeleton, people, searched=f"{len(content)} entries")


def _file(path: Path) -> Path:
    return path / _ALPHAPOSE_FILE if path.is_dir() else path


def _track_id(value: Any) -> int:
    """AlphaPose writes a number, or a list of one."""
    while isinstance(value, list) and value:
        value = value[0]
    return int(value) if isinstance(value, int | float) else UNTRACKED
