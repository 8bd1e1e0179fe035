"""An image and a short video of the operator next to the robot, drawn by MuJoCo while the boxes are moved."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from posefuse.core.arrays import Array
from posefuse_teleop.hands import BODY, BONES
from posefuse_teleop.mujoco_robot import MujocoRobot
from posefuse_teleop.session import Operator
from posefuse_teleop.values import OperatorView, Phase

_BODY_RGBA, _HAND_RGBA, _TARGET_RGBA = (0.2, 0.45, 0.8, 1.0), (0.95, 0.75, 0.1, 1.0), (0.1, 0.8, 0.2, 0.7)
_TRAIL_RGBA = (0.95, 0.75, 0.1, 0.5)
_TRAIL = 60
# upper arm and forearm, and the hand, of the operator who is drawn
_ARM_M, _FINGERS_M = (0.3, 0.27), 0.16


class Stage:
    """Draws operator and robot in one scene; the robot's base is at `base_xy`, the operator at the origin of the world."""

    def __init__(self, model: Any, base_xy: tuple[float, float], size_wh: tuple[int, int]) -> None:
        import mujoco

        self._mj, self._offset = mujoco, np.array([*base_xy, 0.0])
        self._renderer = mujoco.Renderer(model, height=size_wh[1], width=size_wh[0])
        self._camera = mujoco.MjvCamera()
        self._camera.lookat[:] = [-base_xy[0] / 2 + 0.25, 0.0, 0.75]
        self._camera.distance, self._camera.azimuth, self._camera.elevation = 3.6, 70.0, -14.0
        self._trail: list[Array] = []

    def draw(self, robot: MujocoRobot, view: OperatorView, operator: Operator) -> Array:
        """(H, W, 3) RGB."""
        self._renderer.update_scene(robot.data, self._camera)
        places = dict(zip(BODY, view.body_xyz_world - self._offset, strict=True))
        _bend_arm(places)
        for a, b in BONES:
            self._bone(places[a], places[b], 0.045 if "shoulder" in a + b or "hip" in a + b or a == "neck" else 0.035, _BODY_RGBA)
        for side in ("left", "right"):
            ankle = places[f"{side}_ankle"]
            self._bone(ankle, ankle + [0.0, 0.0, -0.06], 0.035, _BODY_RGBA)
            self._bone(ankle + [0.0, 0.0, -0.065], ankle + [0.17, 0.0, -0.065], 0.035, _BODY_RGBA)
        self._ball(places["nose"] + [0.0, 0.0, 0.03], 0.11, _BODY_RGBA)
        hand = view.xyz_world[0] - self._offset
        self._trail = [*self._trail[-_TRAIL:], hand]
        for place in self._trail[::4]:
            self._ball(place, 0.008, _TRAIL_RGBA)
        self._ball(hand, 0.05, _HAND_RGBA)
        if operator.gate.phase is Phase.ENGAGED and operator.clutch is not None:
            self._ball(operator.clutch.xyz[0] - self._offset, 0.022, _TARGET_RGBA)
        return np.asarray(self._renderer.render())

    def close(self) -> None:
        """Free the OpenGL context."""
        self._renderer.close()

    def _new(self) -> Any:
        scene = self._renderer.scene
        scene.ngeom += 1
        return scene.geoms[scene.ngeom - 1]

    def _ball(self, place: Array, radius: float, rgba: tuple[float, float, float, float]) -> None:
        kind = self._mj.mjtGeom.mjGEOM_SPHERE
        self._mj.mjv_initGeom(self._new(), kind, np.full(3, radius), place, np.eye(3).ravel(), np.array(rgba, np.float32))

    def _bone(self, a: Array, b: Array, radius: float, rgba: tuple[float, float, float, float]) -> None:
        kind, geom = self._mj.mjtGeom.mjGEOM_CAPSULE, self._new()
        self._mj.mjv_initGeom(geom, kind, np.zeros(3), np.zeros(3), np.eye(3).ravel(), np.array(rgba, np.float32))
        self._mj.mjv_connector(geom, kind, radius, a, b)


def _bend_arm(places: dict[str, Array]) -> None:
    """The made-up operator has no elbow of their own: a human arm's, pointing down and outward."""
    shoulder, wrist = places["right_shoulder"], places["right_wrist"]
    way = wrist - shoulder
    far = min(max(float(np.linalg.norm(way)), 1e-3), sum(_ARM_M) * 0.999)
    along = way / np.linalg.norm(way)
    aside = np.array([-0.2, -0.5, -1.0])
    aside -= (aside @ along) * along
    ahead = (far**2 + _ARM_M[0] ** 2 - _ARM_M[1] ** 2) / (2 * far)
    out = float(np.sqrt(max(_ARM_M[0] ** 2 - ahead**2, 0.0)))
    elbow = shoulder + ahead * along + out * aside / np.linalg.norm(aside)
    forearm = (wrist - elbow) / np.linalg.norm(wrist - elbow)
    places.update(right_elbow=elbow, right_fingertips=wrist + _FINGERS_M * forearm)


def draw_boxes(
    folder: Path, *, rate_hz: float = 10.0, seconds: float = 20.0, size_wh: tuple[int, int] = (854, 480)
) -> list[Path]:
    """Write ``teleoperation.mp4`` and ``teleoperation.png`` (its middle) into an existing folder.

    Raises:
        DependencyError: no way to draw without a screen works here, or an extra is missing.
    """
    import cv2

    from posefuse_sim.render.stage import mujoco_with, working_backend

    # the first import of MuJoCo settles how it draws
    mujoco_with(working_backend())

    from posefuse.formats.video import VideoWriter

    from .boxes import BASE_XY_M, move_boxes

    video, picture = folder / "teleoperation.mp4", folder / "teleoperation.png"
    stage: Stage | None = None
    writer = VideoWriter(video, size_wh, rate_hz)
    drawn = 0

    def watch(robot: MujocoRobot, view: OperatorView, operator: Operator, t_s: float) -> None:
        nonlocal stage, drawn
        if t_s < drawn / rate_hz or t_s > seconds:
            return
        stage = stage or Stage(robot.model, BASE_XY_M, size_wh)
        image = stage.draw(robot, view, operator)
        writer.write(image, round(1e9 * drawn / rate_hz))
        drawn += 1
        if drawn == round(seconds * rate_hz * 0.4):
            cv2.imwrite(str(picture), image[..., ::-1])

    move_boxes(watch=watch, seconds=seconds)
    writer.close()
    if stage is not None:
        stage.close()
    return [video, picture]
