"""What moves an angle, in closed form, against finite differences of the angles themselves."""

import numpy as np
import pytest
from figure import BENT, sequence_of

from posefuse.core import SKELETONS
from posefuse.kinematics import JOINT_NAMES, JointSettings
from posefuse.kinematics.definitions import POINTS, landmark_pairs
from posefuse.kinematics.joints import FrameBuffers

SKELETON = SKELETONS["blazepose33"]
STEP_M = 1e-6


@pytest.fixture(scope="module")
def keypoints():
    """A person askew, every limb bent, every coordinate different."""
    bent = sequence_of([BENT]).xyz_world[0, 0]
    return bent + np.random.default_rng(11).normal(size=bent.shape) * 0.02


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
