"""OpenGL without a screen: which of the ways to draw of this system works (EGL or OSMesa, WGL, CGL).

A driver that is half installed can abort the whole process, so each is tried in a process of its own.
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

from posefuse.core import DependencyError, InputError
from posefuse.foundation.platform import offscreen_backends

BACKENDS = offscreen_backends()
_MODULES = {"wgl": "glfw"}  # MuJoCo draws by WGL through the module of this name
_PYOPENGL = ("egl", "osmesa")  # platform names of PyOpenGL
_PROBE_LIMIT_S = 120
# what OpenGL 4.1 demands of a driver; for one that does not report its features
_SIDE_OF_EVERY_DRIVER_PX = 16_384
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


def check_framebuffer(backend: str, side_px: int) -> None:
    """Raise InputError when the driver cannot draw images with a side of `side_px`."""
    most_px = _largest_side_px(backend)
    if side_px > most_px:
        raise InputError(
            f"cameras: an image with a side of {side_px} px (the lens's margin included) is more than OpenGL by {backend} "
            f"draws here: expected at most {most_px} px"
        )


@functools.cache
def _largest_side_px(backend: str) -> int:
    """GL_MAX_RENDERBUFFER_SIZE, asked in a process of its own, as a context would settle what this one draws with."""
    done = _in_process(f"from posefuse.simulation.render.backend import _print_largest; _print_largest({backend!r})")
    return int(done.stdout.split()[-1]) if done is not None and done.returncode == 0 else _SIDE_OF_EVERY_DRIVER_PX


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
    """None when a process with this backend can draw, else the last line of its output."""
    done = _in_process(f"from posefuse.simulation.render.backend import _draw_once; _draw_once({backend!r})")
    if done is None:
        return f"no picture within {_PROBE_LIMIT_S} s"
    if done.returncode == 0:
        return None
    lines = [line.strip() for line in done.stderr.splitlines() if line.strip()]
    return lines[-1] if lines else f"the process ended with code {done.returncode}"


def _in_process(code: str) -> subprocess.CompletedProcess[str] | None:
    """A process that ran Python code; None when it took too long."""
    try:
        return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=_PROBE_LIMIT_S, check=False)
    except subprocess.TimeoutExpired:
        return None


def _print_largest(backend: str) -> None:
    mujoco_with(backend)
    context = gl_context(backend, 16, 16)
    gl = importlib.import_module("OpenGL.GL")
    print(int(gl.glGetIntegerv(gl.GL_MAX_RENDERBUFFER_SIZE)))
    context.free()


def _draw_once(backend: str) -> None:
    mujoco = mujoco_with(backend)
    context = gl_context(backend, 16, 16)
    model = mujoco.MjModel.from_xml_string("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>")
    drawing = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
    drawing.free()
    context.free()
