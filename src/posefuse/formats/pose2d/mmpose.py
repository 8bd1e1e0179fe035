"""MMPose JSON: a file per image with its people, or a file per video with the people of every frame."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from posefuse.core import InputError, Skeleton
from posefuse.core.arrays import Array

from .frames import UNTRACKED, Pose2DFrames, frame_number, frames_of_images, read_json, skeleton_of_names

NAME = "mmpose"
LOOKS_FOR = "JSON with frame_id and instances, or a folder of JSON lists with keypoint_scores"


def fits(path: Path) -> bool:
    """Whether this is a file of frames with instances, or a folder of files with lists of people."""
    if path.is_dir():
        first = next(iter(sorted(path.glob("*.json"))), None)
        return first is not None and _is_people(read_json(first))
    return path.is_file() and path.suffix == ".json" and _frames(read_json(path)) is not None


def read(path: Path, camera: str, skeleton: Skeleton | None = None) -> Pose2DFrames:
    """Frames by frame_id, or by the number in each file's name; raises InputError for another form.

    The names of the keypoints come from the file where it states them (``meta_info``), else from their number.
    """
    if path.is_dir():
        frames = {frame_number(file.stem, str(file)): read_json(file) for file in sorted(path.glob("*.json"))}
    else:
        content = read_json(path)
        skeleton = skeleton or _stated_skeleton(content, str(path))
        frames = _frames(content) or {}
    named = ((number, f"{path}: frame {number}", instances) for number, instances in frames.items())
    images = ((number, where, [_person(instance, where) for instance in instances]) for number, where, instances in named)
    return frames_of_images(path, camera, NAME, skeleton, images, searched=f"{len(frames)} frames")


def _frames(content: Any) -> dict[int, Any] | None:
    """Instances by frame number of a video's file; None for another form."""
    entries = content.get("instance_info") if isinstance(content, dict) else content
    if not isinstance(entries, list) or not entries:
        return None
    if not all(isinstance(entry, dict) and "frame_id" in entry and "instances" in entry for entry in entries):
        return None
    return {int(entry["frame_id"]): entry["instances"] for entry in entries}


def _is_people(content: Any) -> bool:
    """Whether one image's file: a list of people with keypoints; an image without people is an empty list."""
    return isinstance(content, list) and all(isinstance(entry, dict) and "keypoint_scores" in entry for entry in content)


def _stated_skeleton(content: Any, where: str) -> Skeleton | None:
    info = content.get("meta_info") if isinstance(content, dict) else None
    names = info.get("keypoint_id2name") if isinstance(info, dict) else None
    if not isinstance(names, dict):
        return None
    return skeleton_of_names([names[key] for key in sorted(names, key=int)], NAME, where)


def _person(instance: Any, where: str) -> tuple[Array, int]:
    try:
        xy, score = np.array(instance["keypoints"], np.float64), np.array(instance["keypoint_scores"], np.float64)
        points = np.concatenate([xy[:, :2], score[:, None]], axis=-1)
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise InputError(f"{where}: not MMPose JSON: expected keypoints (K, 2) and keypoint_scores (K) ({error!r})") from None
    return points, int(instance.get("track_id", UNTRACKED))
