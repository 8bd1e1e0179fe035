"""Head, wrists and hands as robots want them: axes and covariance."""

import dataclasses

import built
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from posefuse.core import SE3, SKELETONS, Pose3D
from posefuse_ros import topics
from posefuse_ros.bodies import (
    JOINTS,
    LINKS,
    PARTS,
    bodies_from_pose,
    covariance_of_parts,
    parts_from_pose,
)
from posefuse_ros.ros_output import RosOutput

BLAZE = SKELETONS["blazepose33"]
S = 1_000_000_000


def person(rng=None, noise_m=0.0, t_ns=5 * S, moved=None) -> Pose3D:
    """Stands at the origin, looks along +x, elbows bent, hands forward with the palms down."""
    hand = {"wrist": (0.55, 0.2, 1.4), "index": (0.65, 0.17, 1.4), "pinky": (0.65, 0.23, 1.4)}
    xyz = built.straight(BLAZE, elbow=(0.3, 0.2, 1.25), **hand)[None]
    xyz = xyz + (rng.normal(size=xyz.shape) * noise_m if rng is not None else 0.0)
    return built.pose(xyz if moved is None else moved @ xyz, [1], t_ns, skeleton=BLAZE)


def parts_of(pose: Pose3D) -> tuple[SE3, np.ndarray]:
    """Parts of everybody and their covariance."""
    parts = parts_from_pose(pose, bodies_from_pose(pose))
    return parts, covariance_of_parts(pose, parts)


def lacking(pose: Pose3D, *keypoints: str) -> Pose3D:
    xyz, cov = pose.xyz_world.copy(), pose.cov_world.copy()
    xyz[0, BLAZE.indices(keypoints)], cov[0, BLAZE.indices(keypoints)] = np.nan, np.nan
    return dataclasses.replace(pose, xyz_world=xyz, cov_world=cov)


def test_axes_are_those_of_the_body_in_the_zero_position():
    parts, _ = parts_of(person())
    for name in ("head", "left_hand", "right_hand"):
        np.testing.assert_allclose(parts[0, PARTS.index(name)].matrix(), np.eye(3), atol=1e-9)
    np.testing.assert_allclose(parts.xyz[0, PARTS.index("left_hand")], [0.65, 0.2, 1.4], atol=1e-12)
    links = bodies_from_pose(person()).world_from_link
    wrist = parts[0, PARTS.index("right_wrist")]
    np.testing.assert_allclose(wrist.matrix4(), links[0, LINKS.index("r_wrist")].matrix4(), atol=1e-12)


def test_moving_the_world_moves_the_parts_and_turns_their_covariance():
    rng = np.random.default_rng(2)
    moved = SE3.from_rotvec(np.array([0.4, -1.1, 2.0]), np.array([3.0, -2.0, 1.0]))
    still, still_cov = parts_of(person(rng, 0.01))
    there, there_cov = parts_of(person(np.random.default_rng(2), 0.01, moved=moved))
    for p in range(len(PARTS)):
        expected = moved @ still[0, p]
        np.testing.assert_allclose(there[0, p].matrix4(), expected.matrix4(), atol=1e-9)
        both = np.kron(np.eye(2), moved.matrix())
        np.testing.assert_allclose(there_cov[0, p], both @ still_cov[0, p] @ both.T, rtol=2e-2, atol=2e-6)


def test_the_covariance_is_what_noise_of_the_keypoints_does():
    rng, (mean, mean_cov) = np.random.default_rng(0), parts_of(person())
    # 10 mm, as the poses state
    noisy = [person(rng, 0.01) for _ in range(1500)]
    seen = [parts_from_pose(pose, bodies_from_pose(pose)) for pose in noisy]
    for p, name in enumerate(PARTS):
        middle = mean[0, p]
        turns = [Rotation.from_matrix(one[0, p].matrix() @ middle.matrix().T).as_rotvec() for one in seen]
        errors = np.concatenate([[one.xyz[0, p] - middle.xyz for one in seen], turns], axis=1)
        expected = np.sqrt(np.diag(mean_cov[0, p]))
        np.testing.assert_allclose(np.sqrt((errors**2).mean(axis=0)), expected, rtol=0.12, err_msg=name)
        # a correlated pair, e.g. turn and place of a hand, has the right sign and size
        whitened = np.linalg.solve(np.linalg.cholesky(mean_cov[0, p] + 1e-12 * np.eye(6)), errors.T)
        assert (whitened**2).mean() == pytest.approx(1.0, abs=0.15), name


def test_a_part_that_is_not_seen_is_nan_and_the_others_are_there():
    pose = person()
    parts, cov = parts_of(lacking(pose, "left_pinky"))
    known = np.isfinite(parts.xyz[0]).all(axis=-1)
    assert [name for name, there in zip(PARTS, known, strict=True) if not there] == ["left_hand"]
    assert np.isfinite(cov[0][known]).all() and np.isnan(cov[0][~known]).all()
    of_coco = built.arrays_of(pose, lambda one: one[:, BLAZE.indices(SKELETONS["coco17"].keypoints)])
    coco = dataclasses.replace(pose, skeleton=SKELETONS["coco17"], **of_coco)
    assert np.isfinite(parts_of(coco)[0].xyz[0, :3]).all()


def test_a_covariance_is_known_where_a_point_that_the_part_does_not_depend_on_is_missing():
    """Rounding makes no dependence: it did for poses that are turned in the world."""
    rng = np.random.default_rng(3)
    for _ in range(20):
        assert np.isfinite(parts_of(lacking(person(rng, 0.02), "left_ear", "left_knee", "right_ankle"))[1][0, 1:]).all()


