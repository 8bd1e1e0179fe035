"""Angles put into a figure come out again; laws of frames and angles; stated rules where they are not defined."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from built import arrays_of, shaken, unseen
from checks import refusal
from figure import BENT, sequence_of
from scipy.spatial.transform import Rotation

from posefuse import kinematics
from posefuse.core import SE3, SKELETONS, InputError, ShapeError
from posefuse.kinematics import JOINT_NAMES, JointSettings, JointTracker, joints_from_poses, undefined_segments

EXACT = JointSettings(hinge_play_rad=0.0, turn_rate_rad_sqrt_s=10.0)


def degrees_of(joints, name, i=0, n=0):
    return np.degrees(joints.angle_rad[i, n, joints.joints.index(name)])


@pytest.mark.parametrize("root", [np.eye(3), Rotation.from_euler("xyz", [130, 20, -70], degrees=True).as_matrix()])
def test_angles_put_in_come_out(root):
    joints = joints_from_poses(sequence_of([BENT], root=root), EXACT)
    for name, expected in BENT.items():
        if name == "pelvis" and not np.allclose(root, np.eye(3)):
            continue
        got = degrees_of(joints, name)
        defined = np.isfinite(got)
        assert defined.any(), name
        np.testing.assert_allclose(got[defined], np.array(expected)[defined], atol=1e-5, err_msg=name)


def test_shoulder_follows_isb_plane_and_elevation():
    abducted, forward = {"right_arm": (0, -70, 0), "right_elbow": (40, 0, 0)}, {"left_arm": (60, 0, 0), "left_elbow": (40, 0, 0)}
    right = degrees_of(joints_from_poses(sequence_of([abducted]), EXACT), "right_shoulder")
    left = degrees_of(joints_from_poses(sequence_of([forward]), EXACT), "left_shoulder")
    np.testing.assert_allclose(right[:2], [0, 70], atol=1e-5)
    np.testing.assert_allclose(left[:2], [90, 60], atol=1e-5)


def test_shoulder_sequence_agrees_with_scipy():
    frames = joints_from_poses(sequence_of([BENT]), EXACT)
    rotation = frames.world_from_segment.matrix()[0, 0]
    thorax, arm = (rotation[frames.segments.index(s)] for s in ("thorax", "right_upper_arm"))
    plane, elevation, turn = degrees_of(frames, "right_shoulder")
    rebuilt = Rotation.from_euler("YXY", [plane, -elevation, turn], degrees=True).as_matrix()
    np.testing.assert_allclose(rebuilt, thorax.T @ arm, atol=1e-8)


@pytest.mark.parametrize("turned_deg", [(40, -150, 75), (180, 0, 0)], ids=["anyhow", "upside down"])
def test_moving_the_world_changes_only_the_pelvis(turned_deg):
    sequence = sequence_of([BENT])
    turn = Rotation.from_euler("xyz", turned_deg, degrees=True).as_matrix()
    xyz = sequence.xyz_world @ turn.T + [3.0, -2.0, 1.0]
    moved = replace(sequence, xyz_world=xyz, cov_world=turn @ sequence.cov_world @ turn.T)
    before, after = joints_from_poses(sequence), joints_from_poses(moved)
    np.testing.assert_allclose(after.angle_rad[:, :, 1:], before.angle_rad[:, :, 1:], atol=1e-9)
    np.testing.assert_allclose(after.sigma_rad[:, :, 1:], before.sigma_rad[:, :, 1:], rtol=1e-6)
    np.testing.assert_allclose(after.world_from_segment.matrix(), turn @ before.world_from_segment.matrix(), atol=1e-9)


def test_mirroring_the_subject_swaps_the_sides():
    sequence = sequence_of([BENT])
    xyz = sequence.xyz_world[:, :, sequence.skeleton.mirror] * [1, -1, 1]
    mirrored = replace(sequence, xyz_world=xyz)
    before, after = joints_from_poses(sequence, EXACT), joints_from_poses(mirrored, EXACT)
    for name in JOINT_NAMES:
        if name.startswith("left_"):
            other = name.replace("left_", "right_")
            np.testing.assert_allclose(degrees_of(after, name), degrees_of(before, other), atol=1e-6, err_msg=name)
    np.testing.assert_allclose(degrees_of(after, "neck"), degrees_of(before, "neck") * [1, -1, -1], atol=1e-6)


def test_sigma_is_the_spread_of_angles_of_noisy_points():
    rng = np.random.default_rng(4)
    sigma_m, count = 0.0005, 2000
    clean = sequence_of([BENT])
    truth = joints_from_poses(clean, EXACT)
    spread = rng.normal(size=(count, *clean.xyz_world.shape[1:])) * sigma_m * [1, 2, 0.5]
    xyz = clean.xyz_world + spread
    cov = np.broadcast_to(np.diag((sigma_m * np.array([1, 2, 0.5])) ** 2), (*xyz.shape, 3))
    errors, stated = [], None
    for i in range(count):
        tracker = JointTracker(clean.skeleton, EXACT)
        one = replace(clean, xyz_world=xyz[i : i + 1], cov_world=cov[:1])
        joints = tracker.step(one.at(0))
        errors.append(joints.angle_rad[0, 0] - truth.angle_rad[0, 0])
        stated = joints.sigma_rad[0, 0]
    seen = np.std(errors, axis=0)
    defined = np.isfinite(stated)
    assert defined.sum() > 30
    np.testing.assert_allclose(seen[defined] / stated[defined], 1.0, atol=0.12)


def test_angles_stay_continuous_through_straight_knees_and_whole_turns():
    t = np.linspace(0, 4, 401)
    knee_deg, hip_deg = 30 - 30 * np.cos(6 * t), 25 * np.sin(6 * t)
    turns = zip(200 * t, hip_deg, knee_deg, strict=True)
    frames = [{"pelvis": (turn, 0, 0), "left_hip": (hip, 2, 5), "left_knee": (knee, 0, 0)} for turn, hip, knee in turns]
    joints = joints_from_poses(sequence_of(frames))
    for name in ("pelvis", "left_hip", "left_knee"):
        angles = degrees_of(joints, name, slice(None))
        defined = np.isfinite(angles).all(axis=0)
        assert np.abs(np.diff(angles[:, defined], axis=0)).max() < 4, name
    turned = degrees_of(joints, "pelvis", slice(None))
    assert turned[-1, 0] - turned[0, 0] == pytest.approx(800, abs=1e-3)
    np.testing.assert_allclose(degrees_of(joints, "left_knee", slice(None))[:, 0], knee_deg, atol=0.05)


@pytest.mark.parametrize("direction", [1, -1])
def test_a_foot_that_noise_turns_right_round_is_back_afterwards(direction):
    """Two wrong time steps had put a whole turn on the ankle for the rest of the recording."""
    wrong = [{"left_ankle": (direction * degrees, 0, 0)} for degrees in (10, 130, 250)]
    poses = sequence_of([BENT] * 5 + [BENT | one for one in wrong] + [BENT] * 5)
    tracker = JointTracker(poses.skeleton)
    live = np.concatenate([tracker.step(poses.at(i)).angle_rad for i in range(len(poses))])
    q = JOINT_NAMES.index("left_ankle")
    for angles in (joints_from_poses(poses).angle_rad, live):
        np.testing.assert_allclose(np.degrees(angles[-1, 0, q, 0]), BENT["left_ankle"][0], atol=3)


def test_noise_on_a_straight_leg_does_not_reach_the_turn():
    frames = [{"left_knee": (60.0 if i < 30 else 0.5, 0, 0), "left_hip": (20, 0, 10)} for i in range(90)]
    noisy = shaken(sequence_of(frames, sigma_m=0.01), 0.01, seed=1)
    tracker = JointTracker(noisy.skeleton)
    live = [tracker.step(noisy.at(i)) for i in range(90)]
    turn = np.array([degrees_of(j, "left_hip")[2] for j in live])
    sigma = np.degrees([j.sigma_rad[0, 0, JOINT_NAMES.index("left_hip"), 2] for j in live])
    carried = slice(35, 60)
    assert np.abs(np.diff(turn[carried])).max() < 8
    assert sigma[59] > 1.5 * sigma[29]
    assert np.abs(turn[carried] - 10).max() < 3 * np.nanmax(sigma[carried])


def test_the_plane_of_a_straight_leg_wanders_as_the_settings_state():
    """The turn of the hip is known from the bent knee at first; then nothing is seen of it."""
    sequence = sequence_of([{"left_knee": (60.0 if i < 30 else 0.0, 0, 0)} for i in range(90)], sigma_m=0.001)
    tracker = JointTracker(sequence.skeleton, JointSettings(turn_rate_rad_sqrt_s=0.4))
    sigma = np.array([tracker.step(one).sigma_rad[0, 0, JOINT_NAMES.index("left_hip"), 2] for one in map(sequence.at, range(90))])
    unseen_s = (sequence.t_ns[30:] - sequence.t_ns[29]) / 1e9
    np.testing.assert_allclose(sigma[30:] ** 2 - sigma[29] ** 2, 0.4**2 * unseen_s, rtol=1e-3)


@pytest.mark.parametrize(("limb", "seconds"), [("left_elbow", 4), ("right_knee", 4)])
def test_a_reversed_plane_is_found_in_points_too_uncertain_to_show_it_at_once(limb, seconds):
    """Bent backwards at first, which no human can: its plane is then taken as reversed."""
    frames = [{limb: (-80.0 if i < 5 else 25.0, 0, 0)} for i in range(30 * seconds)]
    clear, uncertain = sequence_of(frames, sigma_m=0.002), sequence_of(frames, sigma_m=0.03)
    cov = np.where((np.arange(len(clear)) < 5)[:, None, None, None, None], clear.cov_world, uncertain.cov_world)
    tracker = JointTracker(clear.skeleton)
    flexion = [degrees_of(tracker.step(one), limb)[0] for one in map(replace(clear, cov_world=cov).at, range(len(clear)))]
    assert flexion[10] < -15
    np.testing.assert_allclose(flexion[-30:], 25, atol=1)


def test_a_straight_limb_keeps_its_plane_among_errors_that_last():
    rng = np.random.default_rng(6)
    frames = [{"left_elbow": (60.0 if i < 30 else 5.0, 0, 0)} for i in range(1800)]
    clean, error, lasts = sequence_of(frames, sigma_m=0.03), np.zeros((33, 3)), np.exp(-1 / 6)
    tracker, flexion = JointTracker(clean.skeleton), []
    for i in range(len(clean)):
        error = lasts * error + np.sqrt(1 - lasts**2) * rng.normal(size=error.shape)
        one = clean.at(i)
        flexion.append(degrees_of(tracker.step(replace(one, xyz_world=one.xyz_world + 0.03 * error)), "left_elbow")[0])
    # turned round, it would be -5
    assert np.nanmean(flexion[60:]) > 2


def test_live_equals_recorded_when_the_planes_are_clear():
    frames = [{**BENT, "left_knee": (40 + i, 0, 0)} for i in range(20)]
    sequence = sequence_of(frames)
    tracker = JointTracker(sequence.skeleton, EXACT)
    live = np.concatenate([tracker.step(sequence.at(i)).angle_rad for i in range(20)])
    np.testing.assert_allclose(live, joints_from_poses(sequence, EXACT).angle_rad, atol=1e-6)


@pytest.mark.parametrize("skeleton", sorted(SKELETONS))
def test_what_a_skeleton_promises_is_there(skeleton):
    joints, lost = joints_from_poses(sequence_of([BENT], skeleton), EXACT), undefined_segments(SKELETONS[skeleton])
    assert not lost or skeleton != "blazepose33"
    for q, joint in enumerate(kinematics.JOINTS):
        possible = np.array(joint.determined) & (joint.child not in lost) & (joint.parent not in lost)
        np.testing.assert_array_equal(np.isfinite(joints.angle_rad[0, 0, q]), possible, err_msg=joint.name)


def test_a_missing_keypoint_takes_only_what_needs_it():
    joints = joints_from_poses(unseen(sequence_of([BENT]), "left_ankle"), EXACT)
    assert np.isnan(degrees_of(joints, "left_knee")).all()
    np.testing.assert_allclose(degrees_of(joints, "left_hip"), [*BENT["left_hip"][:2], np.nan], atol=1e-5)
    np.testing.assert_allclose(degrees_of(joints, "right_hip"), BENT["right_hip"], atol=1e-5)


def test_gimbal_lock_leaves_the_middle_angle_alone():
    joints = joints_from_poses(sequence_of([{**BENT, "right_arm": (0.0, 0.5, 0.0)}]), EXACT)
    np.testing.assert_allclose(degrees_of(joints, "right_shoulder"), [np.nan, 0.5, np.nan], atol=1e-4)
    assert np.isfinite(degrees_of(joints, "right_arm")).all()


def test_swapped_sides_are_refused():
    sequence = sequence_of([BENT] * 10)
    swapped = replace(sequence, person_id=[7], xyz_world=sequence.xyz_world[:, :, sequence.skeleton.mirror])
    refusal(InputError, "person 7: left and right look swapped", joints_from_poses, swapped)


def test_no_person_and_all_missing_give_empty_and_nan():
    sequence = sequence_of([BENT] * 3)
    nan = replace(sequence, xyz_world=sequence.xyz_world * np.nan, cov_world=sequence.cov_world * np.nan)
    assert np.isnan(joints_from_poses(nan).angle_rad).all()
    no_person = replace(sequence, person_id=[], **arrays_of(sequence, lambda one: one[:, :0]))
    assert joints_from_poses(no_person).angle_rad.shape == (3, 0, len(JOINT_NAMES), 3)


@pytest.mark.parametrize("far_m", [1e12, 1e16, 1e100, 1e200, np.inf])
def test_points_out_of_all_measure_break_nothing(far_m):
    sequence = sequence_of([BENT])
    pose, rng = sequence.at(0), np.random.default_rng(0)
    for k in (slice(None), *range(len(pose.skeleton))):
        tracker = JointTracker(sequence.skeleton)
        before = tracker.step(pose).angle_rad
        xyz = np.array(pose.xyz_world)
        xyz[:, k] += far_m * rng.normal(size=3)
        tracker.step(replace(pose, xyz_world=xyz))
        after = [tracker.step(replace(pose, t_ns=pose.t_ns + i * 10_000_000)) for i in range(20)][-1].angle_rad
        assert np.isfinite(after[np.isfinite(before)]).all()


def test_points_that_coincide_give_no_angles_and_no_error():
    sequence = sequence_of([BENT])
    pose, tracker = sequence.at(0), JointTracker(sequence.skeleton)
    whole = np.isfinite(tracker.step(pose).angle_rad)
    lost = set()
    for one, other in sequence.skeleton.bone_indices:
        xyz = np.array(pose.xyz_world)
        xyz[:, one] = xyz[:, other]
        joints = tracker.step(replace(pose, xyz_world=xyz))
        missing = (whole & np.isnan(joints.angle_rad))[0, 0].any(axis=-1)
        lost |= {joints.joints[q] for q in np.flatnonzero(missing)}
    assert {"left_knee", "right_elbow", "left_ankle"} <= lost


def test_the_tracker_refuses_another_skeleton():
    with pytest.raises(ShapeError, match="expected skeleton coco17, got blazepose33"):
        JointTracker(SKELETONS["coco17"]).step(sequence_of([BENT]).at(0))


# --- the page of conventions says what the code does


PAGE = Path(__file__).parents[2] / "docs" / "kinematics.md"


def test_every_joint_is_documented_with_its_sequence_and_angles():
    rows = dict(re.findall(r"^\| (\w+) \|[^|]*\| ([XYZ]-[XYZ]-[XYZ] \| [a-z_, ]+) \|", PAGE.read_text(), re.MULTILINE))
    said = {re.sub("left_|right_", "", j.name): f"{'-'.join(j.sequence)} | {', '.join(j.angle_names)}" for j in kinematics.JOINTS}
    assert rows == said


# --- where the body faces, by clues that do not depend on which side is called left


LIMBS = {"left_knee": (40.0, 0.0, 0.0), "right_knee": (25.0, 0.0, 0.0), "left_elbow": (70.0, 0.0, 0.0)}


def test_clues_turn_with_the_limbs_whose_sides_are_swapped_and_not_with_the_world() -> None:
    sequence = sequence_of([LIMBS] * 3)
    votes = kinematics.facing_votes(sequence)
    assert votes.shape == (2, 3, 1)
    assert (votes >= 4).all()
    for part, (left, right) in enumerate(sequence.skeleton.limbs):
        order = np.arange(len(sequence.skeleton))
        order[left], order[right] = right, left
        swapped = kinematics.facing_votes(replace(sequence, xyz_world=sequence.xyz_world[:, :, order]))
        assert (swapped[part] <= -4).all()
        assert (swapped[1 - part] >= 4).all()
    new_from_old = SE3.from_rotvec([0.4, -1.0, 0.3], [3.0, -2.0, 1.0])
    assert np.array_equal(kinematics.facing_votes(replace(sequence, xyz_world=new_from_old @ sequence.xyz_world)), votes)


def test_without_face_feet_and_knees_there_is_no_clue() -> None:
    sequence = sequence_of([LIMBS])
    clues = [name for name in sequence.skeleton.keypoints if name.endswith(("nose", "heel", "index", "knee"))]
    assert not kinematics.facing_votes(unseen(sequence, *clues)).any()
