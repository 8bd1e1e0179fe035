"""An image of the operator next to the robot, drawn by MuJoCo while the boxes are moved."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np

from posefuse.core.arrays import Array
from posefuse_sim.render.stage import mujoco_with, working_backend
from posefuse_teleop.hands import BODY, BONES
from posefuse_teleop.mujoco_robot import MujocoRobot

# the first import of MuJoCo settles how it draws
mujoco = mujoco_with(working_backend())

from .boxes import BASE_XY_M, move_boxes  # noqa: E402
from .operator import Tick  # noqa: E402
from .person import body_xyz  # noqa: E402

AT_S, SIZE_WH = 8.0, (854, 480)
_BODY_RGBA, _HAND_RGBA, _TARGET_RGBA = (0.2, 0.45, 0.8, 1.0), (0.95, 0.75, 0.1, 1.0), (0.1, 0.8, 0.2, 0.7)
_BASE = np.array([*BASE_XY_M, 0.0])


def draw_boxes(path: Path) -> None:
    """Write the image: the task after `AT_S`, in axes of the robot's base."""
    last: list[tuple[MujocoRobot, Tick]] = []
    move_boxes(watch=lambda robot, tick, _: last.__setitem__(slice(None), [(robot, tick)]), seconds=AT_S)
    robot, tick = last[0]
    with mujoco.Renderer(robot.model, height=SIZE_WH[1], width=SIZE_WH[0]) as renderer:
        camera = mujoco.MjvCamera()
        camera.lookat[:] = [0.25 - BASE_XY_M[0] / 2, 0.0, 0.75]
        camera.distance, camera.azimuth, camera.elevation = 3.6, 70.0, -14.0
        renderer.update_scene(robot.data, camera)
        _draw_operator(renderer.scene, tick)
        cv2.imwrite(str(path), renderer.render()[..., ::-1])


def _draw_operator(scene: Any, tick: Tick) -> None:
    hand = tick.operator.view.xyz_world[0]
    places = dict(zip(BODY, body_xyz({"right": hand}) - _BASE, strict=True))
    for a, b in BONES:
        thick = "shoulder" in a + b or "hip" in a + b or a == "neck"
        _add(scene, places[a], 0.045 if thick else 0.035, _BODY_RGBA, places[b])
    _add(scene, places["nose"] + [0.0, 0.0, 0.03], 0.11, _BODY_RGBA)
    _add(scene, hand - _BASE, 0.05, _HAND_RGBA)
    if tick.operator.clutch is not None:
        _add(scene, tick.operator.clutch.xyz[0] - _BASE, 0.022, _TARGET_RGBA)


def _add(scene: Any, place: Array, radius: float, rgba: tuple[float, ...], end: Array | None = None) -> None:
    """A ball, or a capsule to its other end."""
    scene.ngeom += 1
    geom, kind = scene.geoms[scene.ngeom - 1], mujoco.mjtGeom.mjGEOM_SPHERE if end is None else mujoco.mjtGeom.mjGEOM_CAPSULE
    mujoco.mjv_initGeom(geom, kind, np.full(3, radius), place, np.eye(3).ravel(), np.array(rgba, np.float32))
    if end is not None:
        mujoco.mjv_connector(geom, kind, radius, place, end)
