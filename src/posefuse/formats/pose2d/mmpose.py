"""MMPose JSON: a file per image with its people, or a file per video with the people of every frame."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from posefuse.core import InputError, Skeleton
from posefuse.core.arrays import Array

from .frames import UNTRACKED, People2D, Pose2DFrames, frame_number, frames_from_mapping, read_json
from .keypoint_sets import agreed_skeleton, skeleton_of_names

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
    return _frames_of(frames, path, camera, skeleton)


def _frames_of(frames: dict[int, Any], path: Path, camera: str, skeleton: Skeleton | None) -> Pose2DFrames:
    people: dict[int, tuple[list[Array], list[int]]] = {}
    for number, instances in frames.items():
        where = f"{path}: frame {number}"
        found = [_points(instance, where) for instance in instances]
        people[number] = found, [int(instance.get("track_id", UNTRACKED)) for instance in instances]
        for person in found:
            skeleton = agreed_skeleton(skeleton, len(person), where)
    if skeleton is None:
        raise InputError(f"{path}: camera {camera}: no person in any of {len(frames)} frames")
    made = {number: People2D.of(found, ids, len(skeleton)) for number, (found, ids) in people.items()}
    return frames_from_mapping(camera, NAME, skeleton, made)


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


def _points(instance: Any, where: str) -> Array:
    try:
        xy, score = np.array(instance["keypoints"], np.float64), np.array(instance["keypoint_scores"], np.float64)
        return np.concatenate([xy[:, :2], score[:, None]], axis=-1)
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise InputError(f"{where}: not MMPose JSON: expected keypoints (K, 2) and keypoint_scores (K) ({error!r})") from None
