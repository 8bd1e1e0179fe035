"""A scene in this process's OpenGL, without a screen: move its bodies; draw ideal images and depths.

Which of the ways to draw of this system works (EGL or OSMesa, WGL, CGL) is tried in a process of its own each, because a driver
that is half installed can abort the whole process.
"""

from __future__ import annotations

import functools
import importlib
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from posefuse.core import SE3, DependencyError
from posefuse.core.arrays import Array
from posefuse.core.ideal_image import SourceView

_NEAR_M = 0.05
_FAR_M = 80.0
_MOST_GEOMS = 2000
# names of the textures of props begin with this; how many times longer a pixel is on them than wide, as OpenGL's drivers can
PROP, _MOST_SLANT = "prop", 16.0


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
        self._draw_prints_sharply()
        self._drawing.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR
        self._scene = mujoco.MjvScene(self._model, maxgeom=_MOST_GEOMS)
        self._option = mujoco.MjvOption()
        self._camera = mujoco.MjvCamera()

    def _draw_prints_sharply(self) -> None:
        """What is printed on props is filtered by its own slant; MuJoCo would blur it along both sides by the shorter one."""
        gl = importlib.import_module("OpenGL.GL")
        anisotropic = importlib.import_module("OpenGL.GL.EXT.texture_filter_anisotropic")
        if not anisotropic.glInitTextureFilterAnisotropicEXT():
            return
        for i in range(self._model.ntex):
            if self._model.texture(i).name.startswith(PROP):
                gl.glBindTexture(gl.GL_TEXTURE_2D, int(self._drawing.texture[i]))
                gl.glTexParameterf(gl.GL_TEXTURE_2D, anisotropic.GL_TEXTURE_MAX_ANISOTROPY_EXT, _MOST_SLANT)

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


# MuJoCo's ways to draw without a screen here, best first
BACKENDS = {"win32": ("wgl",), "darwin": ("cgl",)}.get(sys.platform, ("egl", "osmesa"))
_MODULES = {"wgl": "glfw"}  # MuJoCo draws by WGL through the module of this name
_PYOPENGL = ("egl", "osmesa")  # platform names of PyOpenGL
_PROBE_LIMIT_S, _DRAWN = 120, "drawn"
_CURE = {
    "egl": "Debian/Ubuntu: apt-get install libegl1 libgl1 libgl1-mesa-dri (EGL) or libosmesa6 (OSMesa)",
    "wgl": "Windows: install the graphics driver of the maker; a remote desktop or a service may have no OpenGL",
    "cgl": "macOS: run it in the session of a user who is logged in",
}[BACKENDS[0]]


def working_backend() -> str:
    """The first of `BACKENDS` that draws; only the one MUJOCO_GL names, when it names one of them.

    Raises:
        DependencyError: neither works, with the reason of each and the packages to install; or the extra is missing.
    """
    wanted = os.environ.get("MUJOCO_GL", "")
    return _first_working((wanted,) if wanted in BACKENDS else BACKENDS)


@functools.cache
def _first_working(candidates: tuple[str, ...]) -> str:
    reasons = []
    for backend in candidates:
        reason = _why_not(backend)
        if reason is None:
            return backend
        reasons.append(f"{backend}: {reason}")
    if "No module named" in reasons[0]:
        raise DependencyError(f"rendering needs the extra sim: pip install 'posefuse[sim]' ({reasons[0]})")
    raise DependencyError(f"rendering needs OpenGL without a screen, and none works ({'; '.join(reasons)}). {_CURE}")


@contextmanager
def gl_environment(backend: str) -> Iterator[None]:
    """While it lasts, what is imported and started draws by `backend`, on one core (processes share the machine)."""
    wanted = {"MUJOCO_GL": backend, "LP_NUM_THREADS": "0"} | ({"PYOPENGL_PLATFORM": backend} if backend in _PYOPENGL else {})
    before = {name: os.environ.get(name) for name in wanted}
    os.environ.update(wanted)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def mujoco_with(backend: str) -> Any:
    """The module mujoco, which settles on one way to draw when it is first imported; DependencyError without it."""
    try:
        with gl_environment(backend):
            return importlib.import_module("mujoco")
    except ImportError as error:
        raise DependencyError(f"rendering needs the extra sim: pip install 'posefuse[sim]' ({error})") from None


def gl_context(backend: str, width: int, height: int) -> Any:
    """A current OpenGL context of this process; raises DependencyError when it cannot be made."""
    try:
        with gl_environment(backend):
            context = importlib.import_module(f"mujoco.{_MODULES.get(backend, backend)}").GLContext(width, height)
            context.make_current()
    except (ImportError, RuntimeError, AttributeError, OSError) as error:
        raise DependencyError(f"OpenGL by {backend} cannot be started here ({error}). {_CURE}") from None
    return context


def _why_not(backend: str) -> str | None:
    """None when a process of its own, which draws once with this backend, can; else the last line of its output."""
    code = f"from posefuse_sim.render.stage import _draw_once; _draw_once({backend!r})"
    try:
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=_PROBE_LIMIT_S, check=False)
    except subprocess.TimeoutExpired:
        return f"no picture within {_PROBE_LIMIT_S} s"
    if _DRAWN in done.stdout:
        return None
    lines = [line.strip() for line in done.stderr.splitlines() if line.strip()]
    return lines[-1] if lines else f"the process ended with code {done.returncode}"


def _draw_once(backend: str) -> None:
    """Draw, and say so."""
    with gl_environment(backend):
        mujoco = importlib.import_module("mujoco")
    stage = RenderStage(mujoco.MjModel.from_xml_string("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>"), backend)
    print(_DRAWN, flush=True)
    stage.close()
