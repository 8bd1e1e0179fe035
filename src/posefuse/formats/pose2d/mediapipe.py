"""MediaPipe pose landmarks, as people commonly save them: JSON of frames with 33 landmarks each, or csv, long or wide.

Landmarks in shares of the image (MediaPipe's own units) need the image's size; landmarks in px are recognised by their values.
"""

from __future__ import annotations

import csv
import re
from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from posefuse.core import SKELETONS, InputError, Skeleton
from posefuse.core.arrays import Array
from posefuse.foundation.parsing import short

from .frames import People2D, Pose2DFrames, frames_from_mapping, read_json
from .keypoint_sets import keypoint_name

NAME = "mediapipe"
_LANDMARKS = SKELETONS["blazepose33"].keypoints
_COUNT = len(_LANDMARKS)
# a person may reach a little out of the image; px of a person are far larger
_MOST_SHARE = 4.0
_FRAME_KEYS = ("frame", "frame_id", "frame_number", "frame_index")
_POINT_KEYS = ("landmarks", "pose_landmarks", "poseLandmarks", "keypoints")
_SCORES = ("visibility", "score", "presence")
_WIDE = re.compile(r"^(x|y|v|visibility|score)_?(\d+)$|^(\d+|.+?)_(x|y|v|visibility|score)$", re.IGNORECASE)
_LONG_POINT = ("landmark", "landmark_id", "landmark_name", "keypoint", "name", "id")


def fits(path: Path) -> bool:
    """Whether this is a JSON of frames with landmarks, or a csv with a frame column and landmarks' x and y."""
    if not path.is_file():
        return False
    if path.suffix == ".json":
        frames = _frames(read_json(path))
        return bool(frames) and any(key in frames[0] for key in _POINT_KEYS)
    if path.suffix != ".csv":
        return False
    with path.open(newline="", encoding="utf-8", errors="replace") as file:
        names = [name.strip().lower() for name in next(csv.reader(file), [])]
    long_form = any(name in _LONG_POINT for name in names) and {"x", "y"} <= set(names)
    return any(name in _FRAME_KEYS for name in names) and (long_form or len(_wide_columns(names)) == _COUNT)


def read(path: Path, camera: str, skeleton: Skeleton | None = None, size_wh: tuple[int, int] | None = None) -> Pose2DFrames:
    """Frames by their number, or in order; raises InputError for another form, or shares of an image of unknown size."""
    people = _from_json(path) if path.suffix == ".json" else _from_csv(path)
    if not people:
        raise InputError(f"{path}: camera {camera}: expected frames with {_COUNT} landmarks, got none")
    in_px = _in_px(people, path, size_wh)
    made = {number: People2D.of(found, None, _COUNT) for number, found in in_px.items()}
    rate_hz = _rate_hz(read_json(path)) if path.suffix == ".json" else None
    return frames_from_mapping(camera, NAME, skeleton or SKELETONS["blazepose33"], made, rate_hz)


def _in_px(people: Mapping[int, list[Array]], path: Path, size_wh: tuple[int, int] | None) -> dict[int, list[Array]]:
    everything = np.concatenate([person[:, :2] for found in people.values() for person in found] or [np.zeros((0, 2))])
    if not len(everything) or np.nanmax(np.abs(everything)) > _MOST_SHARE:
        return dict(people)
    if size_wh is None:
        raise InputError(f"{path}: landmarks are in shares of the image, whose size is not known; give size_wh=")
    # a share counts from the corner of the image, half a pixel before its first pixel's centre
    scale, shift = np.array([*size_wh, 1.0]), np.array([0.5, 0.5, 0.0])
    return {number: [person * scale - shift for person in found] for number, found in people.items()}


def _frames(content: Any) -> list[dict[str, Any]]:
    entries = content.get("frames") if isinstance(content, dict) else content
    good = isinstance(entries, list) and all(isinstance(entry, dict) for entry in entries)
    return entries if good else []  # type: ignore[return-value]