# --- what goes out


def test_parts_are_published_in_the_world(kept):
    output = RosOutput(kept)
    for i in range(3):
        output.step(person(t_ns=5 * S + i * S // 100))
    pose, cov = kept.on("/humans/bodies/p1/left_hand/pose")[0], kept.on("/humans/bodies/p1/left_hand/pose_with_covariance")[0]
    assert pose.header.frame_id == "world" and pose.pose.position.x == pytest.approx(0.65)
    assert cov.pose.covariance[0] == pytest.approx(0.5e-4, rel=1e-3)


def test_the_covariance_of_parts_is_made_only_for_those_who_ask(kept, monkeypatch):
    one = "/humans/bodies/p1/left_hand"
    kept.unwanted = {topics.body("p1", f"{part}/pose_with_covariance").name for part in PARTS}
    monkeypatch.setattr("posefuse_ros.ros_output.covariance_of_parts", None)
    output = RosOutput(kept)
    output.step(person())
    assert kept.on(f"{one}/pose") and not kept.on(f"{one}/pose_with_covariance")


X, Y, Z = np.eye(3)


def turned(axis, angle):
    return Rotation.from_rotvec(axis * angle).as_matrix()


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


def anywhere(some_pose, seed):
    """Three people whose keypoints are all seen, anywhere."""
    pose = some_pose(people=3, seed=seed)
    return dataclasses.replace(pose, xyz_world=np.random.default_rng(seed).normal(size=pose.xyz_world.shape))


@pytest.mark.parametrize("seed", range(20))
def test_the_urdf_chain_points_limbs_where_they_were_seen(some_pose, seed):
    """Forward kinematics with the joint axes of `human_description`, against the input."""
    pose = anywhere(some_pose, seed)
    bodies = bodies_from_pose(pose)
    for n in range(3):
        body, q = link(bodies, "body", n).matrix(), dict(zip(JOINTS, bodies.position_rad[n].tolist(), strict=True))
        for side, short, s in (("left", "l", 1), ("right", "r", -1)):
            y, p, r, elbow = (q[f"{short}_{name}"] for name in ("y_shoulder", "p_shoulder", "r_shoulder", "elbow"))
            arm = body @ turned(-s * Z, y) @ turned(s * X, p) @ turned(s * Z, r)
            y, p, r, knee = (q[f"{short}_{name}"] for name in ("y_hip", "p_hip", "r_hip", "knee"))
            leg = body @ turned(-Z, y) @ turned(s * X, p) @ turned(-Y, r)
            for rotation, near, far, bend in (
                (arm, "shoulder", "elbow", np.pi / 2),
                (arm @ turned(-Y, elbow), "elbow", "wrist", elbow),
                (leg, "hip", "knee", np.pi / 2),
                (leg @ turned(-Y, knee), "knee", "ankle", knee),
            ):
                start, end = (pose.xyz_world[n, pose.skeleton.index(f"{side}_{part}")] for part in (near, far))
                nearly_straight = np.sin(abs(bend)) < np.sin(np.deg2rad(10))
                off = np.linalg.norm(rotation @ -Z - (end - start) / np.linalg.norm(end - start))
                assert off <= (2 * np.sin(np.deg2rad(10)) if nearly_straight else 1e-9)
                np.testing.assert_allclose(link(bodies, f"{short}_{near}", n).matrix(), rotation, atol=1e-9)
        head = body @ turned(X, q["r_head"]) @ turned(Z, q["y_head"]) @ turned(-Y, q["p_head"])
        np.testing.assert_allclose(link(bodies, "head", n).matrix(), head, atol=1e-9)


def test_a_limb_going_straight_never_jumps(standing):
    def frame(bend, sideways):
        wrist = (0.25 * np.sin(bend), 0.2 + sideways, 1.1 - 0.25 * np.cos(bend))
        return link(bodies_from_pose(standing(left_wrist=wrist)), "l_shoulder").matrix()

    frames = np.array([frame(bend, 0.01) for bend in np.linspace(0.0015, 0.6, 200)])
    assert np.linalg.norm(np.diff(frames, axis=0), axis=(1, 2)).max() < 0.1
    # a hair sideways of straight is noise, not a plane
    assert np.linalg.norm(frame(0.0, 1e-4) - frame(0.0, -1e-4)) < 0.02


def test_an_arm_straight_up_has_a_frame(standing):
    bodies = bodies_from_pose(standing(left_elbow=(0, 0.2, 1.7), left_wrist=(0, 0.2, 1.95)))
    shoulder = link(bodies, "l_shoulder")
    assert np.isfinite(shoulder.wxyz).all()
    np.testing.assert_allclose(shoulder.matrix() @ -Z, Z, atol=1e-9)


@pytest.mark.parametrize(
    ("lost", "gone", "torso"),
    [("left_wrist", "l_elbow", True), ("right_knee", "r_r_hip", True), ("nose", "y_head", True), ("left_hip", "r_knee", False)],
)
def test_what_is_not_seen_is_nan_and_the_rest_stays_but_without_hips_there_is_nothing(standing, lost, gone, torso):
    bodies = bodies_from_pose(standing(**{lost: (np.nan,) * 3}))
    assert np.isnan(joint(bodies, gone))
    assert joint(bodies, "l_knee") == 0 if torso else np.isnan(bodies.position_rad).all()
    assert np.isfinite(link(bodies, "torso").xyz).all() if torso else np.isnan(bodies.world_from_link.xyz).all()
