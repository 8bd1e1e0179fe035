"""OpenGL without a screen: which of EGL and OSMesa works here.

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

from posefuse.core import DependencyError

BACKENDS = ("egl", "osmesa")
_PROBE_LIMIT_S = 120
_DEBIAN = "Debian/Ubuntu: apt-get install libegl1 libgl1 libgl1-mesa-dri (EGL) or libosmesa6 (OSMesa)"


def working_backend() -> str:
    """``egl`` or ``osmesa``, whichever draws first; only the one MUJOCO_GL names, when it names one of them.

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
    raise DependencyError(f"rendering needs OpenGL without a screen, and none works ({'; '.join(reasons)}). {_DEBIAN}")


@contextmanager
def gl_environment(backend: str) -> Iterator[None]:
    """While it lasts, what is imported and started draws by `backend`, on one core (processes share the machine)."""
    wanted = {"MUJOCO_GL": backend, "PYOPENGL_PLATFORM": backend, "LP_NUM_THREADS": "0"}
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
            context = importlib.import_module(f"mujoco.{backend}").GLContext(width, height)
            context.make_current()
    except (ImportError, RuntimeError, AttributeError, OSError) as error:
        raise DependencyError(f"OpenGL by {backend} cannot be started here ({error}). {_DEBIAN}") from None
    return context


def _why_not(backend: str) -> str | None:
    """None when a process with this backend can draw, else the last line of what it said."""
    command = [sys.executable, "-c", f"from posefuse.simulation.render.backend import _draw_once; _draw_once({backend!r})"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=_PROBE_LIMIT_S, check=False)
    except subprocess.TimeoutExpired:
        return f"no picture within {_PROBE_LIMIT_S} s"
    if done.returncode == 0:
        return None
    lines = [line.strip() for line in done.stderr.splitlines() if line.strip()]
    return lines[-1] if lines else f"the process ended with code {done.returncode}"


def _draw_once(backend: str) -> None:
    mujoco = mujoco_with(backend)
    context = gl_context(backend, 16, 16)
    model = mujoco.MjModel.from_xml_string("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>")
    drawing = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
    drawing.free()
    context.free()
