"""Corrections by hand: stretches and cameras to leave out, the person to keep, names; kept at once, used by a new solve."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import PurePosixPath

from nicegui import ui

from posefuse.core import PosefuseError, Recording
from posefuse.foundation.parsing import plain
from posefuse.pipeline.edits import NO_EDITS, Edits, Exclusion, check_edits, read_edits, write_edits
from posefuse.pipeline.solve import edits_of

from .shell import card, refused
from .state import Studio
from .workspace import check_name, recording_place

_ALL = "all cameras (a bad stretch)"
_EVERYBODY = -1


class EditCard:
    """The card.

    Args:
        name: of the recording in the workspace. now: where the player stands, session seconds.

    Attributes:
        edits: as they are kept. marked_s: the stretch that is being marked; None: none.
    """

    def __init__(self, studio: Studio, name: str, recording: Recording, now: Callable[[], float]) -> None:
        self._studio, self._name, self._recording, self._now = studio, name, recording, now
        self._path = studio.workspace.existing(name)
        self._from_s: float | None = None
        self.edits = self._kept()
        with card("Corrections"):
            ui.label("Mark what should not count, then solve again: without new detection, and this recording stays.").classes(
                "pf-small"
            )
            self._marking()
            self._list = ui.column().classes("pf-edits")
            self._people()
            with ui.row().classes("pf-tools"):
                self._out = ui.input("New name", value=recording_place(name).stem + "-edited").props("dense outlined")
                self._solve = ui.button("Solve again", icon="replay", on_click=self._start)
        self._show()

    @property
    def marked_s(self) -> tuple[float, float] | None:
        """The stretch from the mark to where the player stands."""
        if self._from_s is None:
            return None
        begin_s, end_s = sorted((self._from_s, self._now()))
        return begin_s, end_s

    def _kept(self) -> Edits:
        try:
            kept = read_edits(self._path)
            return kept if kept != NO_EDITS else edits_of(self._recording)
        except PosefuseError as error:
            refused(error)
            return NO_EDITS

    def _marking(self) -> None:
        with ui.row().classes("pf-tools"):
            self._camera = ui.select([_ALL, *self._recording.rig.names], value=_ALL, label="Leave out").props("dense outlined")
            self._begin = ui.button("Begin here", icon="first_page", on_click=self._mark).props("outline")
            self._end = ui.button("End here", icon="last_page", on_click=self._add)

    def _people(self) -> None:
        recording = self._recording
        ids = recording.poses.person_id.tolist()
        names = dict(zip(ids, recording.person_names, strict=True))
        with ui.row().classes("pf-tools"):
            ui.select(
                {_EVERYBODY: "everybody", **names},
                value=_EVERYBODY if self.edits.person is None else self.edits.person,
                label="Keep",
                on_change=lambda e: self._change(person=None if e.value == _EVERYBODY else e.value),
            ).props("dense outlined")
            for person in ids:
                ui.input(
                    f"Name of person {person}", value=names[person], on_change=lambda e, p=person: self._rename(p, e.value)
                ).props("dense outlined debounce=600")

    def _mark(self) -> None:
        self._from_s = self._now()
        self._show()

    def _add(self) -> None:
        marked = self.marked_s
        if marked is None:
            return
        camera = None if self._camera.value == _ALL else self._camera.value
        new = Exclusion(start_s=round(marked[0], 3), end_s=round(marked[1], 3), camera=camera)
        self._from_s = None
        self._change(exclusions=(*self.edits.exclusions, new))

    def _rename(self, person: int, name: str) -> None:
        if not name.strip():
            return
        names = list(self.edits.names) or _names_by_id(self._recording)
        names += [f"person {i}" for i in range(len(names), person + 1)]
        names[person] = name.strip()[:64]
        self._change(names=tuple(names))

    def _change(self, **changes: object) -> None:
        edits = dataclasses.replace(self.edits, **changes)  # type: ignore[arg-type]
        try:
            check_edits(edits, self._recording)
            write_edits(self._path, edits)
        except PosefuseError as error:
            refused(error)
            self._show()
            return
        self.edits = edits
        self._show()

    def _show(self) -> None:
        self._begin.set_text("Begin here" if self._from_s is None else f"From {self._from_s:.2f} s")
        self._end.set_enabled(self._from_s is not None)
        self._list.clear()
        with self._list:
            for place, one in enumerate(self.edits.exclusions):
                with ui.row().classes("pf-edit"):
                    ui.icon("content_cut")
                    ui.label(f"{one.camera or 'all cameras'}, {one.start_s:.2f} to {one.end_s:.2f} s")
                    ui.button(icon="close", on_click=lambda p=place: self._remove(p)).props(
                        'flat round dense aria-label="Remove"'
                    )

    def _remove(self, place: int) -> None:
        self._change(exclusions=tuple(one for i, one in enumerate(self.edits.exclusions) if i != place))

    def _start(self) -> None:
        workspace = self._studio.workspace
        try:
            check_name(self._out.value)
            parent = recording_place(self._name).parent.as_posix()
            # without the "./" of a recording at the top
            out = PurePosixPath(workspace.free_name(parent, self._out.value)).as_posix()
            arguments = {"result": self._name, "out": out, "edits": plain(dataclasses.asdict(self.edits))}
            self._studio.jobs.start("solve", f"Solve {self._name} again", arguments, page="/recordings")
        except PosefuseError as error:
            refused(error)
            return
        ui.notify(f"Solving again into {out}")


def _names_by_id(recording: Recording) -> list[str]:
    """Names for ids from 0 on, as they are now."""
    ids = recording.poses.person_id.tolist()
    known = dict(zip(ids, recording.person_names, strict=True))
    return [known.get(i, f"person {i}") for i in range(max(ids, default=-1) + 1)]
