"""Joint centres next to landmarks: offsets move with the body, mirror with it, and never invent a point."""

from dataclasses import replace

import built
import numpy as np
import pytest
from built import noisy_views, poses, recording_from_views, straight
from scipy.spatial.transform import Rotation

from posefuse.core import JointCentres, Kind, Pose3D, PoseSequence
from posefuse.core.joint_centres import SEGMENT_ENDS
from posefuse.core.skeleton import BLAZEPOSE33, COCO17
from posefuse.detection import read_card
from posefuse.formats.joint_centres import read_joint_centres
from posefuse.tracking import LandmarksInParts, LearntLengths, ViewsAtJointCentres, at_joint_centres, to_joint_centres
from posefuse.tracking.body_directions import keypoint_of, lengths_at, segment_lengths
from posefuse.tracking.joint_centres import JOINTS, SIDES, joint_directions

T, N, K = 4, 2, len(BLAZEPOSE33)
SHIPPED = read_joint_centres(read_card("blazepose_full").joint_centres_file)
LEG = ("hip", "knee", "ankle", "heel", "foot_index")
EVERY = JointCentres(
    made_by="a test",
    offsets={
        joint: {name: 0.01 * (i + 1) for i, name in enumerate(known)}
        for joint, known in joint_directions(np.full((K, 3), np.nan), BLAZEPOSE33, "left").items()
    },
)


def people(seed: int = 3) -> PoseSequence:
    xyz = np.random.default_rng(seed).normal(size=(T, N, K, 3))
    return poses(xyz, skeleton=BLAZEPOSE33, cov=np.diag([1.0, 2.0, 3.0]) * 1e-4)


def standing() -> np.ndarray:
    """(K, 3) facing +x, left is +y, hands ahead, left knee bent backwards a little."""
    hand = {"wrist": (0.25, 0.2, 1.1), "index": (0.33, 0.17, 1.1), "pinky": (0.33, 0.24, 1.1)}
    return straight(BLAZEPOSE33, **hand, heel=(-0.05, 0.1, 0), foot_index=(0.2, 0.1, 0))


@pytest.mark.parametrize(("side", "y"), [("left", 1), ("right", -1)])
def test_directions_of_a_person_standing_are_what_their_names_say(side: str, y: int) -> None:
    ahead, up, out, nothing = [1, 0, 0], [0, 0, 1], [0, y, 0], [0, 0, 0]
    expected = {
        "shoulder": {"forward": ahead, "up": up, "outward": out, "raising": nothing},
        "hip": {"forward": ahead, "up": up, "outward": out, "sinking": nothing},
        "knee": {"forward": ahead, "outward": out, "bend": nothing},
        "ankle": {"forward": ahead, "outward": out, "foot": ahead},
        "elbow": {"bend": [1, 0, 1], "lowering": nothing},
        "wrist": {"palm": [0, -y, 0]},
        "ear": {"outward": out, "face": ahead, "crown": up},
        "nose": {"face": ahead, "crown": up},
    }
    known = joint_directions(standing(), BLAZEPOSE33, side)
    for joint, directions in expected.items():
        for name, direction in directions.items():
            np.testing.assert_allclose(known[joint][name], direction, atol=1e-12, err_msg=f"{joint} {name}")


def test_a_raised_arm_counts_as_far_as_it_points_outward() -> None:
    xyz, known = standing(), []
    for place in ([0, -0.5, 1.4], [0, -0.4, 1.2]):
        xyz[BLAZEPOSE33.index("right_elbow")] = place
        known.append(joint_directions(xyz, BLAZEPOSE33, "right"))
    np.testing.assert_allclose([one["shoulder"]["raising"] for one in known], [[0, -1, 0], [0, -np.sqrt(0.5), 0]], atol=1e-12)
    np.testing.assert_allclose(known[0]["elbow"]["lowering"], [0, 0, -1], atol=1e-12)


def test_moving_the_world_moves_the_result() -> None:
    before = people()
    turn, shift = Rotation.from_rotvec([0.3, -1.2, 0.7]).as_matrix(), np.array([2.0, -1.0, 0.5])
    moved = replace(before, xyz_world=before.xyz_world @ turn.T + shift)
    expected = to_joint_centres(before, EVERY).xyz_world @ turn.T + shift
    np.testing.assert_allclose(to_joint_centres(moved, EVERY).xyz_world, expected, atol=1e-12)


