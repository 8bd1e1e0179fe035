"""Simulate: plan a rig in a room, see what it covers and how exact it will be, render a test walk."""

from __future__ import annotations

import asyncio
import base64
from collections.abc import Callable
from dataclasses import dataclass, replace
from html import escape

import cv2
import numpy as np
from nicegui import events, ui

import posefuse as pf
from posefuse.core.arrays import Array
from posefuse.foundation.settings import settings_from_mapping
from posefuse_sim import rig_plan
from posefuse_sim.build import room_size
from posefuse_sim.cameras import ImageSettings, PlacedCamera, placed_cameras
from posefuse_sim.scene import Scene, plain_settings, read_scene, scene_text
from posefuse_studio.scene import RigScene
from posefuse_studio.scene_messages import setup_message
from posefuse_studio.shell import card, job_lines, recent, show_summary, small, title
from posefuse_studio.state import Studio
from posefuse_studio.workspace import check_name

PLANS, SESSIONS, RESULTS = "plans", "sessions", "results"
# coarse while a camera is dragged, fine when it rests
_COARSE_M, _FINE_M = 0.35, 0.1
_POLL_S = 0.12
_SIZES = {(640, 480): "640 x 480", (1280, 720): "1280 x 720", (1920, 1080): "1920 x 1080"}
_FIELD = "dense outlined"
# of a camera: label, from, to, step
_FIELDS = (
    ("View, degrees", 10, 140, 1),
    *((f"{axis}, m", -50, 50, 0.1) for axis in ("x", "y", "height")),
    *((f"looks at {axis}, m", -50, 50, 0.1) for axis in ("x", "y", "z")),
)


def build(studio: Studio) -> None:
    """Place the page."""
    title("Simulate", "Place cameras in a room: coverage and expected error at once, then a rendered test walk with exact truth.")
    _Plan(studio)


