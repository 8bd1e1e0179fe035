"""A small recording as the front door gives it: two or one people, four cameras, a walk of a second with exact views."""

from collections.abc import Callable

import matplotlib
import numpy as np
import pytest
from built import recording_from_views

import posefuse as pf
from posefuse import core
from posefuse.api.recording import recording_of
from posefuse.core import Kind, PoseSequence
from posefuse.core.skeleton import BLAZEPOSE33

matplotlib.use("Agg")


@pytest.fixture
def make_recording(ring_rig: Callable[..., core.Rig]) -> Callable[..., pf.Recording]:
    return lambda people=(7,), times=9: _recording(ring_rig(4), people, times)


def _recording(rig: core.Rig, people: tuple[int, ...], times: int) -> pf.Recording:
    rng = np.random.default_rng(1)
    n, k = len(people), len(BLAZEPOSE33)
    body = rng.normal(size=(k, 3)) * [0.3, 0.3, 0.5] + [0, 0, 1.0]
    walk = np.linspace(0, 1, times)[:, None, None, None] * [0.8, 0.1, 0] + np.arange(n)[:, None, None] * [0, 0.9, 0]
    xyz = body + walk
    shape = xyz.shape[:3]
    xyz[2, 0, 5] = np.nan
    known = np.isfinite(xyz[..., 0])
    cov = np.where(known[..., None, None], np.diag([1e-4, 4e-4, 9e-4]), np.nan)
    xy = np.stack([camera.project(xyz) for camera in rig], axis=2)
    score = np.where(np.isfinite(xy).all(axis=-1), 0.9, 0.0)
    poses = PoseSequence(
        t_ns=5_000_000_000 + np.arange(times) * 33_333_333,
        skeleton=BLAZEPOSE33,
        person_id=np.array(people),
        xyz_world=xyz,
        cov_world=cov,
        reproj_px=np.where(known, 1.25, np.nan),
        n_views=np.where(known, len(rig), 0),
        kind=np.where(known, Kind.SMOOTHED, Kind.MISSING).reshape(shape),
    )
    made = recording_from_views(rig, poses, xy, score, np.where(score > 0, 2.0, np.nan), {"session": "walk"})
    return recording_of(made)
