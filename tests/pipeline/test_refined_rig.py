"""Solving with refined extrinsics: better where the rig is a little wrong, asked for only, once, and the same when repeated."""

import dataclasses
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from built import poses, recording_from_views
from synthetic_walk import BODY, walker

from posefuse.core import SE3, Recording, Rig
from posefuse.foundation.parsing import plain
from posefuse.pipeline.config import TrackConfig
from posefuse.pipeline.solve import REFINED, solve, solve_again
from posefuse.pipeline.track import refined_line

STEPS, NOISE_PX = 90, 0.5
CONFIG = TrackConfig(refine_rig=True)


@pytest.fixture(scope="module")
def observed(ring_rig: Callable[..., Rig]) -> Recording:
    """The walker as four cameras see it, one of which was turned by a third of a degree since the calibration."""
    rig = ring_rig(4)
    xyz = walker(np.arange(STEPS) / 10)[:, None]
    xy = np.moveaxis(rig.project(xyz), 0, 2)
    xy = xy + np.random.default_rng(2).normal(size=xy.shape) * NOISE_PX
    turned = SE3.from_rotvec(np.array([0.003, -0.004, 0.003]), np.zeros(3)) @ rig.cameras[2].cam_from_world
    wrong = replace(rig, cameras=(*rig.cameras[:2], replace(rig.cameras[2], cam_from_world=turned), rig.cameras[3]))
    score = np.ones(xy.shape[:-1])
    return recording_from_views(wrong, poses(xyz, rate_hz=10.0, skeleton=BODY), xy, score, 2.0 * score)


def solved(observed: Recording, config: TrackConfig) -> Recording:
    """As `posefuse track` would leave it."""
    provenance = {"config": plain(dataclasses.asdict(config))}
    return solve_again(solve(observed.observations, observed.rig, provenance))


def error_m(recording: Recording) -> float:
    true = walker(recording.poses.t_ns / 1e9)
    return float(np.nanmean(np.linalg.norm(recording.poses.xyz_world[:, 0] - true, axis=-1)))


def test_a_camera_that_was_turned_costs_less(observed: Recording) -> None:
    before, after = solved(observed, replace(CONFIG, refine_rig=False)), solved(observed, CONFIG)
    assert error_m(after) < 0.6 * error_m(before)
    assert REFINED not in before.provenance
    assert before.rig.id == observed.rig.id != after.rig.id
    about = after.provenance[REFINED]
    assert about["calibrated_rig_id"] == observed.rig.id
    assert after.provenance["rig_id"] == after.rig.id
    assert about["after_px"] < about["before_px"]
    assert max(about["cameras"], key=lambda name: about["cameras"][name]["turned_rad"]) == "cam02"
    assert f"{about['before_px']:.2f} -> {about['after_px']:.2f} px" in refined_line(about)


def test_a_refined_recording_is_solved_again_to_the_last_bit(observed: Recording) -> None:
    first = solved(observed, CONFIG)
    again = solve_again(first)
    assert again.rig.id == first.rig.id
    assert again.provenance == first.provenance
    np.testing.assert_array_equal(again.poses.xyz_world, first.poses.xyz_world)
    np.testing.assert_array_equal(again.poses.cov_world, first.poses.cov_world)
    np.testing.assert_array_equal(again.observations.person_id, first.observations.person_id)
