"""Corrections by hand to a finished recording: what a second solve leaves out, and which person it keeps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from annotated_types import Ge, Le

from posefuse.association.settings import PeopleNames
from posefuse.core import InputError, Observations, Recording
from posefuse.core.arrays import Array
from posefuse.core.errors import choices
from posefuse.core.observations import NOT_KEPT
from posefuse.core.view_sequences import people_in
from posefuse.foundation.settings import settings

from .config import FARTHEST_S

SessionSeconds = Annotated[float, Ge(-FARTHEST_S), Le(FARTHEST_S)]


@settings
class Exclusion:
    """A stretch of time in which a camera, or all of them, are not used.

    Attributes:
        start_s, end_s: session seconds, as of ``start_s`` of `track`: frames exposed from the first on and before the second.
        camera: name in the rig; None: all cameras, a bad stretch.
    """

    start_s: SessionSeconds
    end_s: SessionSeconds
    camera: str | None = None


@settings
class Edits:
    """What a person decided about a recording after looking at it; see `posefuse.Recording.solve`.

    Attributes:
        exclusions: stretches that are not used; they may overlap.
        person: id of the one person to keep; None: all.
        names: of the people, in the order of their ids; empty: as they were.
    """

    exclusions: tuple[Exclusion, ...] = ()
    person: Annotated[int, Ge(0)] | None = None
    names: PeopleNames = ()


NO_EDITS = Edits()


def check_edits(edits: Edits, recording: Recording) -> None:
    """Raise InputError for a camera or person that the recording does not have, or a stretch that ends before it begins."""
    for one in edits.exclusions:
        if one.end_s <= one.start_s:
            raise InputError(f"exclusion: expected an end after the start, got {one.start_s:g} s to {one.end_s:g} s")
        if one.camera is not None and one.camera not in recording.rig.names:
            raise InputError(f"exclusion: no camera {one.camera!r}; there are: {choices(recording.rig.names)}")
    people = people_in(recording.observations)[0].tolist()
    if edits.person is not None and edits.person not in people:
        raise InputError(f"person to keep: no person {edits.person}; there are: {choices(map(str, people))}")


def used_frames(observations: Observations, exclusions: Sequence[Exclusion]) -> Array:
    """(F,) which frames of the log no exclusion covers."""
    used = np.ones(len(observations.frame_t_ns), np.bool_)
    for one in exclusions:
        covered = (observations.frame_t_ns >= round(one.start_s * 1e9)) & (observations.frame_t_ns < round(one.end_s * 1e9))
        if one.camera is not None:
            covered &= observations.frame_camera == observations.camera_names.index(one.camera)
        used &= ~covered
    return used


def check_exclusions(exclusions: Sequence[Exclusion], recording: Recording) -> None:
    """Raise InputError as `check_edits`, and for a stretch in which the recording has no frame."""
    check_edits(Edits(exclusions=tuple(exclusions)), recording)
    t_ns = recording.observations.frame_t_ns
    for one in exclusions:
        if used_frames(recording.observations, (one,)).all():
            where = f"from {t_ns.min() / 1e9:.2f} to {t_ns.max() / 1e9:.2f} s" if len(t_ns) else "empty"
            of = f"no frame of {one.camera or 'any camera'} from {one.start_s:g} to {one.end_s:g} s"
            raise InputError(f"exclusion: {of}; the recording is {where}")


def left_out(exclusions: Sequence[Exclusion]) -> str:
    """The end of a line about what cannot be solved: what they leave out; empty for none."""
    listed = (f"{one.camera or 'all cameras'} from {one.start_s:g} to {one.end_s:g} s" for one in exclusions)
    return f"; left out are {', '.join(listed)}; exclude less" if exclusions else ""


def only_person(new_id: Array, earlier_id: Array, person: int) -> Array:
    """(R,) people of detections after a new association, in which the one person kept has the earlier id.

    That person is the one who has most of the detections that belonged to `person` before.

    Raises:
        InputError: none of these detections belongs to a person any more.
    """
    found, counts = np.unique(new_id[(earlier_id == person) & (new_id != NOT_KEPT)], return_counts=True)
    if not len(found):
        raise InputError(f"person {person}: is not followed any more")
    return np.where(new_id == found[np.argmax(counts)], person, NOT_KEPT)
