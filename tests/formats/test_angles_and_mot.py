"""Angle tables and OpenSim motion files: round trips, units at the door, errors that name the line."""

import csv

import numpy as np
import pytest

from posefuse.core import SE3, InputError, JointAngles
from posefuse.formats.angles import write_angles
from posefuse.formats.mot import MotTable, motion_from_joints, read_mot, write_mot


@pytest.fixture
def joints():
    rng = np.random.default_rng(2)
    angle = rng.normal(size=(4, 2, 3, 3))
    angle[1, 0, 1, 2] = np.nan
    angle[:, :, 2, 1] = np.nan
    frames = SE3.identity((4, 2, 1))
    names = (("flexion", "adduction", "rotation"),) * 3
    t_ns = np.array([10, 20, 35, 40]) * 1_000_000
    return JointAngles(
        t_ns=t_ns,
        person_id=[3, 9],
        segments=("pelvis",),
        world_from_segment=frames,
        joints=("left_hip", "left_knee", "neck"),
        angle_names=names,
        angle_rad=angle,
        sigma_rad=np.abs(angle) * 0.1,
    )


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


def test_a_motion_comes_back(tmp_path, joints):
    motion = motion_from_joints(joints, person=1, name="second person")
    assert "neck_adduction" not in motion.columns
    assert motion.t_s[0] == 0
    write_mot(tmp_path / "a.mot", motion)
    back = read_mot(tmp_path / "a.mot")
    assert back.name == "second person"
    assert back.columns == motion.columns
    assert back.in_degrees
    np.testing.assert_allclose(back.values, motion.values, rtol=1e-9)
    np.testing.assert_allclose(back.column("left_hip_flexion"), np.degrees(joints.angle_rad[:, 1, 0, 0]), rtol=1e-9)


def test_radians_stay_radians(tmp_path):
    write_mot(tmp_path / "a.sto", MotTable(name="m", t_s=[0.0, 0.1], columns=("q",), values=[[1.0], [np.nan]], in_degrees=False))
    back = read_mot(tmp_path / "a.sto")
    assert not back.in_degrees
    assert np.isnan(back.values[1, 0])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "endheader"),
        ("m\nendheader\nfoo\tq\n0\t1\n", "line 3: expected the first column 'time', got foo"),
        ("m\nendheader\ntime\tq\n0\t1\n0.1\n", "line 5: expected 2 numbers, got 1"),
        ("m\nendheader\ntime\tq\n0\tx\n", "line 4: could not convert"),
    ],
)
def test_broken_files_say_where(tmp_path, text, message):
    (tmp_path / "b.mot").write_text(text)
    with pytest.raises(InputError, match=message):
        read_mot(tmp_path / "b.mot")


def test_unknown_names_list_what_exists(joints):
    with pytest.raises(InputError, match=r"no column 'knee'; there are: left_hip_flexion"):
        motion_from_joints(joints).column("knee")