def _rate_hz(content: Any) -> float | None:
    """As the file states it, or by the times of its frames."""
    stated = next((content[key] for key in ("fps", "frame_rate") if key in content), None) if isinstance(content, dict) else None
    if stated is not None:
        return float(stated)
    times_ms = [entry["timestamp_ms"] for entry in _frames(content) if "timestamp_ms" in entry]
    return 1e3 / float(np.median(np.diff(times_ms))) if len(times_ms) > 1 else None


def _from_json(path: Path) -> dict[int, list[Array]]:
    people: dict[int, list[Array]] = {}
    for i, entry in enumerate(_frames(read_json(path))):
        number = next((int(entry[key]) for key in _FRAME_KEYS if key in entry), i)
        landmarks = next((entry[key] for key in _POINT_KEYS if key in entry), None) or []
        several = landmarks if landmarks and isinstance(landmarks[0], list) else [landmarks]
        people[number] = [_person(one, f"{path}: frame {number}") for one in several if len(one)]
    return people


def _person(landmarks: Any, where: str) -> Array:
    try:
        rows = [[one["x"], one["y"], next((one[key] for key in _SCORES if key in one), 1.0)] for one in landmarks]
        points = np.array(rows, np.float64)
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{where}: expected landmarks with x, y and visibility ({error!r})") from None
    if len(points) != _COUNT:
        raise InputError(f"{where}: expected {_COUNT} landmarks, got {len(points)}")
    return points


def _from_csv(path: Path) -> dict[int, list[Array]]:
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    names = {name.strip().lower(): name for name in (rows[0] if rows else {})}
    frame_key = next((names[key] for key in _FRAME_KEYS if key in names), None)
    if frame_key is None:
        raise InputError(f"{path}: expected a column {' or '.join(_FRAME_KEYS)}, got {', '.join(names)}")
    try:
        if {"x", "y"} <= set(names):
            return _long(rows, names, frame_key)
        columns = _wide_columns(list(names))
        return {int(float(row[frame_key])): [_wide(row, names, columns)] for row in rows}
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path}: expected a frame number, landmarks and numbers in every row ({error})") from None


def _long(rows: list[dict[str, str]], names: Mapping[str, str], frame_key: str) -> dict[int, list[Array]]:
    point_key = next(names[key] for key in _LONG_POINT if key in names)
    score_key = next((names[key] for key in _SCORES if key in names), None)
    people: dict[int, Array] = defaultdict(lambda: np.full((_COUNT, 3), np.nan))
    for row in rows:
        person = people[int(float(row[frame_key]))]
        person[_index(row[point_key])] = [
            _number(row[names["x"]]), _number(row[names["y"]]), _number(row[score_key]) if score_key else 1.0
        ]  # fmt: skip
    return {number: [person] for number, person in people.items()}


def _wide(row: Mapping[str, str], names: Mapping[str, str], columns: Mapping[int, Mapping[str, str]]) -> Array:
    person = np.full((_COUNT, 3), np.nan)
    for k, parts in columns.items():
        score = _number(row[names[parts["score"]]]) if "score" in parts else 1.0
        person[k] = [_number(row[names[parts["x"]]]), _number(row[names[parts["y"]]]), score]
    return person


def _wide_columns(names: list[str]) -> dict[int, dict[str, str]]:
    """Landmark -> x, y, score -> column, of columns like ``x0`` and ``left_knee_x``; only landmarks with x and y."""
    found: dict[int, dict[str, str]] = defaultdict(dict)
    for name in names:
        match = _WIDE.match(name)
        if match:
            part, point = (match[1], match[2]) if match[1] else (match[4], match[3])
            try:
                found[_index(point)][part if part in ("x", "y") else "score"] = name
            except ValueError:
                continue
    return {k: parts for k, parts in found.items() if {"x", "y"} <= set(parts)}


def _index(point: str) -> int:
    """Of a landmark by number or name; raises ValueError for neither."""
    if point.strip().isdigit() and int(point) < _COUNT:
        return int(point)
    name = keypoint_name(point.strip())
    for k, own in enumerate(_LANDMARKS):
        if name == own:
            return k
    raise ValueError(f"no landmark {short(point)}")


def _number(text: str) -> float:
    return float(text) if text.strip() else np.nan
