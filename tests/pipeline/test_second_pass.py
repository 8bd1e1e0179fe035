"""Bringing every camera to common instants, and what is kept of whom."""

from dataclasses import replace

import numpy as np
import pytest

from posefuse.core import InputError, Recording, Views
from posefuse.core.skeleton import COCO17
from posefuse.fusion import FuseSettings, fuse
from posefuse.pipeline.following import Seen
from posefuse.pipeline.second_pass import poses_over_time, views_of, views_over_time
from posefuse.tracking import SmoothSettings

T, K, PERIOD_NS = 40, len(COCO17), 33_333_333
VELOCITY = np.array([1.4, -0.6, 0.1])
LATE_NS = np.array([0, 12_000_000, -9_000_000, 5_000_000])
BODY = np.random.default_rng(4).normal(size=(K, 3)) * [0.2, 0.2, 0.4] + [-0.5, 0.3, 1.0]
FUSE = FuseSettings()


def body(t_ns: float) -> np.ndarray:
    return BODY + VELOCITY * t_ns * 1e-9


def seen_by(rig, late_ns: np.ndarray, people: tuple[int, ...] = (0,), without: dict[int, tuple[int, ...]] | None = None) -> list:
    """Instants at which every camera's frame was taken late by its own time; `without`: instant -> cameras that saw nobody."""
    seen = []
    for i in range(T):
        t_ns = i * PERIOD_NS
        xy = np.stack([c.project(body(t_ns + late)) for c, late in zip(rig, late_ns, strict=True)])
        score = np.ones((len(rig), K))
        for c in (without or {}).get(i, ()):
            xy[c], score[c] = np.nan, 0.0
        sigma = np.where(score > 0, 1.5, np.nan)
        everybody = [np.stack([plane] * len(people)) for plane in (xy, score, sigma)]
        views = Views(t_ns, COCO17, rig.names, np.array(people), *everybody)
        seen.append(Seen(views, tuple(int(t_ns + late) for late in late_ns), fuse(views, rig, FUSE)))
    return seen


def worst_mm(poses) -> float:
    inner = slice(2, -2)
    true = np.stack([body(t) for t in poses.t_ns])[:, None]
    return float(1000 * np.abs(poses.xyz_world - true)[inner].max())


def test_cameras_out_of_step_agree_once_brought_to_common_instants(ring_rig) -> None:
    rig = ring_rig(4, distortion=(-0.1, 0.02, 0.0, 0.0))
    seen = seen_by(rig, LATE_NS)
    views = views_over_time(seen)
    assert views.t_ns.tolist() == [i * PERIOD_NS for i in range(T)]
    brought = poses_over_time(views, rig, FUSE, None)
    as_they_were = [one.pose for one in seen]
    off_mm = 1000 * max(np.abs(p.xyz_world[0] - body(p.t_ns)).max() for p in as_they_were[2:-2])
    assert off_mm > 5
    assert worst_mm(brought) < 0.3


def test_cameras_in_step_are_left_as_they_are(ring_rig) -> None:
    rig = ring_rig(4)
    seen = seen_by(rig, np.array([0, 50_000, -80_000, 0]))
    views = views_over_time(seen)
    for i in (0, 7, T - 1):
        assert np.array_equal(views.xy_img[i], seen[i].views.xy_img)


def test_no_interpolation_across_a_hole(ring_rig) -> None:
    rig = ring_rig(4)
    seen = seen_by(rig, LATE_NS, without={10: (1,), 11: (1,)})
    views = views_over_time(seen)
    assert np.isnan(views.xy_img[10, 0, 1]).all()
    assert (views.score[10, 0, 1] == 0).all()
    nine = views.xy_img[9, 0, 1]  # late frame, so its other neighbour is instant 8, which is there
    assert np.allclose(nine, rig.cameras[1].project(body(9 * PERIOD_NS)), atol=0.2)


def test_whoever_was_seen_for_a_moment_only_is_left_out(ring_rig) -> None:
    rig = ring_rig(4)
    seen = seen_by(rig, LATE_NS * 0)
    brief = seen_by(rig, LATE_NS * 0, people=(0, 1))[:3]
    views = views_over_time([*brief, *seen[3:]])
    assert views.person_id.tolist() == [0]
    nobody = [replace_people(one) for one in seen]
    with pytest.raises(InputError, match="no person could be followed"):
        views_over_time(nobody)


def replace_people(one: Seen) -> Seen:
    views = one.views
    empty = Views(views.t_ns, COCO17, views.camera_names, [], views.xy_img[:0], views.score[:0], views.sigma_px[:0])
    return replace(one, views=empty)


def test_a_recording_can_be_fused_again_from_what_it_keeps(ring_rig) -> None:
    rig = ring_rig(3)
    views = views_over_time(seen_by(rig, np.zeros(3, int)))
    poses = poses_over_time(views, rig, FUSE, SmoothSettings())
    recording = Recording(rig, poses, views.xy_img, views.score, views.sigma_px)
    again = poses_over_time(views_of(recording), rig, FUSE, SmoothSettings())
    assert np.allclose(again.xyz_world, poses.xyz_world, atol=1e-5)
    assert worst_mm(poses) < 3
