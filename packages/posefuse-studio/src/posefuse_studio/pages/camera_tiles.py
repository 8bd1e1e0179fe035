"""Images of the cameras of a session, each with how the camera is: the same on every page."""

from __future__ import annotations

from nicegui import ui

from posefuse_studio.live_link import LiveLink
from posefuse_studio.scene.view import CameraTile
from posefuse_studio.shell import light, redrawn, small


def camera_tiles(link: LiveLink, stream: str, *, overlay: bool = True, classes: str = "pf-grid") -> list[CameraTile]:
    """A tile for each camera of a session; `stream`: what they draw."""
    tiles = []
    with ui.element("div").classes(classes):
        for number, (name, one) in enumerate(link.status.cameras.items()):
            width, height = one.size_wh or (4, 3)
            with ui.column().classes("pf-tile-box"):
                tiles.append(CameraTile(stream, number, aspect=width / height, name=name, overlay=overlay))
                _foot(link, name)
    return tiles


def _foot(link: LiveLink, name: str) -> None:
    def now(what: str) -> str:
        # none for a moment, when the session has ended
        return getattr(link.status.cameras.get(name), what, "")

    def draw(state: tuple[str, str]) -> None:
        if state[0]:
            light(state[0], name if state[0] != "bad" else f"{name}: {state[1]}")

    with ui.row().classes("pf-tile-foot"):
        redrawn(lambda: (now("light"), now("state")), draw, classes="pf-light-place")
        small("").bind_text_from(link, "status", lambda _: now("figures"))
    why = small("").bind_text_from(link, "status", lambda _: now("text"))
    why.bind_visibility_from(link, "status", lambda _: bool(now("text")))
