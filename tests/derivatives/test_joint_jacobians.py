"""What moves an angle, in closed form, against finite differences of the angles themselves."""

import numpy as np
import pytest

from posefuse.core import SKELETONS
from posefuse.kinematics import JOINT_NAMES, JointSettings
from posefuse.kinematics.definitions import POINTS, landmark_pairs
from posefuse.kinematics.joints import FrameBuffers

SKELETON = SKELETONS["blazepose33"]
STEP_M = 1e-6


@pytest.fixture(scope="module")
def keypoints():
    """A person crouching askew, every limb bent, every coordinate different."""
    rng = np.random.default_rng(11)
    xyz = rng.normal(size=(len(SKELETON), 3)) * 0.02
    place = {
        "left_hip": (0, 0.13, 0.9), "right_hip": (0.03, -0.12, 0.92), "left_shoulder": (0.1, 0.2, 1.4),
        "right_shoulder": (0.2, -0.17, 1.42), "left_elbow": (0.2, 0.35, 1.2), "right_elbow": (0.3, -0.33, 1.25),
        "left_wrist": (0.4, 0.3, 1.3), "right_wrist": (0.5, -0.3, 1.4), "left_index": (0.47, 0.29, 1.34),
        "left_pinky": (0.46, 0.33, 1.28), "right_index": (0.56, -0.3, 1.47), "right_pinky": (0.58, -0.34, 1.4),
        "left_knee": (0.3, 0.2, 0.6), "right_knee": (0.35, -0.1, 0.65), "left_ankle": (0.1, 0.2, 0.25),
        "right_ankle": (0.1, -0.15, 0.3), "left_heel": (0.03, 0.2, 0.22), "right_heel": (0.04, -0.16, 0.25),
        "left_foot_index": (0.26, 0.25, 0.2), "right_foot_index": (0.24, -0.2, 0.22), "nose": (0.3, 0.05, 1.6),
        "left_ear": (0.2, 0.1, 1.63), "right_ear": (0.22, -0.05, 1.65),
    }  # fmt: skip
    for name, point in place.items():
        xyz[SKELETON.index(name)] += point
    return xyz


def solved(xyz):
    """Angles (J, 3) and weights (J, P, 3, 3), limbs turned by their own planes of this time step."""
    work = FrameBuffers(SKELETON, JointSettings(hinge_play_rad=0.0))
    # points this exact leave the plane guessed from the parent no say
    work.read(xyz, np.broadcast_to(np.eye(3) * 1e-16, (len(xyz), 3, 3)))
    memory = np.full((4, 13), np.nan)
    work.step_planes(memory, 1.0)
    work.solve(work.updated)
    return work.angles.copy(), work.weights.copy()


@pytest.mark.parametrize("point", POINTS)
def test_weights_are_the_derivatives_of_the_angles(keypoints, point):
    _, weights = solved(keypoints)
    index = POINTS.index(point)
    keypoint = landmark_pairs(SKELETON)[index, 0]
    for axis in range(3):
        ahead, back = keypoints.copy(), keypoints.copy()
        ahead[keypoint, axis] += STEP_M
        back[keypoint, axis] -= STEP_M
        numeric = (solved(ahead)[0] - solved(back)[0]) / (2 * STEP_M)
        defined = np.isfinite(numeric)
        assert defined.sum() >= 40
        for q, a in np.argwhere(defined):
            assert weights[q, index, a, axis] == pytest.approx(numeric[q, a], rel=1e-4, abs=1e-5), (JOINT_NAMES[q], a, axis)
