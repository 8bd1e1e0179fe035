"""The folder of a report next to the result that it is about."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from posefuse.core import ConfigError, Progress, Recording, Rig, silent
from posefuse.evaluation.biomechanics import BiomechanicsSettings, write_biomechanics
from posefuse.evaluation.compare import Comparison, Tracks, compare
from posefuse.evaluation.report import TITLE
from posefuse.evaluation.tracks import is_simulated, read_tracks, tracks_of, truth_tracks
from posefuse.formats.rig import refusal_note
from posefuse.foundation.output_folder import output_folder

from .reading import files_of_result, is_live, live_reader, read_result

FOLDER, PAGE_FILE = "biomechanics", "report.html"
# of all files together, measured on the bundled clip
_BYTES_PER_STEP_AND_PERSON = 6_000


def report_folder(result: Path) -> Path:
    """Where the report of a result lies unless asked otherwise: RESULT/biomechanics, or NAME_biomechanics for NAME.mcap."""
    return result.with_name(f"{result.stem}_{FOLDER}") if is_live(result) else result / FOLDER


def write_report_folder(
    recording: Recording,
    result: Path | None,
    folder: Path,
    settings: BiomechanicsSettings | None = None,
    *,
    title: str | None = None,
    progress: Progress = silent,
) -> list[Path]:
    """Write angles, gait, files for other programs and the page, an earlier report is moved aside; returns the files.

    Args:
        recording: what was read from `result`; None where it is in memory only.

    Raises:
        InputError: the folder holds anything else, or there is no one to report on.
    """
    size = len(recording.poses) * len(recording.poses.person_id) * _BYTES_PER_STEP_AND_PERSON
    inputs = [] if result is None else files_of_result(result)
    with output_folder(folder, command="report", inputs=inputs, replace=True, estimated_bytes=size) as place:
        made = write_biomechanics(recording, place.folder, settings, title=title or TITLE, progress=progress)
        relative = [path.relative_to(place.folder) for path in made]
    return [folder / path for path in relative]


# Two recordings, whatever made them, as tracks that can be compared; a simulated scene as truth.

Source = Path | tuple[Path, Recording]


def compared(
    a: Source,
    b: Source,
    person: int | None,
    *,
    time: bool = True,
    space: bool = True,
    scale: bool = False,
    start_s: float | None = None,
) -> Comparison:
    """Read two recordings and compare them by `evaluation.compare`, without an alignment where there is nothing to align.

    Where the first is a simulated scene, its truth at the simulated times of the second is taken, in its world. Positions of one
    calibration are compared as they are: a person who walks to and fro looks much the same turned by half a turn. An alignment in
    space that is asked for by `scale` or `start_s` is done all the same.

    Args:
        a, b: a path, or a recording with the path it is known by.
        person: which of those that hold several; None: of the first the one seen longest, of the second the one nearest to that
            where both are of one calibration, else the one seen longest. What is missing of a recording is a `UserWarning`.

    Raises:
        InputError, SourceError: a file that cannot be read, or nothing in common. ConfigError: settings that exclude one another.
    """
    asked = scale or start_s is not None
    if asked and not space:
        raise ConfigError("`scale=True` and `align_first_s=S` align in space: leave out `align_space=False`")
    exact = isinstance(a, Path) and is_simulated(a)
    if isinstance(a, Path) and exact:
        tracks_b, rig_b = _read(b, person, simulated=True)
        tracks_a, rig_a = truth_tracks(a, tracks_b), None
    else:
        tracks_a, rig_a = _read(a, person)
        tracks_b, rig_b = _read(b, person, (tracks_a, rig_a))
    one_world = exact or _share_a_world(rig_a, rig_b)
    apart = not one_world or asked
    found = compare(tracks_a, tracks_b, time=time and not exact, space=space and apart, scale=scale, start_s=start_s)
    notes = []
    if exact:
        own = "times are" if asked else "nothing is aligned, times and world are"
        notes.append(f"{tracks_a.name} is the truth of a simulation: {own} its own")
    elif space and not apart:
        notes.append("both have the coordinates of one calibration: they are not aligned in space")
    return replace(found, inputs=tuple(one for one in (a, b) if isinstance(one, Path)), notes=tuple(notes))


def _share_a_world(one: Rig | None, two: Rig | None) -> bool:
    """Cameras that both have are calibrated alike."""
    if one is None or two is None:
        return False
    names = [name for name in one.names if name in two.names]
    return bool(names) and one.only(names).id == two.only(names).id


def _read(
    source: Source, person: int | None, reference: tuple[Tracks, Rig | None] | None = None, *, simulated: bool = False
) -> tuple[Tracks, Rig | None]:
    """Of a live session, at simulated times where it recorded them, or of any other file or result folder; with its cameras."""
    path, recording = source if isinstance(source, tuple) else (source, None)
    if recording is None and not (is_live(path) or path.is_dir()):
        return read_tracks(path, person), None
    made = recording or read_result(path, observed=False)
    near = reference[0] if reference is not None and _share_a_world(reference[1], made.rig) else None
    tracks = replace(tracks_of(made.poses, path, person, near), warning=refusal_note(path, made.rig))
    if simulated and recording is None and is_live(path):
        tracks = _at_simulated_times(tracks, path, int(made.provenance["start_ns"]))
    return tracks, made.rig


def _at_simulated_times(tracks: Tracks, path: Path, start_ns: int) -> Tracks:
    t_ns, sim_ns = live_reader().simulated_times(path)
    t_s, sim_s = (t_ns - start_ns) / 1e9, sim_ns / 1e9
    if not len(t_s):
        return tracks
    at_s = np.interp(tracks.t_s, t_s, sim_s)
    # while a simulator stands still there is nothing new to compare; one that began again is compared from then on
    first = int(np.flatnonzero(np.diff(at_s) < 0)[-1]) + 1 if (np.diff(at_s) < 0).any() else 0
    later = np.concatenate([[True], np.diff(at_s[first:]) > 0])
    return replace(tracks, t_s=at_s[first:][later], xyz_m=tracks.xyz_m[first:][later])
