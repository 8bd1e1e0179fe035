"""Keeping a plan as a scene file, opening an earlier one, and rendering a test walk in it."""

from __future__ import annotations

from collections.abc import Callable

from nicegui import ui

from posefuse.core import PosefuseError
from posefuse_sim.rig_plan import listed_cameras, with_test_walk
from posefuse_sim.scene import Scene, read_scene, scene_text

from .shell import card, refused
from .state import Studio
from .workspace import check_name

PLANS, SESSIONS, RESULTS = "plans", "sessions", "results"
_ABOUT = "A person walks through the middle of the room. Every camera is rendered, tracked and compared with the exact truth."


def walk_card(studio: Studio, plan: Callable[[], Scene], opened: Callable[[Scene], None]) -> None:
    """The card.

    Args:
        plan: gives the scene as it is planned now. opened: takes a scene that was kept earlier.
    """
    workspace = studio.workspace

    def keep() -> str:
        """The name of the scene file; empty where it could not be written."""
        try:
            check_name(name.value)
            file = workspace.free_name(PLANS, name.value, ".yaml")
            text = scene_text(with_test_walk(plan(), float(seconds.value or 6)))
            workspace.path(file).write_text(text, encoding="utf-8")
        except (PosefuseError, OSError) as error:
            refused(error)
            return ""
        ui.notify(f"Kept as {file}")
        return file

    def render() -> None:
        if scene := keep():
            session, out = (workspace.free_name(folder, name.value) for folder in (SESSIONS, RESULTS))
            arguments = {"scene": scene, "session": session, "out": out}
            studio.jobs.start("simulate_walk", f"Test walk {name.value}", arguments, page="/simulate")

    def open_earlier(file: str | None) -> None:
        try:
            if file:
                opened(listed_cameras(read_scene(workspace.existing(file))))
        except PosefuseError as error:
            refused(error)

    with card("Test walk"):
        ui.label(_ABOUT).classes("pf-small")
        with ui.row().classes("pf-tools"):
            name = ui.input("Name", value="test-walk").props("dense outlined")
            seconds = ui.number("Seconds", value=6, min=1, max=120, step=1).props("dense outlined")
            ui.button("Render the walk", icon="directions_walk", on_click=render)
        with ui.row().classes("pf-tools"):
            plans = [one for one in workspace.files(".yaml", ".yml") if one.startswith(f"{PLANS}/")]
            earlier = ui.select(plans, label="Earlier plan", on_change=lambda e: open_earlier(e.value))
            earlier.props("dense outlined clearable").classes("w-56").set_visibility(bool(plans))
            ui.button("Keep this plan", icon="save", on_click=keep).props("outline")
