"""Two recordings, whatever made them, as tracks that can be compared; a simulated scene as truth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from posefuse.core import Recording
from posefuse.evaluation.compare import Tracks
from posefuse.evaluation.tracks import read_tracks, tracks_of
from posefuse.evaluation.truth_tracks import is_simulated, truth_tracks

from .reading import is_live, read_result

Warn = Callable[[str], None]
Source = Path | tuple[Path, Recording]


@dataclass(frozen=True, eq=False)
class ToCompare:
    """Tracks of two recordings; `exact`: the first is the truth of a simulation, at the times and in the world of the second."""

    a: Tracks
    b: Tracks
    exact: bool


def to_compare(a: Source, b: Source, person: int | None, warn: Warn | None = None) -> ToCompare:
    """Read two recordings; where the first is a simulated scene, its truth at the simulated times of the second.

    Args:
        a, b: a path, or a recording with the path it is known by.
        person: which of those that hold several. warn: is given one line about what is missing of a recording;
            `warnings.warn` where none is given.

    Raises:
        InputError, SourceError: a file that cannot be read, or nothing in common.
    """
    exact = isinstance(a, Path) and is_simulated(a)
    tracks_b = _tracks(b, person, warn, simulated=exact)
    if isinstance(a, Path) and exact:
        return ToCompare(truth_tracks(a, tracks_b), tracks_b, exact=True)
    return ToCompare(_tracks(a, person, warn, simulated=False), tracks_b, exact=False)


def _tracks(source: Source, person: int | None, warn: Warn | None, *, simulated: bool) -> Tracks:
    """Of a live session, at simulated times where it recorded them, or of any other file or result folder."""
    if isinstance(source, tuple):
        path, recording = source
        return tracks_of(recording.poses, path, person)
    if not is_live(source):
        return read_tracks(source, person)
    recording = read_result(source, warn)
    tracks = tracks_of(recording.poses, source, person)
    return _at_simulated_times(tracks, source, int(recording.provenance["start_ns"])) if simulated else tracks


def _at_simulated_times(tracks: Tracks, path: Path, start_ns: int) -> Tracks:
    from posefuse.messages.bags import read_clock

    from .live_recording import parts_of

    pairs = [read_clock(part, lambda line: None) for part in parts_of(path)]
    t_s = (np.concatenate([pair[0] for pair in pairs]) - start_ns) / 1e9
    sim_s = np.concatenate([pair[1] for pair in pairs]) / 1e9
    if not len(t_s):
        return tracks
    at_s = np.interp(tracks.t_s, t_s, sim_s)
    # while a simulator stands still there is nothing new to compare; one that began again is compared from then on
    first = int(np.flatnonzero(np.diff(at_s) < 0)[-1]) + 1 if (np.diff(at_s) < 0).any() else 0
    later = np.concatenate([[True], np.diff(at_s[first:]) > 0])
    return replace(tracks, t_s=at_s[first:][later], xyz_m=tracks.xyz_m[first:][later])
