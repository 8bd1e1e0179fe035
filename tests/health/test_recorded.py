"""A camera that was moved, lags or fits nothing is named from a recording's own detections, those left out too."""

import tracemalloc
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest
from built import poses, recording_from_views, turned

from posefuse.core import SKELETONS, Recording, Rig
from posefuse.core.observations import NOT_KEPT
from posefuse.health.recorded import UNFIT, checked_rig

BODY = SKELETONS["coco17"]
Walk = tuple[Rig, np.ndarray, np.ndarray, np.ndarray]


def recording_of(rig: Rig, xyz: np.ndarray, xy: np.ndarray, t_s: np.ndarray, left_out: Sequence[int] = ()) -> Recording:
    """A result with detections xy (T, C, K, 2); those of some cameras belong to no person of it."""
    ones = np.ones((len(t_s), 1, len(rig), len(BODY)))
    made = recording_from_views(rig, poses(xyz[:, None], t_ns=np.round(t_s * 1e9).astype(np.int64)), xy[:, None], ones, 3 * ones)
    log = made.observations
    out = np.isin(log.frame_camera[log.detection_frame], left_out)
    return replace(made, observations=log.with_person_ids(np.where(out, NOT_KEPT, log.person_id)))


@pytest.fixture(scope="module")
def walk(ring_rig: Callable[..., Rig]) -> Walk:
    """A rig, times, keypoints in space, and as a network marks them: 3 px off, each in its own way."""
    rig, random, t_s = ring_rig(4), np.random.default_rng(0), np.arange(280) / 20
    place = np.stack([np.cos(0.7 * t_s), 0.8 * np.sin(0.7 * t_s), 1 + 0 * t_s], axis=-1)
    swing = 0.2 * np.sin(5 * t_s[:, None] + np.arange(len(BODY)))[..., None] * [1.0, 0.5, 0.2]
    xyz = place[:, None] + swing + random.normal(0, 0.35, (len(BODY), 3))
    xy = np.stack([camera.project(xyz) for camera in rig], axis=1)
    return rig, t_s, xyz, xy + random.normal(0, 3, (1, *xy.shape[1:])) + random.normal(0, 2, xy.shape)


def test_a_good_recording_has_no_findings_and_a_moved_camera_one(walk: Walk) -> None:
    rig, t_s, xyz, xy = walk
    fits, findings = checked_rig(recording_of(rig, xyz, xy, t_s), rig)
    assert findings == []
    assert all(one.seen == 1 and one.left_out == 0 and 2 < one.reproj_px < 8 for one in fits.values())
    moved = np.where((t_s[:, None, None, None] > 7) & (np.arange(4)[:, None, None] == 2), xy + [9.0, 4.0], xy)
    [found] = checked_rig(recording_of(rig, xyz, moved, t_s), rig)[1]
    assert (found.kind, found.cameras) == ("moved", ("cam02",)) and 7 < found.t_ns / 1e9 < 12


def test_a_slower_camera_shows_the_person_in_all_of_its_images(walk: Walk) -> None:
    rig, t_s, xyz, xy = walk
    made = recording_of(rig, xyz, xy, t_s)
    log = made.observations
    # every second of the time steps that are looked at has no image of it
    slow = replace(made, observations=log.only((log.frame_camera != 3) | (log.frame_step % 4 != 0)))
    assert [one.seen for one in checked_rig(slow, rig)[0].values()] == [1, 1, 1, 1]