class _Plan:
    """The plan of one visitor."""

    def __init__(self, studio: Studio) -> None:
        self._studio, self._stream = studio, studio.page_stream(ui.context.client)
        self._scene: Scene = rig_plan.first_plan()
        self._chosen = self._cameras[0].name
        self._dragged, self._changed = "", True
        self._floor: Array | None = None
        with ui.element("div").classes("pf-split"):
            self._map_card()
            with ui.element("div").classes("pf-column"):
                with card():
                    self._expected = ui.column().classes("w-full")
                with card("3D"), ui.element("div").classes("pf-plan-3d"):
                    RigScene(self._stream, ellipsoids=False)
        with ui.element("div").classes("pf-split"):
            self._camera_card()
            self._walk_card()
        job_lines(studio, recent("simulate_walk"))
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

    def _camera_card(self) -> None:
        with card("Cameras") as head:
            with head:
                ui.button("Remove", icon="delete", on_click=self._remove).props("flat dense")
            self._name = ui.select([], label="Camera", on_change=lambda event: self._choose(event.value)).props(_FIELD)
            self._place = ui.column().classes("w-full")
        self._fill()

    def _fields(self) -> None:
        """Of the chosen camera and the room, with the values of now."""
        camera = rig_plan.camera_of(self._scene, self._chosen)
        self._name.set_options([one.name for one in self._cameras], value=camera.name)
        size_px = camera.image.size_px
        size = ui.select(_SIZES | {size_px: "{} x {}".format(*size_px)}, value=size_px, label="Image", on_change=lambda: edited())
        size.props(_FIELD)
        values = (camera.image.horizontal_fov_deg, *camera.position_m, *camera.look_at_m)
        with ui.row().classes("pf-tools"):
            fields = [_number(*field, value, lambda: edited()) for field, value in zip(_FIELDS, values, strict=True)]
        with ui.row().classes("pf-tools"):
            sides = [_number(f"room {axis}, m", 2, 40, 0.5, value, lambda: sized())
                     for axis, value in zip("xy", self._room.size_m, strict=True)]  # fmt: skip

        def edited() -> None:
            given = [field.value for field in fields]
            if None not in given:
                fov_deg, x, y, z, to_x, to_y, to_z = map(float, given)
                image = replace(camera.image, size_px=tuple(size.value), horizontal_fov_deg=fov_deg)
                moved = replace(camera, position_m=(x, y, z), look_at_m=(to_x, to_y, to_z), image=image)
                self._use(rig_plan.with_camera(self._scene, moved))

        def sized() -> None:
            if all(side.value for side in sides):
                size_m = (float(sides[0].value), float(sides[1].value))
                self._use(replace(self._scene, room=replace(self._scene.room, size_m=size_m)))

    def _walk_card(self) -> None:
        """Keep the plan as a scene file, open an earlier one, render a test walk in it."""
        workspace = self._studio.workspace

        def keep() -> str:
            check_name(name.value)
            scene = rig_plan.with_test_walk(self._scene, float(seconds.value or 6))
            # fields hold what is typed until they are left
            settings_from_mapping(plain_settings(scene), Scene, where="plan")
            file = workspace.free_name(PLANS, name.value, ".yaml")
            workspace.path(file).write_text(scene_text(scene), encoding="utf-8")
            ui.notify(f"Kept as {file}")
            offer()
            return file

        def offer() -> None:
            plans = [one for one in workspace.files(".yaml", ".yml") if one.startswith(f"{PLANS}/")]
            earlier.set_options(plans)
            earlier.set_visibility(bool(plans))

        def render() -> None:
            scene = keep()
            session, out = (workspace.free_name(folder, name.value) for folder in (SESSIONS, RESULTS))
            arguments = {"scene": scene, "session": session, "out": out}
            self._studio.jobs.start("simulate_walk", f"Test walk {name.value}", arguments)

        def open_earlier(file: str | None) -> None:
            if file:
                scene = rig_plan.listed_cameras(read_scene(workspace.existing(file)))
                size_m = room_size(scene, rig_plan.rig_of_scene(scene))
                self._scene = replace(scene, room=replace(scene.room, size_m=size_m))
                self._fill(self._cameras[0].name)

        with card("Test walk"):
            small("A person walks through the middle of the room; it is rendered, tracked and compared with the exact truth.")
            with ui.row().classes("pf-tools"):
                name = ui.input("Name", value="test-walk").props(_FIELD)
                seconds = ui.number("Seconds", value=6, min=1, max=120, step=1).props(_FIELD)
                ui.button("Render the walk", icon="directions_walk", on_click=render)
            with ui.row().classes("pf-tools"):
                earlier = ui.select([], label="Earlier plan", on_change=lambda event: open_earlier(event.value))
                earlier.props("dense outlined clearable").classes("w-56")
                offer()
                ui.button("Keep this plan", icon="save", on_click=keep).props("outline")

    @property
    def _room(self) -> RoomMap:
        return RoomMap(self._scene.room.size_m or (7.0, 7.0))

    @property
    def _cameras(self) -> tuple[PlacedCamera, ...]:
        return placed_cameras(self._scene.cameras)

    def _use(self, scene: Scene) -> None:
        self._scene, self._changed = scene, True

    def _pointed(self, event: events.MouseEventArguments) -> None:
        if event.type == "mousedown":
            self._dragged = nearest_camera(self._cameras, event.image_x, event.image_y, self._room)
            self._choose(self._dragged)
        elif self._dragged and (event.type == "mouseup" or not event.buttons):
            self._dragged = ""
            self._fill()
        elif self._dragged:
            camera = rig_plan.camera_of(self._scene, self._dragged)
            x_m, y_m = self._room.metres(event.image_x, event.image_y)
            self._use(rig_plan.with_camera(self._scene, replace(camera, position_m=(x_m, y_m, camera.position_m[2]))))

    def _choose(self, name: str) -> None:
        if name and name != self._chosen:
            self._fill(name)

    def _fill(self, chosen: str = "") -> None:
        """Give the fields the values of now, of another camera where one is chosen."""
        self._chosen, self._changed = chosen or self._chosen, True
        self._place.clear()
        with self._place:
            self._fields()

    def _add(self) -> None:
        name = rig_plan.free_camera_name(self._scene)
        at_m = (0.0, -self._room.size_m[1] / 2, 2.2)
        camera = PlacedCamera(name=name, position_m=at_m, image=ImageSettings())
        self._use(rig_plan.with_camera(self._scene, camera))
        self._choose(name)

    def _remove(self) -> None:
        self._use(rig_plan.without_camera(self._scene, self._chosen))
        self._fill(self._cameras[0].name)

    def _draw_map(self) -> None:
        size_px = self._room.size_px
        if self._map.props["size"] != size_px:
            self._map.props["size"] = size_px
            # which the element does for its first size only
            self._map.run_method("updateViewbox", *size_px)
        self._map.set_content(room_svg(self._room, self._cameras, self._chosen, self._floor))

    async def _follow(self) -> None:
        """Draw what has changed; the newest plan wins, as the timer calls this again when it has ended."""
        if not self._changed:
            return
        self._changed = False
        scene, room = self._scene, self._room
        self._draw_map()
        self._studio.streams[self._stream].publish("setup", setup_message(rig_plan.rig_of_scene(scene)), keep=True)
        step_m = _COARSE_M if self._dragged else _FINE_M
        plan = await asyncio.to_thread(lambda: pf.plan(scene, area_m=room.size_m, step_m=step_m))
        self._floor = error_map(plan)
        self._draw_map()
        self._expected.clear()
        with self._expected:
            show_summary(plan.summary())


def _number(label: str, least: float, most: float, step: float, value: float, on_change: Callable[[], None]) -> ui.number:
    field = ui.number(label, value=value, min=least, max=most, step=step, format="%.4g", on_change=on_change)
    return field.props(_FIELD).classes("pf-number")


WIDTH_PX = 760
# of the colours, in mm
BEST_MM, WORST_MM = 10.0, 60.0
_MARGIN_M = 0.4
_REACH_M = 1.1
_UNSEEN_BGR = (120, 110, 105)


