"""Recordings of several systems as named tracks of one person, and the truth of a simulated scene at the times of one."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from posefuse.core import InputError, PoseSequence
from posefuse.core.arrays import Array, known_median
from posefuse.core.errors import choices
from posefuse.formats.c3d import C3dData, read_c3d
from posefuse.formats.named_points import NamedPoints, read_points_csv
from posefuse.formats.trc import read_trc
from posefuse.formats.truth import read_loop, read_truth

from .compare import Tracks

KINDS = "a posefuse result folder, .mcap of posefuse live, .trc, .c3d or .csv"
_SYNONYMS = {"hip": "mid_hip", "hips": "mid_hip", "left_foot_index": "left_big_toe", "right_foot_index": "right_big_toe"}
# nothing that is compared is farther from its origin or lasts longer; damaged numbers are
_FARTHEST_M = 10_000.0
_LONGEST_S = 21_600.0


def read_tracks(path: Path) -> Tracks:
    """Named points of one person from a file of any system.

    Raises:
        InputError: no such file, or a kind that is not read.
    """
    if not path.exists():
        raise InputError(f"{path}: no such file or folder")
    readers: dict[str, Callable[[Path], NamedPoints | C3dData]] = {
        ".trc": read_trc,
        ".c3d": read_c3d,
        ".csv": read_points_csv,
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
    """Points by their plain names, with neck and mid_hip where they follow.

    Raises:
        InputError: what cannot be a recording, or points of several subjects (``Ann:LKnee``, ``Ben:LKnee``).
    """
    points = [plain_name(name) for name in names]
    of_subjects = [name for name, point in zip(names, points, strict=True) if ":" in name and points.count(point) > 1]
    subjects = dict.fromkeys(name.rpartition(":")[0] for name in of_subjects)
    if len(subjects) > 1:
        raise InputError(f"{path}: expected one subject, got {choices(subjects)}; export each to a file of its own")
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


def tracks_of(poses: PoseSequence, path: Path, person: int | None = None, near: Tracks | None = None) -> Tracks:
    """The keypoints of one person (default: the one nearest to `near`, else the one seen longest); `path` names the recording.

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
    several = seen.sum() > seen.max()
    people = {
        n: named_tracks(path, poses.skeleton.keypoints, poses.t_ns / 1e9, poses.xyz_world[:, n])
        for n in (np.flatnonzero(seen) if person is None else np.flatnonzero(poses.person_id == person)).tolist()
    }
    n = max(people, key=lambda place: seen[place])
    if near is not None and len(people) > 1:
        apart_m = {place: _apart_m(one.at_times(near.t_s), near) for place, one in people.items()}
        n = min(people, key=lambda place: (apart_m[place] if np.isfinite(apart_m[place]) else np.inf, place != n))
    return replace(people[n], name=f"{path.name}, person {poses.person_id[n]}", of_several=True) if several else people[n]


_TRUTH = Path("truth") / "truth.npz"


def is_simulated(path: Path) -> bool:
    """Whether a folder holds the truth of a simulated scene: a session of `posefuse simulate`, or a Gazebo world."""
    return (path / _TRUTH).is_file()


def truth_tracks(path: Path, recorded: Tracks) -> Tracks:
    """Where the truth has the person of `recorded` at its times, which are those of the simulation.

    The person is the one nearest to the recorded one. A world whose motion starts again shows it again and again.

    Raises:
        InputError: the truth cannot be read, holds no person, or has nothing in common with `recorded`.
    """
    truth = read_truth(path / _TRUTH)
    loop_ns = read_loop((path / _TRUTH).parent)
    t_s = recorded.t_s if loop_ns is None else looped(recorded.t_s, loop_ns / 1e9)
    people = [
        named_tracks(path, truth.skeleton.keypoints, truth.t_ns / 1e9, truth.xyz_world[:, n]) for n in range(len(truth.person_id))
    ]
    there = [replace(person.at_times(t_s), t_s=recorded.t_s) for person in people]
    apart_m = [_apart_m(person, recorded) for person in there]
    if not np.isfinite(apart_m).any():
        raise InputError(
            f"{path} and {recorded.name}: nothing in common: the truth lasts {truth.t_ns[-1] / 1e9:.1f} s, the recording is from "
            f"{recorded.t_s[0]:.1f} to {recorded.t_s[-1]:.1f} s of simulated time"
        )
    return there[int(np.nanargmin(apart_m))]


def looped(t_s: Array, loop_s: float) -> Array:
    """Times within the loop: (0, loop_s] again and again, as Gazebo plays an animation; 0 stays 0."""
    return np.where(t_s > 0, t_s - loop_s * np.maximum(np.ceil(t_s / loop_s - 1e-12) - 1, 0), t_s)


def _apart_m(one: Tracks, other: Tracks) -> float:
    points = [point for point in one.points if point in other.points]
    apart_m = np.linalg.norm(one.only(points).xyz_m - other.only(points).xyz_m, axis=-1)
    return known_median(apart_m)
