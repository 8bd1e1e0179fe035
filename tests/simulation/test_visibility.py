"""Geometry of what hides what."""

import numpy as np
import pytest
from built import standing, straight

from posefuse.core import SE3
from posefuse.core.skeleton import ANATOMICAL23
from posefuse_sim.surroundings import FLESH_M, Box, BoxOccluder, ClutterOccluder, WallOccluder, boxes_of, hidden_by_shapes

_EYE = np.array([4.0, -0.3, 1.6])


def test_a_box_hides_as_many_small_steps_along_the_line_say():
    rng = np.random.default_rng(5)
    box = Box(np.array([0.5, 0.2, 0.8]), SE3.from_rotvec([0.2, -0.4, 1.1], [1.0, 0.2, 1.1]), (0.5, 0.5, 0.5))
    points = rng.uniform([-2, -2, 0], [3, 2, 3], (400, 3))
    steps = np.linspace(0, 1, 4001)[:, None, None]
    met = box.contains(_EYE + steps * (points - _EYE)).any(axis=0)
    hidden = box.between(_EYE, points)
    assert 20 < met.sum() < 380
    # steps may miss a corner that is only grazed
    assert (met <= hidden).all() and (hidden & ~met).sum() <= 4


def test_a_box_behind_the_point_or_behind_the_eye_hides_nothing():
    box = boxes_of((BoxOccluder(kind="box", position_m=(1.0, 0.0, 1.0), size_m=(0.4, 0.4, 0.4)),), 0)[0]
    eye = np.array([3.0, 0.0, 1.0])
    points = np.array([[2.0, 0, 1], [1.5, 0, 1], [0.0, 0, 1], [0.0, 1, 1], [4.0, 0, 1]])
    np.testing.assert_array_equal(box.between(eye, points), [False, False, True, False, False])


def test_a_line_along_a_face_is_decided_without_noise():
    box = Box(np.ones(3), SE3.identity(), (0, 0, 0))
    with np.errstate(all="raise", divide="ignore", invalid="ignore"):
        assert not box.between(np.array([3.0, 2.0, 0.0]), np.array([[-3.0, 2.0, 0.0]]))[0]
        assert box.between(np.array([3.0, 0.5, 0.0]), np.array([[-3.0, 0.5, 0.0]]))[0]


def test_a_wall_stands_between_its_points():
    wall = boxes_of((WallOccluder(kind="wall", from_m=(-1.0, 1.0), to_m=(1.0, 3.0), height_m=1.5),), 0)[0]
    assert wall.contains(np.array([[0.0, 2.0, 0.1], [-0.99, 1.01, 1.49], [0.99, 2.99, 0.75]])).all()
    assert not wall.contains(np.array([[0.0, 2.0, 1.6], [0.3, 1.7, 0.5], [1.2, 3.2, 0.5]])).any()


def test_clutter_keeps_its_distance_and_its_seed():
    clutter = ClutterOccluder(kind="clutter", count=7, keep_clear_m=1.2)
    boxes = boxes_of((clutter,), 4)
    assert len(boxes) == 7
    around = np.linspace(0, 2 * np.pi, 60)
    ring = np.stack([1.15 * np.cos(around), 1.15 * np.sin(around), np.full(60, 0.1)], axis=-1)
    assert not any(box.contains(ring).any() for box in boxes)
    np.testing.assert_array_equal(boxes[3].half_m, boxes_of((clutter,), 4)[3].half_m)
    assert not np.array_equal(boxes[3].half_m, boxes_of((clutter,), 5)[3].half_m)


def test_clutter_that_does_not_fit_is_refused():
    from posefuse.core import ConfigError

    with pytest.raises(ConfigError, match=r"only 0 of 6 boxes fit.*make the area larger"):
        boxes_of((ClutterOccluder(kind="clutter", area_m=(1.0, 1.0), keep_clear_m=3.0),), 0)


def test_a_person_in_front_hides_and_no_person_hides_the_side_that_is_seen():
    people = np.stack([standing(x, skeleton=ANATOMICAL23) for x in (0.0, 1.5)])[None]
    flesh = np.tile(FLESH_M, 2)
    eye = np.array([5.0, 0.0, 1.4])
    hidden = hidden_by_shapes(eye, people.reshape(1, -1, 3), flesh, (), people).reshape(2, -1)
    heels = ANATOMICAL23.indices(["left_heel", "right_heel"])
    np.testing.assert_array_equal(np.flatnonzero(hidden[1]), heels)
    torso = ANATOMICAL23.indices(["left_shoulder", "right_hip", "left_knee"])
    assert hidden[0][torso].all()


def test_the_own_body_hides_the_far_side():
    people = straight(ANATOMICAL23, elbow=(0.0, 0.25, 1.12), wrist=(0.0, 0.28, 0.88))[None, None]
    from_left = hidden_by_shapes(np.array([0.0, 5.0, 1.3]), people[:, 0], FLESH_M, (), people)[0]
    hidden = {name for name, is_hidden in zip(ANATOMICAL23.keypoints, from_left, strict=True) if is_hidden}
    assert {"right_shoulder", "right_hip", "right_ear"} <= hidden
    # the arm hangs before the hip
    assert {name for name in hidden if name.startswith("left_")} == {"left_hip"}
