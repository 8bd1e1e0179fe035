"""Solving with refined extrinsics: better where the rig is a little wrong, asked for only, once, and the same when repeated."""

import dataclasses
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from built import poses, recording_from_views, turned
from checks import assert_same, refusal
from synthetic_walk import BODY, walker

from posefuse.calibration.settings import RefineSettings
from posefuse.core import ConfigError, Recording, Rig
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
    score = np.ones(xy.shape[:-1])
    wrong = turned(rig, 2, [0.003, -0.004, 0.003])
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
    assert_same(solve_again(first), first)


def test_a_refined_recording_is_not_solved_as_if_it_were_refined_otherwise(observed: Recording) -> None:
    """Its rig stayed as it was, and the provenance stated the other settings."""
    first = solved(observed, CONFIG)
    refusal(
        ConfigError, "refine_rig: the rig was refined with another value", solve_again, first, replace(CONFIG, refine_rig=False)
    )
    looser = replace(CONFIG, refine=RefineSettings(move_sigma_m=0.05))
    refusal(ConfigError, "refine: the rig was refined with another value", solve_again, first, looser)
