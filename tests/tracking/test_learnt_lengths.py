"""Segment lengths learnt live: they end where a recording finds them, nothing jumps, who left is forgotten."""

from dataclasses import replace

import built
import numpy as np
import pytest

from posefuse.core import JointCentres, Kind, Pose3D
from posefuse.core.joint_centres import SEGMENT_ENDS
from posefuse.core.skeleton import COCO17
from posefuse.tracking import LearntLengths, to_joint_centres
from posefuse.tracking.body_directions import lengths_at, segment_lengths

K, S = len(COCO17), len(SEGMENT_ENDS)
_HALF = np.random.default_rng(2).normal(size=(K, 3)) * 0.2
BODY = _HALF + _HALF[COCO17.mirror] * [1, -1, 1]
USUAL = lengths_at(BODY, COCO17).mean(axis=0)
TABLE = JointCentres(made_by="a test", offsets={"knee": {"thigh": 0.01}}, lengths=dict(zip(SEGMENT_ENDS, USUAL, strict=True)))
PERIOD_NS = 10_000_000


def pose(i: int, *people: np.ndarray, kind: Kind = Kind.FUSED, sigma_m: float = 0.01) -> Pose3D:
    """Number i of a hundred a second; people with ids from 0."""
    xyz = np.array(people).reshape(-1, K, 3)
    return built.pose(xyz, t_ns=i * PERIOD_NS, cov=np.eye(3) * sigma_m**2, kind=np.full(xyz.shape[:2], kind))


def learnt_from(count: int, *bodies: np.ndarray, noise_m: float = 0.0, **how: object) -> np.ndarray:
    """(count, N, S) after each of so many poses."""
    rng, learnt = np.random.default_rng(4), LearntLengths(TABLE)
    shaken = [[body + noise_m * rng.normal(size=body.shape) for body in bodies] for _ in range(count)]
    return np.array([learnt.step(pose(i, *people, **how)) for i, people in enumerate(shaken)])


def test_they_go_from_usual_to_what_a_recording_finds_and_nothing_jumps() -> None:
    people = np.array([0.93 * BODY, 1.07 * BODY])
    lengths = learnt_from(3000, *people, noise_m=0.005)
    np.testing.assert_allclose(lengths[0], [USUAL, USUAL], atol=1e-12)
    recorded = built.poses(np.broadcast_to(people, (10, 2, K, 3)))
    found = segment_lengths(to_joint_centres(recorded, TABLE).xyz_world, COCO17)
    apart, away = np.abs(found - USUAL), np.abs(lengths - found)
    assert apart.min() > 0.01
    assert (away[-1] < 0.02 * apart + 0.001).all()
    assert away[100].mean() < 0.35 * away[0].mean()
    assert np.abs(np.diff(lengths, axis=0)).max() < 0.2 * apart.max()


@pytest.mark.parametrize("how", [{"kind": Kind.PREDICTED}, {"sigma_m": 0.1}])
def test_what_no_person_measured_well_teaches_nothing(how: dict) -> None:
    np.testing.assert_array_equal(learnt_from(200, 1.05 * BODY, **how)[-1, 0], USUAL)


def test_a_segment_seen_on_one_side_alone_is_learnt_from_it_and_the_others_stay() -> None:
    half = 1.05 * BODY
    half[COCO17.index("right_wrist")] = np.nan
    half[COCO17.indices(["left_ankle", "right_ankle"])] = np.nan
    lengths, names = learnt_from(1000, half)[-1, 0], list(SEGMENT_ENDS)
    forearm, shank = names.index("forearm"), names.index("shank")
    left = lengths_at(half, COCO17)[0, forearm]
    assert abs(lengths[forearm] - left) < 0.2 * abs(USUAL[forearm] - left)
    assert lengths[shank] == USUAL[shank]


def test_a_person_who_leaves_is_forgotten_and_a_clock_that_is_set_back_starts_again() -> None:
    learnt = LearntLengths(TABLE)
    for i in range(100):
        lengths = learnt.step(pose(i, 1.05 * BODY))
    assert np.abs(lengths - USUAL).max() > 0.01
    assert learnt.step(pose(100)).shape == (0, S)
    np.testing.assert_array_equal(learnt.step(pose(101, 1.05 * BODY))[0], USUAL)
    for i in range(102, 200):
        learnt.step(pose(i, 1.05 * BODY))
    np.testing.assert_array_equal(learnt.step(pose(50, 1.05 * BODY))[0], USUAL)


def test_people_learn_apart_whatever_their_order() -> None:
    learnt = LearntLengths(TABLE)
    for i in range(200):
        both = pose(i, BODY, 1.05 * BODY)
        if i % 2:
            turned = {name: getattr(both, name)[::-1] for name in ("person_id", "xyz_world", "cov_world")}
            both = replace(both, **turned)
        lengths = learnt.step(both)
    np.testing.assert_array_equal(lengths[::-1], learnt_from(200, BODY, 1.05 * BODY)[-1])


def test_a_table_without_lengths_leaves_them_unknown() -> None:
    learnt = LearntLengths(replace(TABLE, lengths={}))
    for i in range(20):
        lengths = learnt.step(pose(i, BODY))
    assert np.isnan(lengths).all()