@dataclass(frozen=True)
class RoomMap:
    """Metres of a room about the origin to pixels of the picture: x to the right, y up."""

    size_m: tuple[float, float]

    @property
    def scale(self) -> float:
        """Pixels per metre."""
        return WIDTH_PX / (self.size_m[0] + 2 * _MARGIN_M)

    @property
    def size_px(self) -> tuple[int, int]:
        """(width, height)."""
        return WIDTH_PX, round((self.size_m[1] + 2 * _MARGIN_M) * self.scale)

    def px(self, x_m: float, y_m: float) -> tuple[float, float]:
        """Where a place lies."""
        width, height = self.size_px
        return width / 2 + x_m * self.scale, height / 2 - y_m * self.scale

    def metres(self, x_px: float, y_px: float) -> tuple[float, float]:
        """The place at a pixel, within the room, to the centimetre."""
        width, height = self.size_px
        half_x, half_y = (size / 2 for size in self.size_m)
        x, y = (x_px - width / 2) / self.scale, (height / 2 - y_px) / self.scale
        return round(float(np.clip(x, -half_x, half_x)), 2), round(float(np.clip(y, -half_y, half_y)), 2)


def error_map(plan: rig_plan.RigPlan) -> Array:
    """The expected error over the floor in colours, BGR, a pixel a place; grey where fewer than two cameras see."""
    error = plan.error_map_mm
    share = np.clip((error - BEST_MM) / (WORST_MM - BEST_MM), 0, 1)
    colours = cv2.applyColorMap(np.nan_to_num(255 * (1 - share)).astype(np.uint8), cv2.COLORMAP_VIRIDIS)
    return np.where(np.isfinite(error)[..., None], colours, np.array(_UNSEEN_BGR, np.uint8))[::-1]


def room_svg(room: RoomMap, cameras: tuple[PlacedCamera, ...], chosen: str, floor: Array | None = None) -> str:
    """The floor in its colours, the walls, a grid of metres, and cameras with their fields of view and names."""
    (left, top), (width, height) = room.px(-room.size_m[0] / 2, room.size_m[1] / 2), np.multiply(room.size_m, room.scale)
    place = f'x="{left:.0f}" y="{top:.0f}" width="{width:.0f}" height="{height:.0f}"'
    parts = []
    if floor is not None:
        image = base64.b64encode(cv2.imencode(".png", floor)[1].tobytes()).decode()
        parts.append(
            f'<image {place} preserveAspectRatio="none" style="image-rendering: pixelated" href="data:image/png;base64,{image}"/>'
        )
    middle_x, middle_y = room.px(0, 0)
    parts.append(
        f'<pattern id="metres" patternUnits="userSpaceOnUse" x="{middle_x}" y="{middle_y}" width="{room.scale}"'
        f' height="{room.scale}"><path d="M0 {room.scale}V0H{room.scale}" fill="none" stroke="#fff" stroke-opacity="0.36"/>'
        "</pattern>"
        f'<rect {place} fill="url(#metres)" stroke="#546e7a" stroke-width="3"/>'
    )
    return "".join([*parts, *(_camera(camera, camera.name == chosen, room) for camera in cameras)])


def nearest_camera(cameras: tuple[PlacedCamera, ...], x_px: float, y_px: float, room: RoomMap, reach_px: float = 34) -> str:
    """The name of the camera at a pixel; empty where none is near."""
    away = {one.name: float(np.hypot(*np.subtract(room.px(*one.position_m[:2]), (x_px, y_px)))) for one in cameras}
    name = min(away, key=lambda one: away[one], default="")
    return name if name and away[name] <= reach_px else ""


def _camera(camera: PlacedCamera, chosen: bool, room: RoomMap) -> str:
    x, y = room.px(*camera.position_m[:2])
    to_x, to_y = np.subtract(camera.look_at_m[:2], camera.position_m[:2])
    angle = np.arctan2(to_y, to_x) if np.hypot(to_x, to_y) > 1e-6 else np.pi / 2
    half = np.deg2rad(camera.image.horizontal_fov_deg / 2)
    sides = (angle - half, angle + half)
    ends = [room.px(*np.add(camera.position_m[:2], (_REACH_M * np.cos(one), _REACH_M * np.sin(one)))) for one in sides]
    corners = " ".join(f"{px:.0f},{py:.0f}" for px, py in ((x, y), *ends))
    colour = "#ffb300" if chosen else "#ffffff"
    label_y = y - 18 if y > 40 else y + 32
    return (
        f'<polygon points="{corners}" fill="{colour}" fill-opacity="0.35" stroke="{colour}" stroke-width="1.5"/>'
        f'<circle cx="{x:.0f}" cy="{y:.0f}" r="12" fill="#10222b" stroke="{colour}" stroke-width="4"/>'
        f'<text x="{x:.0f}" y="{label_y:.0f}" font-size="18" font-weight="700" text-anchor="middle" fill="{colour}" '
        f'stroke="#10222b" stroke-width="4" paint-order="stroke">{escape(camera.name)}</text>'
    )
