"""A small recording as the front door gives it: two or one people, four cameras, a walk of a second with exact views."""

from collections.abc import Callable
from pathlib import Path

import built
import numpy as np
import pytest
from small_session import saved_session

import posefuse as pf
from posefuse import core
from posefuse.api.recording import recording_of
from posefuse.core import Kind
from posefuse.core.skeleton import BLAZEPOSE33


@pytest.fixture
def saved_walk(tmp_path: Path, ring_rig: Callable[..., core.Rig]) -> tuple[Path, Path]:
    """(session, result), see `small_session`."""
    return saved_session(tmp_path, ring_rig)


@pytest.fixture
def make_recording(ring_rig: Callable[..., core.Rig]) -> Callable[..., pf.Recording]:
    return lambda people=(7,), times=9: _recording(ring_rig(4), people, times)


def _recording(rig: core.Rig, people: tuple[int, ...], times: int) -> pf.Recording:
    rng = np.random.default_rng(1)
    n, k = len(people), len(BLAZEPOSE33)
    body = rng.normal(size=(k, 3)) * [0.3, 0.3, 0.5] + [0, 0, 1.0]
    walk = np.linspace(0, 1, times)[:, None, None, None] * [0.8, 0.1, 0] + np.arange(n)[:, None, None] * [0, 0.9, 0]
    xyz = body + walk
    xyz[2, 0, 5] = np.nan
    smoothed = np.where(np.isfinite(xyz[..., 0]), Kind.SMOOTHED, Kind.MISSING)
    poses = built.poses(
        xyz, skeleton=BLAZEPOSE33, cov=np.diag([1e-4, 4e-4, 9e-4]), t_ns=5_000_000_000 + np.arange(times) * 33_333_333,
        ids=people, kind=smoothed,
    )  # fmt: skip
    return recording_of(built.recording(rig, poses, session="walk"))