def test_a_mirror_image_gives_the_mirror_image() -> None:
    before, mirror = people(), BLAZEPOSE33.mirror
    after = to_joint_centres(replace(before, xyz_world=before.xyz_world[:, :, mirror] * [1, -1, 1]), EVERY).xyz_world
    np.testing.assert_allclose(after, to_joint_centres(before, EVERY).xyz_world[:, :, mirror] * [1, -1, 1], atol=1e-12)


def test_offsets_are_added_in_full_and_only_to_joints() -> None:
    before = replace(people(), xyz_world=np.tile(standing(), (T, N, 1, 1)))
    table = JointCentres(made_by="a test", offsets={"hip": {"up": -0.02, "outward": 0.005}, "wrist": {"forearm": -0.03}})
    move = to_joint_centres(before, table).xyz_world - before.xyz_world
    expected = np.zeros((K, 3))
    for side, y in (("left", 1.0), ("right", -1.0)):
        expected[BLAZEPOSE33.index(f"{side}_hip")] = [0, 0.005 * y, -0.02]
        expected[BLAZEPOSE33.index(f"{side}_wrist")] = [-0.03, 0, 0]
    there = np.isfinite(before.xyz_world)
    np.testing.assert_allclose(move[there], np.broadcast_to(expected, move.shape)[there], atol=1e-12)


def test_a_joint_without_its_directions_stays_and_a_missing_one_stays_missing() -> None:
    before = people()
    xyz = np.array(before.xyz_world)
    knee, hip = BLAZEPOSE33.index("left_knee"), BLAZEPOSE33.index("left_hip")
    xyz[1, 0, knee] = np.nan
    after = to_joint_centres(replace(before, xyz_world=xyz), EVERY)
    assert np.isnan(after.xyz_world[1, 0, knee]).all()
    np.testing.assert_array_equal(after.xyz_world[1, 0, hip], xyz[1, 0, hip])
    assert not np.allclose(after.xyz_world[2, 0, hip], xyz[2, 0, hip])
    np.testing.assert_array_equal(after.cov_world, before.cov_world)
    np.testing.assert_array_equal(after.kind, before.kind)


def test_the_shipped_table_moves_every_joint_by_centimetres_at_most() -> None:
    assert set(SHIPPED.offsets) == set(JOINTS)
    before = replace(people(), xyz_world=np.tile(standing(), (T, N, 1, 1)))
    columns = BLAZEPOSE33.indices([keypoint_of(side, joint) for side in SIDES for joint in JOINTS])
    moved = np.linalg.norm(to_joint_centres(before, SHIPPED).xyz_world - before.xyz_world, axis=-1)[..., columns]
    assert (moved > 0.0005).all() and (moved < 0.05).all()


def person_standing() -> PoseSequence:
    """LandmarksInParts of people standing, turned and moved a little from time step to time step."""
    turns = Rotation.from_euler("z", np.linspace(0, 1, T * N)[:, None]).as_matrix().reshape(T, N, 3, 3)
    return replace(people(), xyz_world=np.einsum("tnij,kj->tnki", turns, standing()) + [0.1, -0.2, 0.0])


LONG_LEGS = JointCentres(
    made_by="a test", offsets={"knee": {"thigh": 0.01}}, lengths={"thigh": 0.4}, by_length={"knee": {"thigh": {"thigh": 0.5}}}
)


@pytest.mark.parametrize(("thigh_m", "expected_m"), [(0.39, 0.01), (0.41, 0.02), (0.36, -0.005), (0.59, 0.04)])
def test_offsets_grow_with_the_length_of_a_segment(thigh_m: float, expected_m: float) -> None:
    """By half of what the thigh, from its joint centres, is longer than usual; no person is taken for longer than 60 mm more."""
    xyz = standing()
    for side in SIDES:
        hip, knee = (BLAZEPOSE33.index(f"{side}_{joint}") for joint in ("hip", "knee"))
        xyz[knee] = xyz[hip] - [0, 0, thigh_m]
    # nine time steps do not tell lengths
    for count, down_m in ((10, expected_m), (9, 0.01)):
        people = over_time(xyz, count)
        move = (to_joint_centres(people, LONG_LEGS).xyz_world - people.xyz_world)[:, 0, knee]
        np.testing.assert_allclose(move - [0, 0, -down_m], 0, atol=1e-12)


