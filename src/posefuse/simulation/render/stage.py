"""A scene in this process's OpenGL: move its bodies; draw ideal images and depths."""

from __future__ import annotations

from typing import Any

import numpy as np

from posefuse.core import SE3
from posefuse.core.arrays import Array
from posefuse.core.ideal_image import SourceView

from .backend import gl_context, mujoco_with

_NEAR_M = 0.05
_FAR_M = 80.0
_MOST_GEOMS = 2000


class RenderStage:
    """One MuJoCo model in one OpenGL context. Not for use from several threads."""

    def __init__(self, model: Any, backend: str) -> None:
        mujoco = mujoco_with(backend)
        self._mujoco = mujoco
        self._model = model
        self._data = mujoco.MjData(self._model)
        size = self._model.vis.global_
        self._context = gl_context(backend, size.offwidth, size.offheight)
        self._drawing = mujoco.MjrContext(self._model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._drawing)
        self._drawing.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR
        self._scene = mujoco.MjvScene(self._model, maxgeom=_MOST_GEOMS)
        self._option = mujoco.MjvOption()
        self._camera = mujoco.MjvCamera()

    def close(self) -> None:
        """Free the OpenGL context; safe to call twice."""
        if self._context is not None:
            self._drawing.free()
            self._context.free()
            self._context = None

    def place(self, poses: Array) -> None:
        """Move all bodies to (M, 7) world poses: x y z in metres, then a wxyz quaternion."""
        self._data.mocap_pos[:] = poses[:, :3]
        self._data.mocap_quat[:] = poses[:, 3:]
        self._mujoco.mj_kinematics(self._model, self._data)
        self._mujoco.mj_camlight(self._model, self._data)
        every = self._mujoco.mjtCatBit.mjCAT_ALL.value
        self._mujoco.mjv_updateScene(self._model, self._data, self._option, None, self._camera, every, self._scene)

    def draw(self, view: SourceView, cam_from_world: SE3) -> tuple[Array, Array]:
        """RGB (h, w, 3) uint8 and distance along the optical axis (h, w) float32 in metres."""
        rectangle = self._aim(view, cam_from_world)
        rgb = np.empty((view.height, view.width, 3), np.uint8)
        nearness = np.empty((view.height, view.width), np.float32)
        self._mujoco.mjr_render(rectangle, self._scene, self._drawing)
        self._mujoco.mjr_readPixels(rgb, nearness, rectangle, self._drawing)
        # reversed depth: 1 at the near plane, 0 at the far one
        depth = _FAR_M * _NEAR_M / (_NEAR_M + nearness * (_FAR_M - _NEAR_M))
        return rgb[::-1], depth[::-1]

    def _aim(self, view: SourceView, cam_from_world: SE3) -> Any:
        # another stage of this thread may have drawn in between
        self._context.make_current()
        world_from_cam = cam_from_world.inverse()
        axes = world_from_cam.matrix()
        centre = view.left + view.step * view.width / 2
        # OpenGL looks along -z with y up; its image plane is flipped against ours
        for camera in self._scene.camera:
            camera.pos[:] = world_from_cam.xyz
            camera.forward[:] = axes[:, 2]
            camera.up[:] = -axes[:, 1]
            camera.orthographic = 0
            camera.frustum_near, camera.frustum_far = _NEAR_M, _FAR_M
            camera.frustum_center = centre * _NEAR_M
            camera.frustum_top = -view.top * _NEAR_M
            camera.frustum_bottom = -(view.top + view.step * view.height) * _NEAR_M
        return self._mujoco.MjrRect(0, 0, view.width, view.height)
