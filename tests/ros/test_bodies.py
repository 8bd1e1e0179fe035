import dataclasses
from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from posefuse.core import SE3
from posefuse_ros.bodies import JOINTS, LINKS, bodies_from_pose


def turned(axis, angle):
    return Rotation.from_rotvec(np.asarray(axis, float) * angle).as_matrix()


X, Y, Z = np.eye(3)


def joint(bodies, name, n=0):
    return bodies.position_rad[n, JOINTS.index(name)]


def link(bodies, name, n=0):
    return bodies.world_from_link[n, LINKS.index(name)]


def test_standing_is_the_zero_pose(standing):
    bodies = bodies_from_pose(standing())
    np.testing.assert_allclose(bodies.position_rad, 0, atol=1e-9)
    for name in LINKS:
        np.testing.assert_allclose(link(bodies, name).matrix(), np.eye(3), atol=1e-9, err_msg=name)
    np.testing.assert_allclose(link(bodies, "body").xyz, [0, 0, 0.9])
    np.testing.assert_allclose(link(bodies, "l_elbow").xyz, [0, 0.2, 1.1])


def test_signs_of_the_reference_urdf(standing):
    # left forearm forward, right arm to the side, left knee back, looking to the left
    bodies = bodies_from_pose(
        standing(
            left_wrist=(0.25, 0.2, 1.1),
            right_elbow=(0, -0.5, 1.4), right_wrist=(0, -0.75, 1.4),
            left_ankle=(-0.4, 0.1, 0.5),
            nose=(0.1 * np.cos(0.5), 0.1 * np.sin(0.5), 1.6),
            left_ear=(-0.08 * np.sin(0.5), 0.08 * np.cos(0.5), 1.6), right_ear=(0.08 * np.sin(0.5), -0.08 * np.cos(0.5), 1.6),
        )
    )  # fmt: skip
    expected = {"l_elbow": np.pi / 2, "r_p_shoulder": np.pi / 2, "l_knee": -np.pi / 2, "y_head": 0.5, "r_elbow": 0}
    for name, value in expected.items():
        assert joint(bodies, name) == pytest.approx(value, abs=1e-6), name


@pytest.mark.parametrize("seed", range(20))
def test_the_urdf_chain_points_limbs_where_they_were_seen(some_pose, seed):
    """Forward kinematics with the joint axes of `human_description`, against the input."""
    pose = some_pose(people=3, seed=seed)
    pose = dataclasses.replace(pose, xyz_world=np.random.default_rng(seed).normal(size=pose.xyz_world.shape))
    bodies = bodies_from_pose(pose)
    for n in range(3):
        body = link(bodies, "body", n).matrix()
        for side, short, s in (("left", "l", 1), ("right", "r", -1)):

            def at(part, n=n, side=side):
                return pose.xyz_world[n, pose.skeleton.index(f"{side}_{part}")]

            def q(name, n=n, short=short):
                return joint(bodies, name.format(short), n)

            arm = (
                body @ turned(-s * Z, q("{}_y_shoulder")) @ turned(s * X, q("{}_p_shoulder")) @ turned(s * Z, q("{}_r_shoulder"))
            )
            leg = body @ turned(-Z, q("{}_y_hip")) @ turned(s * X, q("{}_p_hip")) @ turned(-Y, q("{}_r_hip"))
            chain = [
                (arm, "shoulder", "elbow"),
                (arm @ turned(-Y, q("{}_elbow")), "elbow", "wrist"),
                (leg, "hip", "knee"),
                (leg @ turned(-Y, q("{}_knee")), "knee", "ankle"),
            ]
            for rotation, near, far in chain:
                bone = at(far) - at(near)
                bend = {"wrist": q("{}_elbow"), "ankle": q("{}_knee")}.get(far, np.pi / 2)
                nearly_straight = np.sin(abs(bend)) < np.sin(np.deg2rad(10))
                off = np.linalg.norm(rotation @ -Z - bone / np.linalg.norm(bone))
                assert off <= (2 * np.sin(np.deg2rad(10)) if nearly_straight else 1e-9)
                np.testing.assert_allclose(link(bodies, f"{short}_{near}", n).matrix(), rotation, atol=1e-9)
        head = (
            body
            @ turned(X, joint(bodies, "r_head", n))
            @ turned(Z, joint(bodies, "y_head", n))
            @ turned(-Y, joint(bodies, "p_head", n))
        )
        np.testing.assert_allclose(link(bodies, "head", n).matrix(), head, atol=1e-9)


def test_moving_the_world_moves_the_links_and_leaves_the_joints(some_pose):
    pose = some_pose(people=3, seed=4)
    pose = dataclasses.replace(pose, xyz_world=np.random.default_rng(4).normal(size=pose.xyz_world.shape))
    new_from_old = SE3.from_rotvec([0.3, -0.8, 0.5], [1.0, 2, 3])
    before, after = bodies_from_pose(pose), bodies_from_pose(dataclasses.replace(pose, xyz_world=new_from_old @ pose.xyz_world))
    np.testing.assert_allclose(after.position_rad, before.position_rad, atol=1e-8)
    np.testing.assert_allclose(after.world_from_link.xyz, new_from_old @ before.world_from_link.xyz, atol=1e-9)
    np.testing.assert_allclose(after.world_from_link.matrix(), new_from_old.matrix() @ before.world_from_link.matrix(), atol=1e-8)


def test_a_limb_going_straight_never_jumps(standing):
    def frame(bend, sideways):
        wrist = (0.25 * np.sin(bend), 0.2 + sideways, 1.1 - 0.25 * np.cos(bend))
        return link(bodies_from_pose(standing(left_wrist=wrist)), "l_shoulder").matrix()

    bends = np.linspace(-0.6, 0.6, 400)
    frames = [frame(b, 0.01) for b in bends if b > 0]
    steps = [np.linalg.norm(a - b) for a, b in pairwise(frames)]
    assert max(steps) < 0.1
    # a hair sideways of straight is noise, not a plane
    assert np.linalg.norm(frame(0.0, 1e-4) - frame(0.0, -1e-4)) < 0.02


def test_an_arm_straight_up_has_a_frame(standing):
    bodies = bodies_from_pose(standing(left_elbow=(0, 0.2, 1.7), left_wrist=(0, 0.2, 1.95)))
    shoulder = link(bodies, "l_shoulder")
    assert np.isfinite(shoulder.wxyz).all()
    np.testing.assert_allclose(shoulder.matrix() @ -Z, Z, atol=1e-9)


@pytest.mark.parametrize(("lost", "gone"), [("left_wrist", "l_elbow"), ("right_knee", "r_r_hip"), ("nose", "y_head")])
def test_what_is_not_seen_is_nan_and_the_rest_stays(standing, lost, gone):
    bodies = bodies_from_pose(standing(**{lost: (np.nan,) * 3}))
    assert np.isnan(joint(bodies, gone))
    assert joint(bodies, "l_knee") == 0
    assert np.isfinite(link(bodies, "torso").xyz).all()


def test_without_hips_there_is_nothing(standing):
    bodies = bodies_from_pose(standing(left_hip=(np.nan,) * 3))
    assert np.isnan(bodies.position_rad).all()
    assert np.isnan(bodies.world_from_link.xyz).all()


def test_no_person(some_pose):
    assert bodies_from_pose(some_pose(people=0)).position_rad.shape == (0, len(JOINTS))
