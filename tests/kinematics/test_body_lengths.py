"""Segment lengths solved together with poses: derivatives, recovery of simulated truth, the part of the prior."""

from dataclasses import replace

import numpy as np
import pytest
from built import view_sequence

from posefuse.core import ViewSequence
from posefuse.kinematics.body import BodySettings, LengthPrior, bodies_from_poses, fit_views, tree_kernels
from posefuse.kinematics.body.filter import guessed_state
from posefuse.kinematics.body.model import packed_from_body
from posefuse.kinematics.body.result import length_derivatives
from posefuse.kinematics.body.shape import slopes_of
from posefuse.kinematics.joints import FrameBuffers
from posefuse.kinematics.settings import JointSettings

NAMES = ("upper_arm", "forearm", "thigh", "shank", "shoulders", "hips", "trunk")
TRUE_M = np.array([0.31, 0.26, 0.43, 0.41, 0.38, 0.26, 0.52])
KEYS = ("left_upper_arm", "right_forearm", "left_thigh", "right_shank", "shoulders", "pelvis", "trunk")
SETTINGS = BodySettings(noise_memory_s=0.0, offset_sigma_m=0.0, hip_sigma_m=0.0, robust_dof=1e6, length_steps=10)
STEPS, RATE_HZ, SIGMA_PX = 20, 20.0, 0.5


def squat(t: float) -> dict:
    bend = 50 - 45 * np.cos(2 * np.pi * t)
    legs = {f"{side}_{joint}": (part * bend, 3, 2) for side in ("left", "right") for joint, part in (("hip", 0.8), ("knee", 1.2))}
    arms = {f"{side}_arm": (0.9 * bend, -12, 6) for side in ("left", "right")}
    return legs | arms | {f"{side}_elbow": (20 + 0.6 * bend, 0, 0) for side in ("left", "right")} | {"trunk": (0, 4, 3)}


@pytest.fixture(scope="module")
def squatter(posed):
    """Exact keypoints of somebody whose lengths are all different, and of no usual proportions."""
    return posed([squat(i / RATE_HZ) for i in range(STEPS)], "coco17", sigma_m=0.005, rate_hz=RATE_HZ)


def views_of(rig, poses, rng) -> ViewSequence:
    xy = np.moveaxis(rig.project(poses.xyz_world), 0, 2)
    xy = xy + rng.normal(size=xy.shape) * SIGMA_PX
    return view_sequence(rig, poses, xy, sigma_px=SIGMA_PX)


def lengths(fit) -> tuple[np.ndarray, np.ndarray]:
    solved = fit.bodies[0].lengths
    return np.array([solved[key].value_m for key in KEYS]), np.array([solved[key].sigma_m for key in KEYS])


def prior(mean_m: np.ndarray, sigma_m: float) -> LengthPrior:
    return LengthPrior(names=NAMES, mean_m=mean_m, cov_m2=np.eye(len(NAMES)) * sigma_m**2)


def test_derivatives_by_lengths_equal_finite_differences(squatter) -> None:
    body = bodies_from_poses(squatter)[0]
    packed = packed_from_body(body, SETTINGS)
    state = guessed_state(body, packed, FrameBuffers(squatter.skeleton, JointSettings()), squatter.xyz_world[5, 0, body.keypoint])
    assert state is not None

    def places(offset: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        frame, origin = np.empty_like(state[1]), np.empty((len(body.nodes), 3))
        tree_kernels.forward_kinematics(packed.tree.parent, packed.tree.kind, packed.tree.axis, offset, *state, frame, origin)
        return np.stack(
            [tree_kernels.place(frame, origin, n, x) for n, x in zip(packed.tree.node, packed.tree.local, strict=True)]
        ), frame

    slopes = slopes_of(body, NAMES)
    derived = length_derivatives(packed, slopes, places(packed.tree.offset)[1])
    for s in range(len(NAMES)):
        ahead, back = (places(packed.tree.offset + sign * 1e-5 * slopes[:, s])[0] for sign in (1, -1))
        np.testing.assert_allclose(derived[..., s], (ahead - back) / 2e-5, atol=1e-8)
        assert np.abs(derived[..., s]).max() > 0.4, NAMES[s]


def test_every_length_is_recovered_from_a_wrong_start(squatter, ring_rig) -> None:
    """Medians of poses that are 8 % too small are too short; rays are not. Poses do not take up what lengths lack."""
    rig, rng = ring_rig(4), np.random.default_rng(3)
    views = views_of(rig, squatter, rng)
    small = replace(squatter, xyz_world=0.92 * squatter.xyz_world + 0.08 * np.nanmean(squatter.xyz_world, axis=2, keepdims=True))
    before = np.array([bodies_from_poses(small)[0].lengths[key].value_m for key in KEYS])
    fit = fit_views(small, rig, views, SETTINGS, lengths=prior(TRUE_M * 0.9, 0.5))
    metres, sigma = lengths(fit)
    assert (np.abs(before / TRUE_M - 1) > 0.05).all()
    # the trunk is the weakest: the spine stretches
    np.testing.assert_allclose(metres[:-1], TRUE_M[:-1], atol=0.004)
    assert (np.abs(metres - TRUE_M) < 4 * sigma).all() and (sigma < 0.01).all()
    assert np.nanmax(np.linalg.norm(fit.poses.xyz_world - squatter.xyz_world, axis=-1)) < 0.02


def test_a_prior_counts_by_its_sigma(squatter, ring_rig) -> None:
    rig = ring_rig(4)
    views = views_of(rig, squatter, np.random.default_rng(4))
    tight, _ = lengths(fit_views(squatter, rig, views, SETTINGS, lengths=prior(TRUE_M * 1.1, 1e-5)))
    loose, _ = lengths(fit_views(squatter, rig, views, SETTINGS, lengths=prior(TRUE_M * 1.1, 1.0)))
    np.testing.assert_allclose(tight, TRUE_M * 1.1, atol=1e-4)
    np.testing.assert_allclose(loose, TRUE_M, atol=0.004)
