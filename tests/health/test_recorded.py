"""A camera that was moved or lags is named from a recording's own views."""

from collections.abc import Callable

import numpy as np
import pytest

from posefuse.core import SKELETONS, Rig, ViewSequence
from posefuse.health.recorded import rig_findings

BODY = SKELETONS["coco17"]


def views_of(rig: Rig, xy: np.ndarray, t_s: np.ndarray) -> ViewSequence:
    ones = np.ones((len(t_s), 1, len(rig), len(BODY)))
    names = tuple(rig.names)
    return ViewSequence(
        t_ns=np.round(t_s * 1e9).astype(np.int64),
        skeleton=BODY,
        camera_names=names,
        person_id=np.zeros(1, np.int64),
        xy_img=xy[:, None],
        score=ones,
        sigma_px=2 * ones,
    )


@pytest.fixture(scope="module")
def walk(ring_rig: Callable[..., Rig]) -> tuple[Rig, np.ndarray, np.ndarray]:
    """A rig, times, and keypoints (T, C, K, 2) that a network marks 3 px next to, each in its own way."""
    rig, random, t_s = ring_rig(4), np.random.default_rng(0), np.arange(280) / 20
    place = np.stack([np.cos(0.7 * t_s), 0.8 * np.sin(0.7 * t_s), 1 + 0 * t_s], axis=-1)
    swing = 0.2 * np.sin(5 * t_s[:, None] + np.arange(len(BODY)))[..., None] * [1.0, 0.5, 0.2]
    xyz = place[:, None] + swing + random.normal(0, 0.35, (len(BODY), 3))
    xy = np.stack([camera.project(xyz) for camera in rig], axis=1)
    return rig, t_s, xy + random.normal(0, 3, (1, *xy.shape[1:])) + random.normal(0, 2, xy.shape)


def test_a_good_recording_has_no_findings_and_a_moved_camera_one(walk: tuple[Rig, np.ndarray, np.ndarray]) -> None:
    rig, t_s, xy = walk
    assert rig_findings(views_of(rig, xy, t_s), rig) == []
    moved = np.where((t_s[:, None, None, None] > 7) & (np.arange(4)[:, None, None] == 2), xy + [9.0, 4.0], xy)
    found = rig_findings(views_of(rig, moved, t_s), rig)
    assert [(one.kind, one.cameras) for one in found] == [("moved", ("cam02",))]
    assert 7 < found[0].t_ns / 1e9 < 12


def test_two_cameras_cannot_distinguish_and_report_nothing(walk: tuple[Rig, np.ndarray, np.ndarray]) -> None:
    rig, t_s, xy = walk
    two = Rig(rig.cameras[:2])
    assert rig_findings(views_of(two, xy[:, :2] + [0, 50.0], t_s), two) == []
