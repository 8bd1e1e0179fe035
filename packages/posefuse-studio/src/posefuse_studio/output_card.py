"""What can be made of a recording: its report, and files for other programs."""

from __future__ import annotations

from nicegui import ui

from posefuse.core import PosefuseError
from posefuse.foundation.plugins import list_plugins
from posefuse.pipeline.reports import PAGE_FILE, report_folder

from .job_cards import file_address
from .shell import card, refused
from .state import Studio
from .workspace import recording_place

_FIRST = ("trc", "c3d", "csv")


def output_card(studio: Studio, name: str) -> None:
    """The card of a recording by its name in the workspace."""
    page = report_folder(studio.workspace.existing(name)) / PAGE_FILE
    formats = [one.name for one in list_plugins("outputs") if one.config is not None]

    def start(work: str, what: str, **more: object) -> None:
        try:
            studio.jobs.start(work, f"{what} of {name}", {"result": name, **more}, page="/recordings")
        except PosefuseError as error:
            refused(error)

    with card("Report and files"):
        with ui.row().classes("pf-tools"):
            ui.button("Make the report", icon="description", on_click=lambda: start("report", "Report"))
            if page.is_file():
                ui.link("Open the earlier report", file_address(studio.workspace.name_of(page)), new_tab=True)
        with ui.row().classes("pf-tools"):
            chosen = ui.select(
                formats, multiple=True, value=[one for one in _FIRST if one in formats], label="Formats"
            ).props("dense outlined use-chips").classes("pf-formats")  # fmt: skip
            ui.button(
                "Export",
                icon="file_download",
                on_click=lambda: start(
                    "export",
                    "Files",
                    formats=list(chosen.value),
                    out=studio.workspace.free_name("exports", recording_place(name).stem),
                ),
            )
