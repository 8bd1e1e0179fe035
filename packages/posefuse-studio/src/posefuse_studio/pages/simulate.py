"""Simulate: plan a rig in a room, see what it covers and how exact it will be, render a test walk."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import replace

from nicegui import events, ui

import posefuse as pf
from posefuse.core import PosefuseError
from posefuse_sim.cameras import ImageSettings, PlacedCamera, placed_cameras
from posefuse_sim.rig_plan import (
    RigPlan,
    camera_of,
    first_plan,
    free_camera_name,
    rig_of_scene,
    with_camera,
    without_camera,
)
from posefuse_sim.scene import Scene
from posefuse_studio.job_cards import job_cards
from posefuse_studio.plan_view import BEST_MM, WORST_MM, RoomMap, cameras_svg, error_map_data_url, nearest_camera
from posefuse_studio.scene.messages import setup_message
from posefuse_studio.scene.setup import scene_setup
from posefuse_studio.scene.view import RigScene
from posefuse_studio.shell import card, refused, title
from posefuse_studio.state import Studio
from posefuse_studio.walk_card import walk_card

# coarse while a camera is dragged, fine when it rests
_COARSE_M, _FINE_M = 0.35, 0.1
_POLL_S = 0.12
_SIZES = {(640, 480): "640 x 480", (1280, 720): "1280 x 720", (1920, 1080): "1920 x 1080"}


def build(studio: Studio) -> None:
    """Place the page."""
    title("Simulate", "Place cameras in a room: coverage and expected error at once, then a rendered test walk with exact truth.")
    _Plan(studio)


class _Plan:
    """The plan of one visitor."""

    def __init__(self, studio: Studio) -> None:
        self._studio, self._client = studio, ui.context.client
        self._scene: Scene = first_plan()
        self._chosen = placed_cameras(self._scene.cameras)[0].name
        self._dragged, self._changed, self._busy, self._filling = "", True, False, True
        self._stream_name = f"plan-{self._client.id}"
        self._stream = studio.stream(self._stream_name)
        self._client.on_delete(lambda: studio.drop_stream(self._stream_name))
        with ui.element("div").classes("pf-split"):
            self._map_card()
            with ui.element("div").classes("pf-column"):
                self._figures_card()
                with card("3D"), ui.element("div").classes("pf-plan-3d"):
                    RigScene(self._stream_name, ellipsoids=False)
        with ui.element("div").classes("pf-split"):
            self._camera_card()
            walk_card(studio, lambda: self._scene, self._opened)
        job_cards(studio, ("simulate_walk",))
        self._show_camera()
        ui.timer(_POLL_S, self._follow)

    def _map_card(self) -> None:
        with card("Room from above: drag a camera") as head:
            with head:
                ui.space()
                ui.button("Add a camera", icon="add_a_photo", on_click=self._add).props("flat dense")
            self._map = ui.interactive_image(
                size=self._room.size_px, sanitize=False, events=["mousedown", "mousemove", "mouseup"], on_mouse=self._pointed
            ).classes("pf-plan")
            with ui.row().classes("pf-tools"):
                ui.label(f"{BEST_MM:.0f} mm").classes("pf-small")
                ui.element("div").classes("pf-legend").props('role="img" aria-label="yellow is exact, violet is not"')
                ui.label(f"{WORST_MM:.0f} mm or more; grey: fewer than two cameras see a person from ankle to head").classes(
                    "pf-small"
                )

    def _figures_card(self) -> None:
        with card("What to expect"), ui.row().classes("pf-figures"):
            self._figures = {}
            for name, words in (
                ("two", "of the floor seen by 2 cameras"),
                ("three", "seen by 3"),
                ("median", "median error of a keypoint"),
                ("p95", "95 % of the covered floor below"),
            ):
                with ui.column().classes("pf-figure-box"):
                    self._figures[name] = ui.label("-").classes("pf-figure")
                    ui.label(words).classes("pf-small")

    def _camera_card(self) -> None:
        with card("Cameras") as head:
            with head:
                ui.space()
                ui.button("Remove", icon="delete", on_click=self._remove).props("flat dense")
            with ui.row().classes("pf-tools"):
                self._name = ui.select([], label="Camera", on_change=lambda e: self._choose(e.value)).props("dense outlined")
                self._size = ui.select(_SIZES, label="Image", on_change=self._edited).props("dense outlined")
                self._fov = self._number("View, degrees", 10, 140, 1)
            with ui.row().classes("pf-tools"):
                self._place = [self._number(f"{axis}, m", -50, 50, 0.1) for axis in ("x", "y", "height")]
            with ui.row().classes("pf-tools"):
                self._look = [self._number(f"looks at {axis}, m", -50, 50, 0.1) for axis in ("x", "y", "z")]
            with ui.row().classes("pf-tools"):
                width, depth = self._scene.room.size_m or (7.0, 7.0)
                self._width = self._number("room x, m", 2, 40, 0.5, self._sized, width)
                self._depth = self._number("room y, m", 2, 40, 0.5, self._sized, depth)

    def _number(
        self,
        label: str,
        least: float,
        most: float,
        step: float,
        on_change: Callable[[], None] | None = None,
        value: float = 0.0,
    ) -> ui.number:
        field = ui.number(label, value=value, min=least, max=most, step=step, format="%.4g", on_change=on_change or self._edited)
        return field.props("dense outlined").classes("pf-number")

    @property
    def _room(self) -> RoomMap:
        return RoomMap(self._scene.room.size_m or (7.0, 7.0))

    @property
    def _cameras(self) -> tuple[PlacedCamera, ...]:
        return placed_cameras(self._scene.cameras)

    def _take(self, scene: Scene) -> None:
        self._scene, self._changed = scene, True

    def _try(self, change: Callable[[], Scene]) -> None:
        try:
            self._take(change())
        except PosefuseError as error:
            refused(error)

    def _pointed(self, event: events.MouseEventArguments) -> None:
        if event.type == "mousedown":
            self._dragged = nearest_camera(self._cameras, event.image_x, event.image_y, self._room)
            if self._dragged:
                self._choose(self._dragged)
        elif event.type == "mouseup" or not event.buttons:
            if self._dragged:
                self._dragged, self._changed = "", True
                self._show_camera()
        elif self._dragged:
            camera = camera_of(self._scene, self._dragged)
            x_m, y_m = self._room.metres(event.image_x, event.image_y)
            self._try(lambda: with_camera(self._scene, replace(camera, position_m=(x_m, y_m, camera.position_m[2]))))

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
        self._fov.set_value(camera.image.horizontal_fov_deg)
        for field, value in zip((*self._place, *self._look), (*camera.position_m, *camera.look_at_m), strict=True):
            field.set_value(value)
        self._filling = False

    def _edited(self) -> None:
        values = [field.value for field in (self._fov, *self._place, *self._look)]
        if self._filling or self._dragged or any(value is None for value in values) or self._size.value is None:
            return
        camera = camera_of(self._scene, self._chosen)
        image = replace(camera.image, size_px=tuple(self._size.value), horizontal_fov_deg=float(values[0]))
        x, y, z, to_x, to_y, to_z = map(float, values[1:])
        changed = replace(camera, position_m=(x, y, z), look_at_m=(to_x, to_y, to_z), image=image)
        if changed != camera and self._name.value == camera.name:
            self._try(lambda: with_camera(self._scene, changed))

    def _sized(self) -> None:
        width, depth = self._width.value, self._depth.value
        if width and depth and (width, depth) != self._scene.room.size_m:
            self._take(replace(self._scene, room=replace(self._scene.room, size_m=(float(width), float(depth)))))
            self._map.props(f'size="{self._room.size_px}"')
            self._map._props["size"] = self._room.size_px

    def _add(self) -> None:
        name = free_camera_name(self._scene)
        camera = PlacedCamera(name=name, position_m=(0.0, -self._room.size_m[1] / 2, 2.2), image=ImageSettings())
        self._try(lambda: with_camera(self._scene, camera))
        self._choose(name)

    def _remove(self) -> None:
        self._try(lambda: without_camera(self._scene, self._chosen))
        self._chosen = self._cameras[0].name
        self._show_camera()

    def _opened(self, scene: Scene) -> None:
        self._take(scene)
        self._chosen = self._cameras[0].name
        self._show_camera()

    async def _follow(self) -> None:
        """Draw what has changed; the newest plan wins."""
        if not self._changed or self._busy:
            return
        self._changed, self._busy = False, True
        try:
            scene, room = self._scene, self._room
            self._map.set_content(cameras_svg(self._cameras, self._chosen, room))
            self._stream.publish("setup", setup_message(scene_setup(rig_of_scene(scene))), keep=True)
            step_m = _COARSE_M if self._dragged else _FINE_M
            plan = await asyncio.to_thread(lambda: pf.plan(scene, area_m=room.size_m, step_m=step_m))
            self._map.set_source(error_map_data_url(plan, room))
            self._show_figures(plan)
        except PosefuseError as error:
            refused(error)
        finally:
            self._busy = False

    def _show_figures(self, plan: RigPlan) -> None:
        self._figures["two"].set_text(f"{plan.covered(2):.0%}")
        self._figures["three"].set_text(f"{plan.covered(3):.0%}")
        for name, share in (("median", 0.5), ("p95", 0.95)):
            value = plan.error_at(share)
            self._figures[name].set_text(f"{value:.0f} mm" if value == value else "-")
