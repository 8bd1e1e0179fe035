"""SE3 against the group axioms and an independent library."""

import numpy as np
import pytest
from checks import refusal
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from posefuse.core import SE3, ShapeError

numbers = st.floats(-3, 3, allow_nan=False)
vectors = arrays(np.float64, 3, elements=numbers)
transforms = st.builds(SE3.from_rotvec, vectors, vectors)


def same(a: SE3, b: SE3) -> bool:
    return np.allclose(a.matrix4(), b.matrix4(), atol=1e-9)


@given(transforms, transforms, transforms)
def test_group_axioms(a: SE3, b: SE3, c: SE3) -> None:
    assert same((a @ b) @ c, a @ (b @ c))
    assert same(a @ SE3.identity(), a)
    assert same(SE3.identity() @ a, a)
    assert same(a @ a.inverse(), SE3.identity())


@given(transforms, transforms, vectors)
def test_composing_is_moving_twice(a: SE3, b: SE3, point: np.ndarray) -> None:
    assert np.allclose((a @ b) @ point, a @ (b @ point), atol=1e-9)
    assert np.allclose((a.matrix4() @ np.append(point, 1))[:3], a @ point, atol=1e-9)


@given(vectors)
def test_rotations_agree_with_scipy(rotvec: np.ndarray) -> None:
    ours, theirs = SE3.from_rotvec(rotvec, np.zeros(3)), Rotation.from_rotvec(rotvec)
    assert np.allclose(ours.matrix(), theirs.as_matrix(), atol=1e-12)
    assert np.allclose(SE3.from_matrix(theirs.as_matrix(), np.zeros(3)).matrix(), theirs.as_matrix(), atol=1e-9)
    assert np.allclose(Rotation.from_rotvec(ours.rotvec()).as_matrix(), theirs.as_matrix(), atol=1e-9)


@pytest.mark.parametrize("axis", range(3))
def test_half_turns_survive_the_matrix(axis: int) -> None:
    rotvec = np.pi * np.eye(3)[axis]
    back = SE3.from_matrix(Rotation.from_rotvec(rotvec).as_matrix(), np.zeros(3))
    assert np.allclose(np.abs(back.rotvec()), np.abs(rotvec))


def test_batches_and_picking() -> None:
    rng = np.random.default_rng(0)
    many = SE3.from_rotvec(rng.normal(size=(5, 2, 3)), rng.normal(size=(5, 2, 3)))
    points = rng.normal(size=(5, 2, 3))
    moved = many @ points
    assert moved.shape == (5, 2, 3)
    assert np.allclose(moved[3, 1], many[3, 1] @ points[3, 1])
    assert many[3].batch == (2,)
    assert np.allclose((many[3, 1] @ rng.normal(size=(7, 4, 3))).shape, (7, 4, 3))
    assert same(many.inverse()[4, 0], many[4, 0].inverse())


def test_missing_poses_are_nan_and_stay_nan() -> None:
    missing = SE3(np.full((2, 4), np.nan), np.full((2, 3), np.nan))
    assert np.isnan((missing @ SE3.identity((2,))).xyz).all()


def test_guards() -> None:
    refusal(ShapeError, "length 0", SE3, np.zeros(4), np.zeros(3))
    refusal(ShapeError, "too large", SE3, np.array([1e200, 0, 0, 0]), np.zeros(3))
    refusal(ShapeError, "infinity", SE3, np.array([1.0, 0, 0, 0]), np.array([np.inf, 0, 0]))
    refusal(ShapeError, "expected wxyz", SE3, np.ones((2, 4)), np.ones((3, 3)))
    refusal(ShapeError, "points", lambda: SE3.identity() @ np.zeros(4))
    refusal(ShapeError, "no axis", lambda: SE3.identity()[0])
    with pytest.raises(ValueError, match="read-only"):
        SE3.identity().xyz[0] = 1.0


def test_a_quaternion_and_its_negative_have_one_rotation_vector_of_half_a_turn_at_most() -> None:
    one = SE3.from_rotvec(np.array([0.3, -1.1, 2.0]), np.zeros(3))
    other = SE3(-one.wxyz, one.xyz)
    np.testing.assert_allclose(other.rotvec(), one.rotvec(), atol=1e-12)
    assert np.linalg.norm(other.rotvec()) < np.pi
