"""Feet that stand neither move nor sink: which do, what that does to a fit, and what it says of its certainty."""

from dataclasses import replace

import built
import numpy as np
import pytest
from built import simulated

from posefuse.core import PoseSequence
from posefuse.core.skeleton import ANATOMICAL23
from posefuse.kinematics.body import BodySettings, bodies_from_poses, fit_views
from posefuse.kinematics.body.contacts import contacts_of
from posefuse.tracking import usual_lengths

RATE_HZ, SIGMA_PX, SIGMA_M = 20.0, 1.5, 0.006
SOLES = tuple(f"{side}_{part}" for side in ("left", "right") for part in ("heel", "big_toe"))
LOOSE = BodySettings(contact_sigma_m=0.0)


@pytest.fixture(scope="module")
def walker():
    """(T, 1, K, 3) exact keypoints of a simulated person who walks along a line."""
    return simulated({"kind": "walk", "path": {"shape": "line", "start_m": [-2, 0], "end_m": [2, 0.4]}}, 2.5, RATE_HZ)


@pytest.fixture(scope="module")
def poses(walker) -> PoseSequence:
    return built.shaken(built.poses(walker, SIGMA_M, RATE_HZ, ANATOMICAL23), SIGMA_M, 1)


@pytest.fixture(scope="module")
def fits(poses, walker, ring_rig):
    rig, exact = ring_rig(4), built.poses(walker, SIGMA_M, RATE_HZ, ANATOMICAL23)
    views = built.noisy_views(rig, exact, SIGMA_PX, 2, sigma_px=SIGMA_PX)
    fits = {}
    for name, chosen in {"stand": BodySettings(), "loose": LOOSE}.items():
        # written where the poses lie
        own = replace(poses, **built.arrays_of(poses, np.array))
        fits[name] = fit_views(own, rig, views, chosen, usual_lengths()).poses
    return fits


def standing(walker) -> np.ndarray:
    """(T, 4) whether a point of `SOLES` is in truth at rest on the floor."""
    at = ANATOMICAL23.indices(SOLES)
    speed = np.linalg.norm(np.gradient(walker[:, 0][:, at], 1 / RATE_HZ, axis=0), axis=-1)
    return speed < 0.05


def found(walker, soles_m: float = 0.0, rate_hz: float = RATE_HZ) -> np.ndarray:
    """(T, 4) where contacts are found in these keypoints, of a walk at this height of the floor."""
    keypoint = np.arange(len(ANATOMICAL23))
    xyz = walker[:, 0] + [0, 0, soles_m]
    t_ns = np.arange(len(xyz)) * round(1e9 / rate_hz)
    places, _ = contacts_of(t_ns, xyz, np.zeros((*xyz.shape, 3)), ANATOMICAL23, keypoint)
    return np.isfinite(places[:, ANATOMICAL23.indices(SOLES), 0])


@pytest.mark.parametrize("soles_m", [0.0, -1.3])
def test_feet_at_rest_are_found_wherever_the_floor_is(walker, soles_m: float) -> None:
    truth, got = standing(walker), found(walker, soles_m)
    assert (got & truth).sum() > 0.9 * truth.sum()
    assert (got & truth).sum() > 0.75 * got.sum()
    assert got.any(axis=0).all() and not got.all()


@pytest.mark.parametrize("times", [1, 5])
def test_feet_at_rest_are_found_at_any_frame_rate(walker, times: int) -> None:
    """Errors of 3 mm from frame to frame, at 100 frames/s as fast as 0.2 m/s."""
    steps = np.arange((len(walker) - 1) * times + 1) / times
    before, share = np.floor(steps).astype(int), (steps % 1)[:, None, None, None]
    between = walker[before] * (1 - share) + walker[np.minimum(before + 1, len(walker) - 1)] * share
    noise = np.random.default_rng(3).normal(size=between.shape) * 0.003
    truth, got = standing(walker), found(between + noise, rate_hz=RATE_HZ * times)[::times]
    assert (got & truth).sum() > 0.8 * truth.sum()


def test_feet_in_the_air_stand_nowhere(walker) -> None:
    """Somebody who is carried: all of the body moves."""
    carried = walker + np.linspace(0, 3, len(walker))[:, None, None, None] * [0, 0.5, 0]
    assert found(carried).mean() < 0.1 < standing(walker).mean()


def test_standing_feet_do_not_slide(walker, fits) -> None:
    slid = {}
    for name, fit in fits.items():
        at = ANATOMICAL23.indices(SOLES)
        steps = np.linalg.norm(np.diff(fit.xyz_world[:, 0][:, at], axis=0), axis=-1)
        both = standing(walker)[1:] & standing(walker)[:-1]
        slid[name] = steps[both].mean()
    assert slid["stand"] < 0.4 * slid["loose"] and slid["stand"] < 0.003


def test_ankles_are_closer_and_what_they_say_holds(walker, fits) -> None:
    at, truth = ANATOMICAL23.indices(("left_ankle", "right_ankle")), walker[:, 0]
    error = {name: np.linalg.norm(fit.xyz_world[:, 0][:, at] - truth[:, at], axis=-1).mean() for name, fit in fits.items()}
    assert error["stand"] < 0.95 * error["loose"]
    away = (fits["stand"].xyz_world[:, 0] - truth)[:, at]
    sigma = np.sqrt(np.diagonal(fits["stand"].cov_world[:, 0][:, at], axis1=-2, axis2=-1))
    assert np.mean(np.abs(away) < 1.645 * sigma) > 0.85


def test_a_skeleton_without_feet_stands_nowhere(poses) -> None:
    body = bodies_from_poses(poses)[0]
    legs = [k for k in range(len(ANATOMICAL23)) if ANATOMICAL23.keypoints[k] not in SOLES]
    xyz, cov = (plane[:, 0][:, legs] for plane in (poses.xyz_world, poses.cov_world))
    places, _ = contacts_of(poses.t_ns, xyz, cov, body.skeleton, np.array(legs))
    toes = [row for row, k in enumerate(legs) if "toe" not in ANATOMICAL23.keypoints[k]]
    assert np.isnan(places[:, toes]).all()
