"""Two recordings of one movement: `posefuse.compare`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from posefuse import core

if TYPE_CHECKING:
    from posefuse.evaluation.compare import Comparison, Tracks


def compare(
    a: core.Recording | str | Path,
    b: core.Recording | str | Path,
    *,
    person: int | None = None,
    align_time: bool = True,
    align_space: bool = True,
    scale: bool = False,
    align_first_s: float | None = None,
) -> Comparison:
    """Bring `b` onto `a` in time and space and say how far apart they are, point by point, and how they drift.

    Args:
        a: a recording, a result folder, or a file of another system: TRC, C3D, CSV, MVNX.
        b: the same.
        person: id in posefuse recordings; None: the one seen longest.
        align_time: find the offset in time.
        align_space: find the rotation and translation between the two world frames.
        scale: find a change of size as well.
        align_first_s: align by the first seconds only, so that drift shows.

    Raises:
        InputError: a file that cannot be read, no common points, or no common time.
    """
    from posefuse.evaluation.compare import compare as compared

    one, other = _tracks(a, "a", person), _tracks(b, "b", person)
    return compared(one, other, time=align_time, space=align_space, scale=scale, start_s=align_first_s)


def _tracks(value: core.Recording | str | Path, name: str, person: int | None) -> Tracks:
    from posefuse.evaluation.tracks import read_tracks, tracks_of

    if isinstance(value, core.Recording):
        return tracks_of(value.poses, Path(str(value.provenance.get("session", name))), person)
    return read_tracks(Path(value), person)
