"""Angle tables and OpenSim motion files: round trips, units at the door, errors that name the line."""

import csv
import dataclasses

import numpy as np
import pytest
from built import joint_angles
from checks import refusal
from motions import columns_of
from scipy.spatial.transform import Rotation

from posefuse.core import SE3, InputError
from posefuse.formats.mot import OPENSIM, motion_from_joints, write_mot
from posefuse.kinematics import JOINTS
from posefuse.outputs.data_files import write_angles


@pytest.fixture
def joints():
    rng = np.random.default_rng(2)
    angle = rng.normal(size=(4, 2, 3, 3))
    angle[1, 0, 1, 2] = np.nan
    angle[:, :, 2, 1] = np.nan
    t_ns = np.array([10, 20, 35, 40]) * 1_000_000
    return joint_angles(angle, joints=("left_hip", "left_knee", "neck"), t_ns=t_ns, person_id=[3, 9])


def test_a_table_of_angles_has_degrees_and_the_columns_of_the_table_of_points(tmp_path, joints):
    write_angles(tmp_path / "angles.csv", joints)
    with (tmp_path / "angles.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0])[:4] == ["t_s", "person", "left_hip.flexion_deg", "left_hip.flexion_sigma_deg"]
    assert [(row["t_s"], row["person"]) for row in rows[:3]] == [("0.01", "3"), ("0.01", "9"), ("0.02", "3")]
    rotation = [row["left_knee.rotation_deg"] for row in rows]
    assert rotation.pop(2) == "" and len(max(rotation, key=len)) <= len("-123.4567")
    expected = np.delete(np.degrees(joints.angle_rad[:, :, 1, 2]).ravel(), 2)
    np.testing.assert_allclose([float(cell) for cell in rotation], expected, atol=5.1e-5)
    sigma = [float(row["neck.flexion_sigma_deg"]) for row in rows]
    np.testing.assert_allclose(sigma, np.degrees(joints.sigma_rad[:, :, 2, 0]).ravel(), atol=5.1e-5)


def test_a_motion_comes_back_under_the_names_and_signs_of_opensim(tmp_path, joints):
    motion = motion_from_joints(joints, person=1, name="second person").table
    assert "neck_adduction" not in motion.columns
    motion = dataclasses.replace(motion, t_s=motion.t_s + 1.7e9)  # of cameras that stamp the date
    write_mot(tmp_path / "a.mot", motion)
    lines, back = (tmp_path / "a.mot").read_text().splitlines(), columns_of(tmp_path / "a.mot")
    assert lines[0] == "second person" and "inDegrees=yes" in lines
    assert tuple(back) == ("time", *motion.columns)
    np.testing.assert_allclose(back["time"], 1.7e9 + 1e-9 * joints.t_ns, rtol=1e-15)
    np.testing.assert_allclose(np.stack(list(back.values())[1:], axis=1), motion.values, rtol=1e-9)
    np.testing.assert_allclose(back["hip_flexion_l"], np.degrees(joints.angle_rad[:, 1, 0, 0]), rtol=1e-9)
    np.testing.assert_allclose(back["left_knee_rotation"], np.degrees(joints.angle_rad[:, 1, 1, 2]), rtol=1e-9)


def test_every_name_of_opensim_is_a_defined_angle_with_its_sign():
    names, angle = [one.angle_names for one in JOINTS], np.random.default_rng(5).normal(size=(4, 1, len(JOINTS), 3))
    joints = joint_angles(angle, joints=[one.name for one in JOINTS], angle_names=names)
    motion = columns_of(motion_from_joints(joints).table)
    np.testing.assert_array_equal((joints.deg, joints.sigma_deg), np.degrees((joints.angle_rad, joints.sigma_rad)))
    for name, (joint, angle, sign) in OPENSIM.items():
        if not name.startswith("pelvis"):
            np.testing.assert_array_equal(motion[name], sign * joints[joint, angle].deg, err_msg=name)
    assert OPENSIM["lumbar_extension"] == ("trunk", "flexion", -1)


def test_the_pelvis_is_placed_by_the_turns_of_the_free_joint_of_the_models():
    """Composed as a model composes them, the coordinates give the pelvis in the axes of `pose.trc`."""
    rng = np.random.default_rng(3)
    world_from_pelvis = SE3.from_rotvec(rng.uniform(-1.2, 1.2, (50, 1, 1, 3)), rng.normal(size=(50, 1, 1, 3)))
    nothing = np.full((50, 1, 1, 3), np.nan)
    values = columns_of(motion_from_joints(joint_angles(nothing, joints=("neck",), world_from_segment=world_from_pelvis)).table)
    turns = [values[f"pelvis_{name}"] for name in ("tilt", "list", "rotation")]
    composed = Rotation.from_euler("ZXY", np.stack(turns, axis=1), degrees=True).as_matrix()
    ground = world_from_pelvis.matrix4()[:, 0, 0, [1, 2, 0]]
    np.testing.assert_allclose(composed, ground[:, :, :3], atol=1e-12)
    place = np.stack([values[f"pelvis_t{axis}"] for axis in "xyz"], axis=1)
    np.testing.assert_allclose(place, ground[:, :, 3], atol=1e-12)


def gapped(joints, gaps):
    """The angles of a person at 10 Hz for 8 s, unknown at (joint, first, end) time steps; joint None: all of the person."""
    angle = np.tile(joints.angle_rad[:1, :1], (80, 1, 1, 1)) + np.arange(80)[:, None, None, None] * 0.01
    xyz = np.zeros((80, 1, 1, 3))
    for j, first, end in gaps:
        angle[first:end, :, slice(None) if j is None else j] = np.nan
        if j is None:
            xyz[first:end] = np.nan
    t_ns, place = np.arange(80) * 100_000_000, SE3.from_rotvec(xyz, xyz)
    return joint_angles(angle, joints=joints.joints, t_ns=t_ns, person_id=[3], world_from_segment=place)


def test_short_gaps_are_bridged_long_ones_leave_the_column_out_and_both_are_stated(tmp_path, joints):
    motion, note = motion_from_joints(gapped(joints, [(0, 20, 23), (1, 20, 26)]))
    out = "knee_angle_l, left_knee_adduction, left_knee_rotation"
    assert note == f"gaps of up to 0.5 s bridged in 3 columns; left out, unknown for longer: {out}"
    whole = motion_from_joints(gapped(joints, []))
    assert whole.note == ""
    np.testing.assert_allclose(columns_of(motion)["hip_flexion_l"], columns_of(whole.table)["hip_flexion_l"], atol=1e-9)
    write_mot(tmp_path / "a.mot", motion)
    assert "nan" not in (tmp_path / "a.mot").read_text()


def test_of_a_person_who_goes_and_comes_back_the_longest_time_is_kept(joints):
    motion, note = motion_from_joints(gapped(joints, [(None, 0, 5), (None, 30, 50)]))
    np.testing.assert_allclose(motion.t_s, np.arange(50, 80) * 0.1)
    assert note.startswith("holds 5.00 to 7.90 s, the longest time the person is there")
    # a pelvis that is carried on through the gap does not hold what comes before and after it together
    carried = gapped(joints, [(None, 30, 50)])
    carried = dataclasses.replace(carried, world_from_segment=gapped(joints, []).world_from_segment)
    alone = motion_from_joints(carried).table
    assert alone.t_s[-1] == pytest.approx(2.9) and "knee_angle_l" in alone.columns
    unseen = motion_from_joints(gapped(joints, [(None, 0, 80)]))
    assert len(unseen.table.t_s) == 0 and unseen.table.columns == ()


def test_the_unknown_is_not_written(tmp_path, joints):
    motion = motion_from_joints(joints).table
    unknown = dataclasses.replace(motion, values=np.where(np.arange(len(motion.columns)) == 3, np.nan, motion.values))
    refusal(InputError, r"b\.mot: pelvis_tx is unknown at 0\.01 s", write_mot, tmp_path / "b.mot", unknown)
    assert not (tmp_path / "b.mot").exists()
