"""Two recordings of one movement: `posefuse.compare`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from posefuse import core
from posefuse.core import ConfigError
from posefuse.evaluation.compare import Comparison, Tracks
from posefuse.evaluation.compare import compare as compared
from posefuse.evaluation.tracks import is_simulated, read_tracks, tracks_of, truth_tracks
from posefuse.formats.rig import refusal_note
from posefuse.pipeline.reading import is_live, live_reader, read_result

from .arguments import checked

Source = core.Recording | str | Path


@checked
def compare(
    a: Source,
    b: Source,
    *,
    person: int | None = None,
    align_time: bool = True,
    align_space: bool = True,
    scale: bool = False,
    align_first_s: float | None = None,
) -> Comparison:
    """Bring `b` onto `a` in time and space and measure their distance point by point, and their drift.

    Where `a` is a simulated scene, its truth at the simulated times of `b` is taken, in its world. Positions of one calibration
    are compared as they are: a person who walks to and fro looks much the same turned by half a turn.

    Args:
        a: a recording, a result folder, or a file of another system: TRC, C3D, CSV.
        b: the same.
        person: id in posefuse recordings; None: of one calibration the one that both have, else the one seen longest.
        align_time: find the offset in time.
        align_space: find the rotation and translation between the two world frames; recordings of one calibration share theirs,
            and are aligned in space only with `scale` or `align_first_s`.
        scale: find a change of size as well.
        align_first_s: align by the first seconds only, so that drift shows.

    Returns:
        The errors; `Comparison.save` writes a page with every point over time, and the figures.

    Raises:
        InputError: a file that cannot be read, no common points, or no common time. ConfigError: `scale` or `align_first_s`
            without `align_space`, or `person` of two files that know no ids.

    Examples:
        >>> import posefuse as pf
        >>> found = pf.compare("RESULT", "markers.c3d")  # doctest: +SKIP
        >>> found.errors.mpjpe_mm, dict(zip(found.points, found.errors.mean_mm))  # doctest: +SKIP
    """
    asked = scale or align_first_s is not None
    if asked and not align_space:
        raise ConfigError("`scale=True` and `align_first_s=S` align in space: leave out `align_space=False`")
    paths = [Path(one) for one in (a, b) if not isinstance(one, core.Recording)]
    if person is not None and len(paths) == 2 and not any(_has_people(path) for path in paths):
        raise ConfigError(f"`person={person}`: neither recording has people by id")
    scene = None if isinstance(a, core.Recording) or not is_simulated(Path(a)) else Path(a)
    if scene is not None:
        tracks_b, rig_b = _read(b, "b", person, simulated=True)
        tracks_a, rig_a = truth_tracks(scene, tracks_b), None
    else:
        tracks_a, rig_a = _read(a, "a", person)
        tracks_b, rig_b = _read(b, "b", person, (tracks_a, rig_a))
        if tracks_a.of_several and person is None:
            # of all people of the first the one of the second, who need not be the one seen longest
            tracks_a, rig_a = _read(a, "a", person, (tracks_b, rig_b))
    apart = asked or not (scene or _share_a_world(rig_a, rig_b))
    found = compared(
        tracks_a, tracks_b, time=align_time and scene is None, space=align_space and apart, scale=scale, start_s=align_first_s
    )
    notes = []
    if scene is not None:
        own = "times are" if asked else "nothing is aligned, times and world are"
        notes.append(f"{tracks_a.name} is the truth of a simulation: {own} its own")
    elif align_space and not apart:
        notes.append("both have the coordinates of one calibration: they are not aligned in space")
    return replace(found, inputs=tuple(paths), notes=tuple(notes))


def _has_people(path: Path) -> bool:
    """Whether a result of posefuse, which knows people by id; files of other systems hold one person."""
    return is_live(path) or path.is_dir()


def _share_a_world(one: core.Rig | None, two: core.Rig | None) -> bool:
    """Cameras that both have are calibrated alike."""
    if one is None or two is None:
        return False
    names = [name for name in one.names if name in two.names]
    return bool(names) and one.only(names).id == two.only(names).id


def _read(
    source: Source,
    name: str,
    person: int | None,
    reference: tuple[Tracks, core.Rig | None] | None = None,
    *,
    simulated: bool = False,
) -> tuple[Tracks, core.Rig | None]:
    """Of a live session, at simulated times where it recorded them, or of any other file or result folder; with its cameras.

    Args:
        name: of a recording that has none. reference: what the other recording is, by which the person is known.
    """
    if isinstance(source, core.Recording):
        path, made = getattr(source, "path", None) or Path(str(source.provenance.get("session", name))), source
    elif _has_people(path := Path(source)):
        made = read_result(path, observed=False)
    else:
        return read_tracks(path), None
    near = reference[0] if reference is not None and _share_a_world(reference[1], made.rig) else None
    tracks = replace(tracks_of(made.poses, path, person, near), warning=refusal_note(path, made.rig))
    if simulated and made is not source and is_live(path):
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
