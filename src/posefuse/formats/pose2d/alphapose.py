"""AlphaPose JSON in its three forms: a list of people, or per image OpenPose's (``open``) or CMU's (``cmu``) lists of bodies."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from posefuse.core import InputError, Skeleton
from posefuse.core.arrays import Array

from .coco import is_results_list, read_list
from .frames import UNTRACKED, Pose2DFrames, frame_number, frames_of_images, in_coco17_order, points_of, read_json
from .openpose import keypoints_of_people

NAME = "alphapose"
LOOKS_FOR = "alphapose-results.json, or a JSON list with idx or image names"
RESULTS_FILE = "alphapose-results.json"


def fits(path: Path) -> bool:
    """Whether this is AlphaPose's results file, or a folder that holds it."""
    file = _file(path)
    if file is None:
        return False
    content = read_json(file)
    if is_results_list(content):
        return file.name == RESULTS_FILE or "idx" in content[0] or isinstance(content[0]["image_id"], str)
    return _by_image(content)


def read(path: Path, camera: str, skeleton: Skeleton | None = None) -> Pose2DFrames:
    """Frames by the number in each image's name, with AlphaPose's tracked ids.

    Raises:
        InputError: another form, or people of different keypoint sets.
    """
    file = _file(path) or path
    content = read_json(file)
    if is_results_list(content):
        return read_list(file, camera, NAME, skeleton)
    if not _by_image(content):
        raise InputError(f"{file}: not AlphaPose JSON: expected a list of people, or people or bodies for each image")
    named = ((image, f"{file}: {image}", entry) for image, entry in content.items())
    images = (
        (frame_number(image, where), where, [(in_coco17_order(person), UNTRACKED) for person in _people(entry, where)])
        for image, where, entry in named
    )
    return frames_of_images(file, camera, NAME, skeleton, images, searched=f"{len(content)} images")


def _file(path: Path) -> Path | None:
    if path.is_dir():
        return path / RESULTS_FILE if (path / RESULTS_FILE).is_file() else None
    return path if path.is_file() and path.suffix == ".json" else None


def _by_image(content: Any) -> bool:
    first = next(iter(content.values()), None) if isinstance(content, dict) else None
    return isinstance(first, dict) and ("people" in first or "bodies" in first)


def _people(entry: Any, where: str) -> list[Array]:
    if "people" in entry:
        return keypoints_of_people(entry, where)
    return [points_of(body["joints"], where) for body in entry["bodies"] if body.get("joints")]
