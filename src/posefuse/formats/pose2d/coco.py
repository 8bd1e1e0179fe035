"""COCO results JSON: one list of people, each with the number of its image."""

from __future__ import annotations

from pathlib import Path

from posefuse.core import Skeleton

from .frames import Pose2DFrames, read_json
from .results_list import is_results_list, read_list

NAME = "coco"


def fits(path: Path) -> bool:
    """Whether this is a JSON file with a list of image_id, category_id and keypoints."""
    return path.is_file() and path.suffix == ".json" and is_results_list(read_json(path))


def read(path: Path, camera: str, skeleton: Skeleton | None = None) -> Pose2DFrames:
    """Frames numbered by image_id; raises InputError for another form."""
    return read_list(path, camera, NAME, skeleton)
