"""A session with videos and its result."""

from collections.abc import Callable
from pathlib import Path

import pytest
from small_session import saved_session

from posefuse.core import Rig


@pytest.fixture
def saved_walk(tmp_path: Path, ring_rig: Callable[..., Rig]) -> tuple[Path, Path]:
    """(session, result), see `small_session`."""
    return saved_session(tmp_path, ring_rig)
