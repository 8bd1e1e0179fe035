"""Corrections by hand: stretches and cameras to leave out, the person to keep, names; kept at once, used by a new solve."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import PurePosixPath

from nicegui import ui

from posefuse.core import Recording
from posefuse.foundation.parsing import plain
from posefuse.pipeline.edits import NO_EDITS, Edits, Exclusion, check_edits, read_edits, write_edits
from posefuse.pipeline.solve import edits_of

from .shell import card, icon_button, redrawn, refusals, small
from .state import Studio
from .workspace import check_name, recording_place

_ALL = "all cameras (a bad stretch)"
_ALL_PEOPLE = -1


class EditCard:
    """The card.

    Args:
        name: of the recording in the workspace. now: where the player stands, session seconds.

    Attributes:
        edits: as they are kept.
    """

    def __init__(self, studio: Studio, name: str, recording: Recording, now: Callable[[], float]) -> None:
        self._studio, self._name, self._recording, self._now = studio, name, recording, now
        self._path = studio.workspace.existing(name)
        self._from_s: float | None = None
        self.edits = NO_EDITS
        with refusals():
            kept = read_edits(self._path)
            self.edits = kept if kept != NO_EDITS else edits_of(recording)
        with card("Corrections"):
            small("Mark what should not count, then solve again: without new detection, and this recording stays.")
            with ui.row().classes("pf-tools"):
                self._camera = ui.select([_ALL, *recording.rig.names], value=_ALL, label="Leave out").props("dense outlined")
                self._begin = ui.button("Begin here", icon="first_page", on_click=lambda: self._mark(self._now())).props(
                    "outline"
                )
                self._end = ui.button("End here", icon="last_page", on_click=self._add)
                self._end.set_enabled(False)
            self._show = redrawn(lambda: self.edits.exclusions, self._list, classes="pf-edits")
            self._people()
            with ui.row().classes("pf-tools"):
                self._out = ui.input("New name", value=recording_place(name).stem + "-edited").props("dense outlined")
                ui.button("Solve again", icon="replay", on_click=self._start)

    @property
    def marked_s(self) -> tuple[float, float] | None:
        """The stretch from the mark to where the player stands; None while none is marked."""
        if self._from_s is None:
            return None
        return min(self._from_s, self._now()), max(self._from_s, self._now())

    def _people(self) -> None:
        names = self._names
        with ui.row().classes("pf-tools"):
            ui.select(
                {_ALL_PEOPLE: "all people", **names},
                value=_ALL_PEOPLE if self.edits.person is None else self.edits.person,
                label="Keep",
                on_change=lambda event: self._change(person=None if event.value == _ALL_PEOPLE else event.value),
            ).props("dense outlined")
            for person, name in names.items():
                field = ui.input(f"Name of person {person}", value=name, on_change=lambda e, p=person: self._rename(p, e.value))
                field.props("dense outlined debounce=600")

    @property
    def _names(self) -> dict[int, str]:
        """By id."""
        return dict(zip(self._recording.poses.person_id.tolist(), self._recording.person_names, strict=True))

    def _mark(self, from_s: float | None) -> None:
        self._from_s = from_s
        self._begin.set_text("Begin here" if from_s is None else f"From {from_s:.2f} s")
        self._end.set_enabled(from_s is not None)

    def _add(self) -> None:
        if self.marked_s is not None:
            start_s, end_s = (round(t_s, 3) for t_s in self.marked_s)
            camera = None if self._camera.value == _ALL else self._camera.value
            self._mark(None)
            self._change(exclusions=(*self.edits.exclusions, Exclusion(start_s=start_s, end_s=end_s, camera=camera)))

    def _rename(self, person: int, name: str) -> None:
        if name.strip():
            known = self._names
            names = list(self.edits.names) or [known.get(i, f"person {i}") for i in range(max(known) + 1)]
            names += [f"person {i}" for i in range(len(names), person + 1)]
            names[person] = name.strip()[:64]
            self._change(names=tuple(names))

    def _change(self, **changes: object) -> None:
        with refusals():
            edits: Edits = dataclasses.replace(self.edits, **changes)  # type: ignore[arg-type]
            check_edits(edits, self._recording)
            write_edits(self._path, edits)
            self.edits = edits
        self._show()

    def _list(self, exclusions: tuple[Exclusion, ...]) -> None:
        for one in exclusions:
            with ui.row().classes("pf-edit"):
                ui.icon("content_cut")
                ui.label(f"{one.camera or 'all cameras'}, {one.start_s:.2f} to {one.end_s:.2f} s")
                others = tuple(other for other in exclusions if other is not one)
                icon_button("close", "Remove", lambda others=others: self._change(exclusions=others))

    def _start(self) -> None:
        workspace = self._studio.workspace
        with refusals():
            check_name(self._out.value)
            parent = recording_place(self._name).parent.as_posix()
            # without the "./" of a recording at the top
            out = PurePosixPath(workspace.free_name(parent, self._out.value)).as_posix()
            arguments = {"result": self._name, "out": out, "edits": plain(dataclasses.asdict(self.edits))}
            self._studio.jobs.start("solve", f"Solve {self._name} again", arguments, page="/recordings")
            ui.notify(f"Solving again into {out}")
