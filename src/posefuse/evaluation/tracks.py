"""Recordings of several systems as named tracks of one person."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np

from posefuse.core import InputError, PoseSequence
from posefuse.core.arrays import Array
from posefuse.formats.c3d import C3dData, read_c3d
from posefuse.formats.mvnx import read_mvnx
from posefuse.formats.named_points import NamedPoints
from posefuse.formats.points_csv import read_points_csv
from posefuse.formats.recording import read_result_poses
from posefuse.formats.trc import read_trc

from .compare import Tracks

KINDS = "a posefuse result folder, .mcap of posefuse live, .trc, .c3d, .csv or .mvnx"
_SYNONYMS = {"hip": "mid_hip", "hips": "mid_hip", "left_foot_index": "left_big_toe", "right_foot_index": "right_big_toe"}
# nothing that is compared is farther from its origin or lasts longer; damaged numbers are
_FARTHEST_M = 10_000.0
_LONGEST_S = 21_600.0


def read_tracks(path: Path, person: int | None = None) -> Tracks:
    """Named points of one person (default: the one seen longest) from a file or result folder.

    Raises:
        InputError: no such file, a kind that is not read, or no such person.
    """
    if not path.exists():
        raise InputError(f"{path}: no such file or folder")
    if path.is_dir():
        return tracks_of(read_result_poses(path)[0], path, person)
    readers: dict[str, Callable[[Path], NamedPoints | C3dData]] = {
        ".trc": read_trc,
        ".c3d": read_c3d,
        ".csv": lambda file: read_points_csv(file, person),
        ".mvnx": read_mvnx,
    }
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise InputError(f"{path}: cannot be compared; expected {KINDS}")
    data = reader(path)
    return named_tracks(path, data.names, data.t_s, data.xyz_world)


def plain_name(name: str) -> str:
    """One spelling for all systems: ``RShoulder``, ``jRightShoulder`` and ``right shoulder`` are right_shoulder."""
    words = re.sub(r"(?<=[a-z0-9])(?=[A-Z])|[\s.\-]+", "_", name.strip().split(":")[-1])
    words = re.sub(r"^([RL])(?=[A-Z][a-z])", r"\1_", words).strip("_").lower().removeprefix("j_")
    words = re.sub(r"^r_", "right_", re.sub(r"^l_", "left_", words))
    words = re.sub(r"^(.*)_(right|left)$", r"\2_\1", words)
    return _SYNONYMS.get(words, words)


def named_tracks(path: Path, names: tuple[str, ...], t_s: Array, xyz_m: Array) -> Tracks:
    """Points by their plain names, with neck and mid_hip where they follow; raises InputError for what cannot be a recording."""
    points = [plain_name(name) for name in names]
    middles = {"neck": ("left_shoulder", "right_shoulder"), "mid_hip": ("left_hip", "right_hip")}
    for name, (one, two) in middles.items():
        if name not in points and one in points and two in points:
            middle = (xyz_m[:, points.index(one)] + xyz_m[:, points.index(two)]) / 2
            xyz_m, points = np.concatenate([xyz_m, middle[:, None]], axis=1), [*points, name]
    known = np.isfinite(xyz_m).all(axis=-1)
    if not known.any():
        raise InputError(f"{path}: no point is known at any time: every coordinate is missing")
    if not (np.isfinite(t_s).all() and (np.diff(t_s) > 0).all()):
        raise InputError(f"{path}: expected increasing times in seconds")
    if np.abs(xyz_m[known]).max() > _FARTHEST_M or t_s[-1] - t_s[0] > _LONGEST_S:
        raise InputError(
            f"{path}: expected points within {_FARTHEST_M:g} m and {_LONGEST_S:g} s, got {np.abs(xyz_m[known]).max():.3g} m "
            f"and {t_s[-1] - t_s[0]:.3g} s; is the file damaged, or in other units?"
        )
    return Tracks(path.name, tuple(points), t_s, xyz_m)


def tracks_of(poses: PoseSequence, path: Path, person: int | None = None) -> Tracks:
    """The keypoints of one person (default: the one seen longest); `path` names the recording.

    Raises:
        InputError: no such person, or no keypoint at any time.
    """
    seen = np.isfinite(poses.xyz_world[..., 0]).sum(axis=(0, 2))
    if person is not None and person not in poses.person_id:
        raise InputError(f"{path}: no person {person}; there are: {', '.join(map(str, poses.person_id))}")
    if not seen.any():
        raise InputError(
            f"{path}: no person was found in this recording; was any in view, and did the computer process enough of the images?"
        )
    n = int(np.argmax(seen)) if person is None else int(np.flatnonzero(poses.person_id == person)[0])
    return named_tracks(path, poses.skeleton.keypoints, poses.t_ns / 1e9, poses.xyz_world[:, n])
