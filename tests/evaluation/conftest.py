"""The figure of tests/kinematics, for the rooms above it."""

import importlib.util
from collections.abc import Callable
from pathlib import Path

import pytest

from posefuse.core import PoseSequence


@pytest.fixture(scope="session")
def figure_sequence() -> Callable[..., PoseSequence]:
    """Builder of a PoseSequence out of one dict of joint angles per time step."""
    path = Path(__file__).parents[1] / "kinematics" / "conftest.py"
    spec = importlib.util.spec_from_file_location("figure_builder", path)
    builder = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(builder)
    return builder.sequence_of
