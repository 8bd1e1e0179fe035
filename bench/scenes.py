"""What the scenes of several benches share: rings of cameras, and people who walk."""

from __future__ import annotations

from typing import Any

import numpy as np

from posefuse.core import Rig
from posefuse_sim.cameras import ImageSettings, RingCameras, placed_cameras, rig_from_cameras


def ring(
    count: int,
    size_wh: tuple[int, int],
    focal_px: float,
    *,
    radius_m: float = 4.5,
    height_m: float = 2.2,
    begin_rad: float = 0.0,
    lens: tuple[float, ...] = (),
) -> Rig:
    """Cameras on a circle that look at a point 1 m above its centre."""
    (width, height), turned_deg = size_wh, float(np.rad2deg(begin_rad))
    intrinsics = ((focal_px, 0.0, (width - 1) / 2), (0.0, focal_px, (height - 1) / 2), (0.0, 0.0, 1.0))
    image = ImageSettings(size_px=size_wh, K=intrinsics, distortion=lens)
    circle_ = {"radius_m": radius_m, "height_m": height_m, "first_angle_deg": turned_deg}
    return rig_from_cameras(placed_cameras(RingCameras(kind="ring", count=count, image=image, **circle_)))


def walk(path: dict[str, Any], speed_mps: float = 1.35) -> dict[str, Any]:
    return {"kind": "walk", "path": path, "speed_mps": speed_mps}


def circle(radius_m: float, speed_mps: float = 1.35) -> dict[str, Any]:
    """The motion of a person who walks in a circle."""
    return walk({"shape": "circle", "radius_m": radius_m}, speed_mps)
