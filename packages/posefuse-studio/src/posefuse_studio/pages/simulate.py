"""Simulate: plan a rig in a room, see what it covers and how exact it will be, render a test walk."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import replace

from nicegui import events, ui

import posefuse as pf
from posefuse_sim.cameras import ImageSettings, PlacedCamera, placed_cameras
from posefuse_sim.rig_plan import (
    RigPlan,
    camera_of,
    first_plan,
    free_camera_name,
    listed_cameras,
    rig_of_scene,
    with_camera,
    with_test_walk,
    without_camera,
)
from posefuse_sim.scene import Scene, read_scene, scene_text
from posefuse_studio.plan_view import BEST_MM, WORST_MM, RoomMap, cameras_svg, error_map_data_url, nearest_camera
from posefuse_studio.scene.messages import setup_message
from posefuse_studio.scene.setup import scene_setup
from posefuse_studio.scene.view import RigScene
from posefuse_studio.shell import card, job_cards, refusals, small, title
from posefuse_studio.state import Studio
from posefuse_studio.workspace import check_name

PLANS, SESSIONS, RESULTS = "plans", "sessions", "results"
# coarse while a camera is dragged, fine when it rests
_COARSE_M, _FINE_M = 0.35, 0.1
_POLL_S = 0.12
_SIZES = {(640, 480): "640 x 480", (1280, 720): "1280 x 720", (1920, 1080): "1920 x 1080"}
# of a camera: label, from, to, step; in the order of `_values`
_FIELDS = (
    ("View, degrees", 10, 140, 1),
    *((f"{axis}, m", -50, 50, 0.1) for axis in ("x", "y", "height")),
    *((f"looks at {axis}, m", -50, 50, 0.1) for axis in ("x", "y", "z")),
)


def _mm(value: float) -> str:
    return f"{value:.0f} mm" if value == value else "-"


_FIGURES: dict[str, Callable[[RigPlan], str]] = {
    "of the floor seen by 2 cameras": lambda plan: f"{plan.covered(2):.0%}",
    "seen by 3": lambda plan: f"{plan.covered(3):.0%}",
    "median error of a keypoint": lambda plan: _mm(plan.error_at(0.5)),
    "95 % of the covered floor below": lambda plan: _mm(plan.error_at(0.95)),
}


def build(studio: Studio) -> None:
    """Place the page."""
    title("Simulate", "Place cameras in a room: coverage and expected error at once, then a rendered test walk with exact truth.")
    _Plan(studio)


class _Plan:
    """The plan of one visitor."""

    def __init__(self, studio: Studio) -> None:
        self._studio, client = studio, ui.context.client
        self._scene: Scene = first_plan()
        self._chosen = self._cameras[0].name
        self._dragged, self._changed, self._busy, self._filling = "", True, False, True
        name = f"plan-{client.id}"
        self._stream = studio.stream(name)
        client.on_delete(lambda: studio.drop_stream(name))
        with ui.element("div").classes("pf-split"):
            self._map_card()
            with ui.element("div").classes("pf-column"):
                self._figures_card()
                with card("3D"), ui.element("div").classes("pf-plan-3d"):
                    RigScene(name, ellipsoids=False)
        with ui.element("div").classes("pf-split"):
            self._camera_card()
            self._walk_card()
        job_cards(studio, ("simulate_walk",))
        self._show_camera()
        ui.timer(_POLL_S, self._follow)

    def _map_card(self) -> None:
        with card("Room from above: drag a camera") as head:
            with head:
                ui.button("Add a camera", icon="add_a_photo", on_click=self._add).props("flat dense")
            self._map = ui.interactive_image(
                size=self._room.size_px, sanitize=False, events=["mousedown", "mousemove", "mouseup"], on_mouse=self._pointed
            ).classes("pf-plan")
            with ui.row().classes("pf-tools"):
                small(f"{BEST_MM:.0f} mm")
                ui.element("div").classes("pf-legend").props('role="img" aria-label="yellow is exact, violet is not"')
                small(f"{WORST_MM:.0f} mm or more; grey: fewer than two cameras see a person from ankle to head")

    def _figures_card(self) -> None:
        self._figures = []
        with card("What to expect"), ui.row().classes("pf-figures"):
            for about in _FIGURES:
                with ui.column().classes("pf-figure-box"):
                    self._figures.append(ui.label("-").classes("pf-figure"))
                    small(about)

    def _camera_card(self) -> None:
        with card("Cameras") as head:
            with head:
                ui.button("Remove", icon="delete", on_click=self._remove).props("flat dense")
            with ui.row().classes("pf-tools"):
                self._name = ui.select([], label="Camera", on_change=lambda event: self._choose(event.value))
                self._size = ui.select(_SIZES, label="Image", on_change=self._edited)
                for chooser in (self._name, self._size):
                    chooser.props("dense outlined")
            with ui.row().classes("pf-tools"):
                self._fields = [self._number(*field, self._edited) for field in _FIELDS]
            with ui.row().classes("pf-tools"):
                self._sides = [self._number(f"room {axis}, m", 2, 40, 0.5, self._sized) for axis in ("x", "y")]

    def _number(self, label: str, least: float, most: float, step: float, on_change: Callable[[], None]) -> ui.number:
        field = ui.number(label, value=0.0, min=least, max=most, step=step, format="%.4g", on_change=on_change)
        return field.props("dense outlined").classes("pf-number")

    def _walk_card(self) -> None:
        """Keep the plan as a scene file, open an earlier one, render a test walk in it."""
        workspace = self._studio.workspace

        def keep() -> str:
            check_name(name.value)
            file = workspace.free_name(PLANS, name.value, ".yaml")
            text = scene_text(with_test_walk(self._scene, float(seconds.value or 6)))
            workspace.path(file).write_text(text, encoding="utf-8")
            ui.notify(f"Kept as {file}")
            return file

        def try_keep() -> None:
            with refusals():
                keep()

        def render() -> None:
            with refusals():
                scene = keep()
                session, out = (workspace.free_name(folder, name.value) for folder in (SESSIONS, RESULTS))
                arguments = {"scene": scene, "session": session, "out": out}
                self._studio.jobs.start("simulate_walk", f"Test walk {name.value}", arguments, page="/simulate")

        def open_earlier(file: str | None) -> None:
            with refusals():
                if file:
                    self._scene, self._changed = listed_cameras(read_scene(workspace.existing(file))), True
                    self._chosen = self._cameras[0].name
                    self._show_camera()

        with card("Test walk"):
            small("A person walks through the middle of the room; it is rendered, tracked and compared with the exact truth.")
            with ui.row().classes("pf-tools"):
                name = ui.input("Name", value="test-walk").props("dense outlined")
                seconds = ui.number("Seconds", value=6, min=1, max=120, step=1).props("dense outlined")
                ui.button("Render the walk", icon="directions_walk", on_click=render)
            with ui.row().classes("pf-tools"):
                plans = [one for one in workspace.files(".yaml", ".yml") if one.startswith(f"{PLANS}/")]
                earlier = ui.select(plans, label="Earlier plan", on_change=lambda event: open_earlier(event.value))
                earlier.props("dense outlined clearable").classes("w-56").set_visibility(bool(plans))
                ui.button("Keep this plan", icon="save", on_click=try_keep).props("outline")

    @property
    def _room(self) -> RoomMap:
        return RoomMap(self._scene.room.size_m or (7.0, 7.0))

    @property
    def _cameras(self) -> tuple[PlacedCamera, ...]:
        return placed_cameras(self._scene.cameras)

    def _try(self, change: Callable[..., Scene], camera: PlacedCamera | str) -> None:
        with refusals():
            self._scene, self._changed = change(self._scene, camera), True

    def _pointed(self, event: events.MouseEventArguments) -> None:
        if event.type == "mousedown":
            self._dragged = nearest_camera(self._cameras, event.image_x, event.image_y, self._room)
            self._choose(self._dragged)
        elif self._dragged and (event.type == "mouseup" or not event.buttons):
            self._dragged, self._changed = "", True
            self._show_camera()
        elif self._dragged:
            camera = camera_of(self._scene, self._dragged)
            x_m, y_m = self._room.metres(event.image_x, event.image_y)
            self._try(with_camera, replace(camera, position_m=(x_m, y_m, camera.position_m[2])))

    def _choose(self, name: str) -> None:
        if name and name != self._chosen and not self._filling:
            self._chosen, self._changed = name, True
            self._show_camera()

    def _show_camera(self) -> None:
        """Fill the fields with the chosen camera; `_edited` does not count what is filled in."""
        camera, self._filling = camera_of(self._scene, self._chosen), True
        self._name.set_options([one.name for one in self._cameras], value=camera.name)
        sizes = _SIZES | {camera.image.size_px: "{} x {}".format(*camera.image.size_px)}
        self._size.set_options(sizes, value=camera.image.size_px)
        values = (camera.image.horizontal_fov_deg, *camera.position_m, *camera.look_at_m, *self._room.size_m)
        for field, value in zip((*self._fields, *self._sides), values, strict=True):
            field.set_value(value)
        self._filling = False

    def _edited(self) -> None:
        values = [field.value for field in self._fields]
        if self._filling or self._dragged or None in values or self._size.value is None:
            return
        camera = camera_of(self._scene, self._chosen)
        fov_deg, x, y, z, to_x, to_y, to_z = map(float, values)
        image = replace(camera.image, size_px=tuple(self._size.value), horizontal_fov_deg=fov_deg)
        changed = replace(camera, position_m=(x, y, z), look_at_m=(to_x, to_y, to_z), image=image)
        if changed != camera and self._name.value == camera.name:
            self._try(with_camera, changed)

    def _sized(self) -> None:
        sides = [field.value for field in self._sides]
        if not self._filling and all(sides):
            size_m = (float(sides[0]), float(sides[1]))
            self._scene, self._changed = replace(self._scene, room=replace(self._scene.room, size_m=size_m)), True
            self._map._props["size"] = self._room.size_px

    def _add(self) -> None:
        name = free_camera_name(self._scene)
        at_m = (0.0, -self._room.size_m[1] / 2, 2.2)
        self._try(with_camera, PlacedCamera(name=name, position_m=at_m, image=ImageSettings()))
        self._choose(name)

    def _remove(self) -> None:
        self._try(without_camera, self._chosen)
        self._chosen = self._cameras[0].name
        self._show_camera()

    async def _follow(self) -> None:
        """Draw what has changed; the newest plan wins."""
        if not self._changed or self._busy:
            return
        self._changed, self._busy = False, True
        scene, room = self._scene, self._room
        self._map.set_content(cameras_svg(self._cameras, self._chosen, room))
        self._stream.publish("setup", setup_message(scene_setup(rig_of_scene(scene))), keep=True)
        step_m = _COARSE_M if self._dragged else _FINE_M
        with refusals():
            plan = await asyncio.to_thread(lambda: pf.plan(scene, area_m=room.size_m, step_m=step_m))
            self._map.set_source(error_map_data_url(plan, room))
            for label, text in zip(self._figures, _FIGURES.values(), strict=True):
                label.set_text(text(plan))
        self._busy = False
