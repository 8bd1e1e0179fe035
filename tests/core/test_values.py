"""Values are checked once at birth and cannot be written afterwards."""

import copy
import pickle
from collections.abc import Iterator
from dataclasses import is_dataclass, replace
from operator import attrgetter
from typing import Any

import built
import numpy as np
import pytest
from built import recording_from_views
from checks import refusal

from posefuse.core import Pose3D, PoseSequence, Region, ShapeError, Views
from posefuse.core.skeleton import BODY_25, COCO17, PAPER14, SKELETONS, Skeleton, mirror_name, pick_keypoints

N, C, K = 2, 3, len(COCO17)
OTHER = Skeleton("other", COCO17.keypoints, COCO17.bones)


def pose(t_ns: int = 5, people: int = N) -> Pose3D:
    return built.pose(np.ones((people, K, 3)), t_ns=t_ns, cov=np.ones((3, 3)))


def views() -> Views:
    arrays = {"xy_img": np.zeros((N, C, K, 2)), "score": np.zeros((N, C, K)), "sigma_px": np.ones((N, C, K))}
    return Views(t_ns=7, skeleton=COCO17, camera_names=("a", "b", "c"), person_id=np.arange(N), **arrays)


def test_arrays_are_copied_and_read_only() -> None:
    xyz = np.ones((N, K, 3))
    made = replace(pose(), xyz_world=xyz)
    xyz[:] = 7
    assert (made.xyz_world == 1).all()
    with pytest.raises(ValueError, match="read-only"):
        made.xyz_world[0, 0, 0] = 2


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: replace(pose(), xyz_world=np.ones((N, K, 2))), "axis 3 of size 3"),
        (lambda: replace(pose(), n_views=np.ones((N + 1, K))), "axis N of size 2"),
        (lambda: replace(pose(), skeleton=BODY_25), "body_25 has 25 keypoints"),
        (lambda: replace(views(), camera_names=("a", "b")), "2 camera names"),
        (lambda: replace(views(), score=np.ones((N, C))), "expected axes"),
        (lambda: replace(views(), score="high"), "expected an array"),
        (lambda: built.frame(image=np.zeros((4, 5), np.uint8)), "RGB uint8"),
        (lambda: built.frame(image=np.zeros((4, 5, 3), np.float32)), "RGB uint8"),
        (lambda: Region(centre_img=np.array([1.0, np.nan]), side_px=5.0), "finite"),
        (lambda: Region(centre_img=np.array([1.0, 2.0]), side_px=0.0), "side > 0"),
        (lambda: PoseSequence.from_poses([]), "at least 1"),
        (lambda: PoseSequence.from_poses([pose(5), pose(5)]), "strictly increasing"),
        (lambda: PoseSequence.from_poses([pose(5), replace(pose(6), skeleton=OTHER)]), "same skeleton"),
    ],
)
def test_what_does_not_fit_is_refused(make, message: str) -> None:
    refusal(ShapeError, message, make)


def test_a_sequence_is_its_poses() -> None:
    sequence = PoseSequence.from_poses([pose(5), pose(9)])
    assert len(sequence) == 2
    assert sequence.xyz_world.shape == (2, N, K, 3)
    assert np.array_equal(sequence.at(1).xyz_world, pose(9).xyz_world)
    assert sequence.at(1).t_ns == 9


def test_a_recording_fits_its_rig(ring_rig) -> None:
    poses = PoseSequence.from_poses([pose(5), pose(9)])
    two_d = {"xy_img": np.zeros((2, N, C, K, 2)), "score": np.zeros((2, N, C, K)), "sigma_px": np.zeros((2, N, C, K))}
    made = recording_from_views(ring_rig(3), poses, **two_d)
    assert made.provenance == {}
    one = PoseSequence.from_poses([pose(5)])
    refusal(ShapeError, "cameras cam00, cam01, cam02, cam03, the observations cam00", replace, made, rig=ring_rig(4))
    refusal(ShapeError, r"time steps to be the poses' 1, or none \(live\), got 2", replace, made, poses=one)


def arrays_in(value: Any, name: str = "value") -> Iterator[tuple[str, np.ndarray]]:
    """All arrays that a value has and keeps, by their place in it."""
    if isinstance(value, np.ndarray):
        yield name, value
    elif isinstance(value, tuple):
        for i, one in enumerate(value):
            yield from arrays_in(one, f"{name}[{i}]")
    elif is_dataclass(value):
        for field, one in vars(value).items():
            yield from arrays_in(one, f"{name}.{field}")


@pytest.mark.parametrize("copied", [lambda value: value, copy.deepcopy, lambda value: pickle.loads(pickle.dumps(value, 4))])
def test_nothing_of_a_recording_can_be_written_nor_of_a_copy(ring_rig, copied) -> None:
    """A camera moved within a copied rig projected from its new place, and its kept centre was the old one."""
    made = built.recording(ring_rig(3), PoseSequence.from_poses([pose(5), pose(9)]))
    for derived in ("views", "observations.detection_frame", "poses.skeleton.mirror", "poses.skeleton.bone_indices"):
        attrgetter(derived)(made)
    assert [camera.centre_world for camera in made.rig] and made.poses.skeleton.limbs
    found = dict(arrays_in(copied(made)))
    assert len(found) > 40
    assert not [name for name, array in found.items() if array.flags.writeable]


