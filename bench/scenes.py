"""Scenes of several benches: camera rings, people who move, and views with the default network's noise as they arrive live.

A `Place` gives the ANATOMICAL23 keypoints (T, 23, 3) of one person at times (T,) in seconds.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from harness import Use, scene_from

from paper.scenes.inertial import wander
from posefuse.association import AssociateSettings
from posefuse.core import Detections2D, Rig, Skeleton
from posefuse.core.skeleton import ANATOMICAL23
from posefuse.fusion import FuseSettings
from posefuse.realtime.estimator import build_fuse, build_solve
from posefuse.tracking.online import LiveSettings, Tracker, build_tracker
from posefuse_sim.build import live_scene
from posefuse_sim.cameras import ImageSettings, RingCameras, placed_cameras, rig_from_cameras

Place = Callable[[np.ndarray], np.ndarray]
Arrivals = list[tuple[int, Detections2D]]
RATE_HZ, OUTPUT_HZ, WARM_UP_S = 30.0, 100.0, 1.0
LOST = 0.05
# of the default network on the demo clip, in px of 640 x 480: standard deviation, and how its variance divides
SIGMA_PX, CONSTANT, SLOW, SLOW_S = 2.4, 0.15, 0.6, 0.25
OUTLIERS, OUTLIER_PX, SWAPS = 0.01, 60.0, 0.01


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


def scene_of_person(motion: dict, cameras: int, seconds: float, seed: int) -> tuple[Rig, Place]:
    """Cameras on a ring, and the keypoints (T, 23, 3) at any times (T,) in seconds of a person who moves like that."""
    content = {"duration_s": seconds, "seed": seed, "cameras": {"kind": "ring", "count": cameras}, "people": [{"motion": motion}]}
    live = live_scene(scene_from(content, Use.DEVELOP))
    return live.rig, lambda t_s: live.keypoints(t_s)[:, 0]


def noise(rng: np.random.Generator, t_s: np.ndarray, keypoints: int) -> np.ndarray:
    """(T, K, 2) errors of one camera in sigmas: a constant, a slowly wandering and a white part."""
    slow = wander(t_s, SLOW_S, (keypoints, 2), rng)
    constant, white = rng.standard_normal((keypoints, 2)), rng.standard_normal(slow.shape)
    return np.sqrt(CONSTANT) * constant + np.sqrt(SLOW) * slow + np.sqrt(1 - CONSTANT - SLOW) * white


def arriving(rig: Rig, place: Place, seconds: float, seed: int, latency_s: tuple[float, float]) -> Arrivals:
    """Every view of every camera of 30 frames/s with random phases, in the order of arrival."""
    found = []
    for c, camera in enumerate(rig):
        rng = np.random.default_rng([seed, c])
        t_s = rng.uniform(0, 1 / RATE_HZ) + np.arange(int(seconds * RATE_HZ) - 1) / RATE_HZ
        t_s = t_s[rng.random(len(t_s)) >= LOST]
        exact = camera.project(place(t_s))
        xy = exact + SIGMA_PX * noise(rng, t_s, exact.shape[1])
        wild = rng.random(xy.shape[:2]) < OUTLIERS
        xy[wild] = exact[wild] + rng.uniform(-OUTLIER_PX, OUTLIER_PX, (wild.sum(), 2))
        swapped = rng.random(len(t_s)) < SWAPS
        xy[swapped] = xy[swapped][:, ANATOMICAL23.mirror]
        late_s = rng.uniform(*latency_s, len(t_s))
        for i, t in enumerate(t_s):
            found.append((round((t + late_s[i]) * 1e9), view_of(camera.name, round(t * 1e9), ANATOMICAL23, xy[i])))
    return sorted(found, key=lambda one: one[0])


Values = float | np.ndarray


def view_of(
    camera: str, t_ns: int, skeleton: Skeleton, xy: np.ndarray, sigma_px: Values = SIGMA_PX, score: Values = 0.9
) -> Detections2D:
    """One person, of keypoints (K, 2), in one view."""
    box = np.concatenate([xy.min(axis=0), xy.max(axis=0)])
    parts = {name: np.broadcast_to(value, (1, len(skeleton))) for name, value in (("score", score), ("sigma_px", sigma_px))}
    return Detections2D(camera=camera, t_ns=t_ns, skeleton=skeleton, xy_img=xy[None], box_img=box[None], **parts)


def new_tracker(rig: Rig, skeleton: Skeleton, people: int = 1) -> Tracker:
    """With association and fusion of one time step as the live pipeline has them."""
    associating = AssociateSettings(max_people=people)
    solve, fuse = build_solve(rig, associating, FuseSettings()), build_fuse(rig, FuseSettings())
    return build_tracker(rig, skeleton, LiveSettings(max_people=people), solve, fuse)


def output_ticks(seconds: float) -> list[int]:
    """Times in ns of an output of 100 Hz."""
    return [round(tick / OUTPUT_HZ * 1e9) for tick in range(int(seconds * OUTPUT_HZ))]
