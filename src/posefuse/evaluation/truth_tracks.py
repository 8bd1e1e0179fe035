"""The truth of a simulated scene as tracks, at the times of a recording of it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from posefuse.core import InputError
from posefuse.core.arrays import Array
from posefuse.formats.truth import read_loop, read_truth

from .compare import Tracks
from .metrics import known_median
from .tracks import named_tracks

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
    there = [replace(person, t_s=recorded.t_s, xyz_m=person.at(t_s)) for person in people]
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
