"""Skips, by name, what cannot be drawn here."""

import importlib.util

import pytest

from posefuse.core import DependencyError


@pytest.fixture(scope="session")
def backend() -> str:
    """A working OpenGL backend."""
    if importlib.util.find_spec("mujoco") is None:
        pytest.skip("the extra sim (mujoco) is not installed")
    from posefuse.simulate.render.backend import working_backend

    try:
        return working_backend()
    except DependencyError as error:
        pytest.skip(str(error))