def test_one_pose_is_moved_as_a_recording_of_the_same_lengths() -> None:
    """Lengths that are not known count as usual."""
    many = over_time(np.stack([standing(), 1.1 * standing()]), 12)
    usual = at_joint_centres(many, SHIPPED, SHIPPED.usual)
    lengths = segment_lengths(usual.xyz_world, BLAZEPOSE33)
    one = at_joint_centres(many.at(3), SHIPPED, lengths)
    np.testing.assert_array_equal(one.xyz_world, to_joint_centres(many, SHIPPED).xyz_world[3])
    assert np.nanmax(np.abs(one.xyz_world - usual.xyz_world[3])) > 0.001
    unknown = at_joint_centres(many.at(3), SHIPPED, np.full(lengths.shape, np.nan))
    np.testing.assert_array_equal(unknown.xyz_world, usual.xyz_world[3])


def test_each_person_has_lengths_of_their_own() -> None:
    short, tall = standing(), 1.1 * standing()
    both = np.stack([short, tall])
    together = to_joint_centres(over_time(both, 12), LONG_LEGS).xyz_world
    for n, person in enumerate(both):
        np.testing.assert_allclose(together[:, n], to_joint_centres(over_time(person, 12), LONG_LEGS).xyz_world[:, 0], atol=1e-12)


def over_time(xyz: np.ndarray, count: int) -> PoseSequence:
    """The same people (N, K, 3) or person (K, 3) at many time steps."""
    return poses(np.broadcast_to(xyz.reshape(-1, K, 3), (count, xyz.size // (3 * K), K, 3)), skeleton=BLAZEPOSE33)


def test_there_and_back_is_where_it_was() -> None:
    before = person_standing()
    there = to_joint_centres(before, SHIPPED)
    assert np.nanmax(np.abs(there.xyz_world - before.xyz_world)) > 0.01
    landmarks = LandmarksInParts(there.xyz_world, BLAZEPOSE33, SHIPPED)
    np.testing.assert_allclose(landmarks.part(slice(None)), before.xyz_world, atol=1e-4)


def test_views_of_landmarks_become_views_of_joint_centres(ring_rig) -> None:
    """Also where left and right are swapped in one view, and at a time step without 3D."""
    landmarks, rig = person_standing(), ring_rig(3)
    centres = to_joint_centres(landmarks, SHIPPED)
    seen, expected = (noisy_views(rig, one, 0.0, 0).xy_img for one in (landmarks, centres))
    knee, legs = BLAZEPOSE33.index("left_knee"), [i for i, k in enumerate(BLAZEPOSE33.keypoints) if k.endswith(LEG)]
    mixed = seen.copy()
    mixed[1, 0, 2][legs] = seen[1, 0, 2][BLAZEPOSE33.mirror[legs]]
    known = np.array(centres.xyz_world)
    known[2, 1, knee] = np.nan
    score = np.isfinite(seen[..., 0]) * 1.0
    recording = recording_from_views(rig, replace(centres, xyz_world=known), mixed, score, np.where(score > 0, 2.0, np.nan))
    rays = ViewsAtJointCentres(recording.poses, recording.rig, recording.views, SHIPPED)
    moved = rays.part(slice(None))
    known_px = np.isfinite(seen[..., 0])
    known_px[2, 1] = False  # the thigh's directions are unknown there
    np.testing.assert_allclose(moved.xy_img[known_px], expected[known_px], atol=0.02)
    np.testing.assert_allclose(moved.xy_img[2, 1, :, knee], expected[2, 1, :, knee], atol=0.5)
    assert np.abs(seen[2, 1, :, knee] - expected[2, 1, :, knee]).max() > 1.0
    # the missing one is bridged from both sides, wherever a part begins or ends
    for steps in (slice(0, 2), slice(2, 3), slice(2, None), slice(3, 99)):
        np.testing.assert_array_equal(rays.part(steps).xy_img, moved.xy_img[steps])


# --- segment lengths learnt live: they end where a recording finds them, nothing jumps, who left is forgotten


_HALF = np.random.default_rng(2).normal(size=(17, 3)) * 0.2
BODY = _HALF + _HALF[COCO17.mirror] * [1, -1, 1]
USUAL = lengths_at(BODY, COCO17).mean(axis=0)
TABLE = JointCentres(made_by="a test", offsets={"knee": {"thigh": 0.01}}, lengths=dict(zip(SEGMENT_ENDS, USUAL, strict=True)))
PERIOD_NS = 10_000_000


def pose(i: int, *people: np.ndarray, kind: Kind = Kind.FUSED, sigma_m: float = 0.01) -> Pose3D:
    """Number i of a hundred a second; people with ids from 0."""
    xyz = np.array(people).reshape(-1, 17, 3)
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
    recorded = built.poses(np.broadcast_to(people, (10, 2, 17, 3)))
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
    assert learnt.step(pose(100)).shape == (0, len(SEGMENT_ENDS))
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