@pytest.mark.parametrize("skeleton", SKELETONS.values(), ids=lambda s: s.name)
def test_mirroring_twice_is_nothing_and_swaps_sides(skeleton: Skeleton) -> None:
    assert np.array_equal(skeleton.mirror[skeleton.mirror], np.arange(len(skeleton)))
    for i, keypoint in enumerate(skeleton.keypoints):
        assert skeleton.keypoints[skeleton.mirror[i]] == mirror_name(keypoint)


@pytest.mark.parametrize("name", ["coco_wholebody_133", "halpe_136"])
def test_a_hand_changes_sides_with_its_arm(name):
    skeleton = SKELETONS[name]
    arms, legs = skeleton.limbs
    hand = [k for k in skeleton.keypoints if k.startswith("left_") and k[-1].isdigit() and k[5:-1] in ("thumb", "middle", "ring")]
    assert len(hand) == 12
    assert {skeleton.keypoints[i] for i in arms[0]} >= {"left_shoulder", "left_wrist", "left_hand_root", *hand}
    assert [skeleton.keypoints[i] for i in arms[1]] == [mirror_name(skeleton.keypoints[i]) for i in arms[0]]
    assert not any(skeleton.keypoints[i].startswith(("left_jaw", "left_brow")) for limb in (*arms, *legs) for i in limb)


# markers of SynthPose in the order of its model card, and what they are called here
SYNTHPOSE = {
    "sternum": "sternum", "rshoulder": "right_shoulder_marker", "lshoulder": "left_shoulder_marker",
    "r_lelbow": "right_elbow_lateral", "l_lelbow": "left_elbow_lateral", "r_melbow": "right_elbow_medial",
    "l_melbow": "left_elbow_medial", "r_lwrist": "right_wrist_lateral", "l_lwrist": "left_wrist_lateral",
    "r_mwrist": "right_wrist_medial", "l_mwrist": "left_wrist_medial", "r_ASIS": "right_asis", "l_ASIS": "left_asis",
    "r_PSIS": "right_psis", "l_PSIS": "left_psis", "r_knee": "right_knee_lateral", "l_knee": "left_knee_lateral",
    "r_mknee": "right_knee_medial", "l_mknee": "left_knee_medial", "r_ankle": "right_ankle_lateral",
    "l_ankle": "left_ankle_lateral", "r_mankle": "right_ankle_medial", "l_mankle": "left_ankle_medial",
    "r_5meta": "right_fifth_metatarsal", "l_5meta": "left_fifth_metatarsal", "r_toe": "right_toe_marker",
    "l_toe": "left_toe_marker", "r_big_toe": "right_big_toe", "l_big_toe": "left_big_toe", "l_calc": "left_heel",
    "r_calc": "right_heel", "C7": "c7", "L2": "l2", "T11": "t11", "T6": "t6",
}  # fmt: skip


def test_the_markers_of_synthpose_are_in_the_order_of_its_model_card() -> None:
    assert SKELETONS["synthpose_52"].keypoints == (*COCO17.keypoints, *SYNTHPOSE.values())


def test_keypoints_are_picked_by_name_synonym_or_midpoint() -> None:
    xyz = np.random.default_rng(0).normal(size=(4, K, 3))
    picked = pick_keypoints(xyz, COCO17, ["left_knee", "neck", "left_heel"])
    assert np.array_equal(picked[:, 0], xyz[:, COCO17.index("left_knee")])
    assert np.allclose(picked[:, 1], (xyz[:, 5] + xyz[:, 6]) / 2)
    assert np.isnan(picked[:, 2]).all()
    toe = pick_keypoints(np.arange(33 * 3.0).reshape(33, 3), SKELETONS["blazepose33"], ["left_big_toe"])
    assert np.array_equal(toe[0], [93, 94, 95])
    assert set(PAPER14.keypoints) <= {*BODY_25.keypoints}


def test_people_are_picked_by_mask_or_by_place() -> None:
    three = replace(pose(people=3), xyz_world=np.arange(3)[:, None, None] * np.ones((3, K, 3)))
    assert three.people(np.array([True, False, True])).person_id.tolist() == [0, 2]
    turned = three.people(np.array([2, 0]))
    assert turned.person_id.tolist() == [2, 0]
    assert turned.xyz_world[:, 0, 0].tolist() == [2.0, 0.0]
    assert three.people(np.zeros(3, bool)).person_id.shape == (0,)
    no_person = Pose3D.empty(9, COCO17)
    assert (no_person.t_ns, no_person.person_id.shape, no_person.cov_world.shape) == (9, (0,), (0, K, 3, 3))


def test_skeletons_are_the_same_one_after_a_journey_between_processes() -> None:
    for known in SKELETONS.values():
        assert pickle.loads(pickle.dumps(known)) is known
        assert len(pickle.dumps(known)) < 100
    own = Skeleton("own", ("a", "b"), (("a", "b"),))
    one, other = (pickle.loads(pickle.dumps(own)) for _ in range(2))
    assert one is other and one == own and hash(one) == hash(own)
    # of a known name, but another
    same_name = Skeleton(COCO17.name, COCO17.keypoints[:5])
    assert pickle.loads(pickle.dumps(same_name)) == same_name != COCO17


def test_the_message_of_an_error_is_one_line_whatever_a_damaged_file_is_called() -> None:
    error = ShapeError(f"camera {'x' * 10_000}\n\x1b[31m\x00 Käthe: expected a name")
    assert str(error).isprintable() and len(str(error)) < 2100
    assert str(error).startswith("camera xxx") and str(error).endswith(r"x \x1b[31m\x00 Käthe: expected a name")
    assert str(pickle.loads(pickle.dumps(error))) == str(error)
