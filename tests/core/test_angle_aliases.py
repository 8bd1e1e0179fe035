"""Names of OpenSim give the same angles, with OpenSim's signs."""

from pathlib import Path

import numpy as np
import pytest
from built import poses
from checks import refusal

from posefuse.core import InputError, JointAngles
from posefuse.core.joint_angles import OPENSIM
from posefuse.formats import read_truth
from posefuse.kinematics import JOINTS, joints_from_poses


def test_every_alias_is_a_defined_angle() -> None:
    defined = {(joint.name, angle) for joint in JOINTS for angle in joint.angle_names}
    assert not [name for name, (joint, angle, _) in OPENSIM.items() if (joint, angle) not in defined]


@pytest.fixture(scope="module")
def angles() -> JointAngles:
    truth = read_truth(Path(__file__).resolve().parents[2] / "examples" / "demo" / "truth" / "truth.npz")
    return joints_from_poses(poses(truth.xyz_world, t_ns=truth.t_ns, skeleton=truth.skeleton, ids=truth.person_id))


@pytest.mark.parametrize(("name", "joint", "angle", "sign"), [(name, *meaning) for name, meaning in OPENSIM.items()])
def test_an_alias_is_the_angle_with_its_sign(angles: JointAngles, name: str, joint: str, angle: str, sign: int) -> None:
    np.testing.assert_array_equal(angles[name].rad, sign * angles[joint, angle].rad)
    np.testing.assert_array_equal(angles[name].sigma_rad, angles[joint, angle].sigma_rad)
    assert angles[name].name == name


def test_an_unknown_name_lists_those_that_exist(angles: JointAngles) -> None:
    refusal(InputError, r"no angle 'pelvis_lean' of OpenSim; there are: .*ankle_angle_l", lambda: angles["pelvis_lean"])


def test_all_angles_are_in_degrees_by_one_word(angles: JointAngles) -> None:
    j = angles.joints.index("left_knee")
    a = angles.angle_names[j].index("flexion")
    np.testing.assert_array_equal(angles.deg[:, 0, j, a], angles["left_knee", "flexion"].deg)
    np.testing.assert_array_equal(angles.sigma_deg[:, 0, j, a], angles["left_knee", "flexion"].sigma_deg)