def test_a_long_recording_is_looked_at_without_a_copy_of_it(walk: Walk) -> None:
    rig, _, xyz, xy = walk
    long = recording_of(rig, np.repeat(xyz, 30, axis=0), np.repeat(xy, 30, axis=0), np.arange(30 * len(xyz)) / 600)
    tracemalloc.start()
    try:
        checked_rig(long, rig)
        assert tracemalloc.get_traced_memory()[1] < long.poses.cov_world.nbytes / 2
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("seconds", [1.7, 14.0])
@pytest.mark.parametrize("degrees", [3.0, 10.0])
def test_a_camera_turned_before_is_named_though_its_views_were_left_out(walk: Walk, degrees: float, seconds: float) -> None:
    rig, t_s, xyz, xy = walk
    wrong, some = turned(rig, 1, np.deg2rad(degrees) * np.array([0.6, 0.8, 0])), slice(0, round(20 * seconds))
    fits, [found] = checked_rig(recording_of(wrong, xyz[some], xy[some], t_s[some], [1]), wrong)
    assert (found.kind, found.cameras) == ("moved", ("cam01",))
    assert np.rad2deg(found.amount) == pytest.approx(degrees, rel=0.2)
    assert fits["cam01"].left_out == 1
    assert fits["cam01"].reproj_px > 5 * fits["cam00"].reproj_px


def test_a_late_camera_of_a_person_who_stands_is_late_and_not_moved(walk: Walk) -> None:
    rig, t_s, xyz, xy = walk
    here = xyz - xyz.mean(axis=1, keepdims=True) + [0, 0, 1.0]
    seen = np.stack([camera.project(here) for camera in rig], axis=1) + xy - np.stack([c.project(xyz) for c in rig], axis=1)
    seen[2:, 3] = seen[:-2, 3].copy()
    [found] = checked_rig(recording_of(rig, here, seen, t_s), rig)[1]
    assert (found.kind, found.cameras) == ("unsynchronised", ("cam03",)) and found.amount == pytest.approx(0.1, abs=0.02)


def test_cameras_that_fit_nothing_are_named_with_how_much_is_left_out(walk: Walk) -> None:
    rig, t_s, xyz, xy = walk
    stray = xy.copy()
    stray[:, 2:] += 60 * np.sin(np.arange(len(t_s))[:, None, None, None] + np.array([[[[0.0]], [[2.0]]]]))
    [found] = checked_rig(recording_of(rig, xyz, stray, t_s, [2, 3]), rig)[1]
    assert (found.kind, found.cameras) == (UNFIT, ("cam02", "cam03"))
    assert "cam02 100% (" in found.detail and "px off)" in found.detail


def test_two_cameras_cannot_distinguish_and_report_nothing(walk: Walk) -> None:
    rig, t_s, xyz, xy = walk
    two = Rig(rig.cameras[:2])
    assert checked_rig(recording_of(two, xyz, xy[:, :2] + [0, 50.0], t_s), two)[1] == []


@pytest.mark.parametrize("off_px", [20.0, 40.0, 80.0])
def test_half_a_second_on_another_person_is_no_moved_camera(walk: Walk, off_px: float) -> None:
    rig, t_s, xyz, xy = walk
    mixed = np.where((abs(t_s - 5) < 0.25)[:, None, None, None] & (np.arange(4)[:, None, None] == 2), xy + [off_px, 5.0], xy)
    assert checked_rig(recording_of(rig, xyz, mixed, t_s), rig)[1] == []


@pytest.mark.parametrize("camera", range(4))
@pytest.mark.parametrize("at_s", [3, 5, 7, 9])
def test_a_camera_that_sees_another_person_for_a_moment_is_not_blamed(walk: Walk, at_s: float, camera: int) -> None:
    rig, t_s, xyz, xy = walk
    there = abs(t_s - at_s) < 0.35
    # who walks otherwise, half a metre away
    other = np.roll(xyz, 53, axis=0)
    other += (xyz[there].mean(axis=(0, 1)) - other[there].mean(axis=(0, 1))) * [1, 1, 0] + [0.3, 0.4, 0.0]
    mixed = xy.copy()
    mixed[there, camera] += (rig.cameras[camera].project(other) - rig.cameras[camera].project(xyz))[there]
    assert checked_rig(recording_of(rig, xyz, mixed, t_s), rig)[1] == []
