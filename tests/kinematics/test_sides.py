"""Where the body faces, by clues that do not depend on which side is called left."""

from dataclasses import replace

import numpy as np

from posefuse.core import SE3
from posefuse.kinematics import facing_votes

BENT = {"left_knee": (40.0, 0.0, 0.0), "right_knee": (25.0, 0.0, 0.0), "left_elbow": (70.0, 0.0, 0.0)}


def test_clues_turn_with_the_limbs_whose_sides_are_exchanged_and_not_with_the_world(posed) -> None:
    sequence = posed([BENT] * 3)
    votes = facing_votes(sequence)
    assert votes.shape == (2, 3, 1)
    assert (votes >= 4).all()
    for part, (left, right) in enumerate(sequence.skeleton.limbs):
        order = np.arange(len(sequence.skeleton))
        order[left], order[right] = right, left
        exchanged = facing_votes(replace(sequence, xyz_world=sequence.xyz_world[:, :, order]))
        assert (exchanged[part] <= -4).all()
        assert (exchanged[1 - part] >= 4).all()
    new_from_old = SE3.from_rotvec([0.4, -1.0, 0.3], [3.0, -2.0, 1.0])
    assert np.array_equal(facing_votes(replace(sequence, xyz_world=new_from_old @ sequence.xyz_world)), votes)


def test_without_face_feet_and_knees_there_is_no_clue(posed) -> None:
    sequence = posed([BENT])
    xyz = np.array(sequence.xyz_world)
    xyz[:, :, [k for k, name in enumerate(sequence.skeleton.keypoints) if name.endswith(("nose", "heel", "index", "knee"))]] = (
        np.nan
    )
    assert not facing_votes(replace(sequence, xyz_world=xyz)).any()
