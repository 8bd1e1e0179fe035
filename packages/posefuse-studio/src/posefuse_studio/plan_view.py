"""A planned room from above: the expected error as colours, cameras to drag."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from html import escape

import cv2
import numpy as np

from posefuse_sim.cameras import PlacedCamera
from posefuse_sim.rig_plan import RigPlan

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


def error_map_data_url(plan: RigPlan, room: RoomMap) -> str:
    """The expected error over the floor as a PNG, as the address of itself; grey where fewer than two cameras see."""
    error = plan.error_map_mm
    share = np.clip((error - BEST_MM) / (WORST_MM - BEST_MM), 0, 1)
    colours = cv2.applyColorMap(np.nan_to_num(255 * (1 - share)).astype(np.uint8), cv2.COLORMAP_VIRIDIS)
    colours = np.where(np.isfinite(error)[..., None], colours, np.array(_UNSEEN_BGR, np.uint8))[::-1]
    width, height = room.size_px
    picture = np.full((height, width, 4), 0, np.uint8)
    left, top = (round(value) for value in room.px(-room.size_m[0] / 2, room.size_m[1] / 2))
    right, bottom = (round(value) for value in room.px(room.size_m[0] / 2, -room.size_m[1] / 2))
    floor = cv2.resize(colours, (right - left, bottom - top), interpolation=cv2.INTER_NEAREST)
    picture[top:bottom, left:right] = np.dstack([floor, np.full(floor.shape[:2], 255, np.uint8)])
    _, encoded = cv2.imencode(".png", picture)
    return f"data:image/png;base64,{base64.b64encode(encoded.tobytes()).decode()}"


def cameras_svg(cameras: tuple[PlacedCamera, ...], chosen: str, room: RoomMap) -> str:
    """Overlays of the colour map: walls, cameras with their fields of view, names."""
    left, top = room.px(-room.size_m[0] / 2, room.size_m[1] / 2)
    width, height = (size * room.scale for size in room.size_m)
    wall = f'<rect x="{left:.0f}" y="{top:.0f}" width="{width:.0f}" height="{height:.0f}" fill="none" stroke="#546e7a"'
    half_x, half_y = (size / 2 for size in room.size_m)
    grid: list[tuple[tuple[float, float], tuple[float, float]]]
    grid = [((x, -half_y), (x, half_y)) for x in range(-int(half_x), int(half_x) + 1)]
    grid += [((-half_x, y), (half_x, y)) for y in range(-int(half_y), int(half_y) + 1)]
    parts = [f'{wall} stroke-width="3"/>']
    for (x1, y1), (x2, y2) in ((room.px(*a), room.px(*b)) for a, b in grid):
        parts.append(f'<line x1="{x1:.0f}" y1="{y1:.0f}" x2="{x2:.0f}" y2="{y2:.0f}" stroke="#fff" stroke-opacity="0.18"/>')
    parts += [_camera(camera, camera.name == chosen, room) for camera in cameras]
    return "".join(parts)


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
