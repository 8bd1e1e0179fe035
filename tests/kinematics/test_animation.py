"""BVH and glTF of a recording: the same motion when read back, constant offsets, gaps named."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from built import unseen
from checks import refusal
from figure import BENT, sequence_of, walking
from glb import read_glb
from motions import read_bvh, world_of
from scipy.spatial.transform import Rotation

from posefuse.core import InputError
from posefuse.formats.bvh import write_bvh
from posefuse.formats.gltf import write_gltf
from posefuse.kinematics import joints_from_poses
from posefuse.kinematics.animation import FILE_FROM_WORLD, animation_from_joints
from posefuse.kinematics.definitions import NOSE_BELOW_RAD
from posefuse.kinematics.side_clues import landmarks
from posefuse.kinematics.skin import length_names, skin_of, template


@pytest.fixture
def sequence():
    return sequence_of([walking(i / 30) for i in range(40)], rate_hz=30.0)


def animated(sequence):
    return animation_from_joints(sequence, joints_from_poses(sequence))


def test_a_bvh_read_back_is_the_same_motion(sequence, tmp_path):
    write_bvh(tmp_path / "a.bvh", animated(sequence), metres_per_unit=0.01)
    back = read_bvh(tmp_path / "a.bvh")
    assert back.frame_s == pytest.approx(1 / 30, abs=1e-7)
    _, position = world_of(back)
    points = landmarks(sequence.xyz_world[:, 0], sequence.skeleton)
    expected = {
        "left_forearm": "left_elbow", "right_hand": "right_wrist", "left_foot": "left_ankle", "right_shank": "right_knee",
        "left_foot_end": "left_toe", "head_end": "nose", "left_upper_arm": "left_shoulder",
    }  # fmt: skip
    for joint, point in expected.items():
        world_m = position[:, back.names.index(joint)] @ FILE_FROM_WORLD * 0.01
        np.testing.assert_allclose(world_m, points[point], atol=2e-5, err_msg=joint)


def test_the_rest_pose_stands_upright_and_faces_z(sequence):
    animation = animated(sequence)
    rest = dict(zip(animation.names, animation.rest_positions(), strict=True))
    assert rest["head"][1] > 0.5 > 0 > rest["left_foot"][1]
    assert rest["left_thigh"][0] > 0 > rest["right_thigh"][0]
    assert rest["left_foot_end"][2] > rest["left_foot"][2] + 0.1
    lengths = [np.ptp(np.linalg.norm(animation.position[j], axis=-1)) for j in range(1, len(animation.names))]
    assert max(lengths) == 0


def test_hierarchy_follows_blenders_rules(sequence, tmp_path):
    """By a reader of its own: one root, OFFSET then CHANNELS, leaves are End Sites, rows as wide as all channels."""
    write_bvh(tmp_path / "a.bvh", animated(sequence))
    lines = [line.strip() for line in (tmp_path / "a.bvh").read_text().splitlines()]
    channels, depth, ends = 0, 0, 0
    for before, line in pairwise(lines):
        depth += (line == "{") - (line == "}")
        if line == "{":
            assert before.split()[0] in ("ROOT", "JOINT") or before == "End Site"
        if line.startswith("CHANNELS"):
            assert before.startswith("OFFSET")
            words = line.split()
            assert int(words[1]) == len(words) - 2
            assert words[-3:] == ["Zrotation", "Xrotation", "Yrotation"]
            channels += int(words[1])
        ends += line == "End Site"
    assert depth == 0 and ends == 5 and sum(line.startswith("ROOT") for line in lines) == 1
    motion = lines.index("MOTION")
    assert lines[motion + 1] == "Frames: 40"
    assert all(len(line.split()) == channels for line in lines[motion + 3 :])


def test_a_short_gap_is_bridged_and_a_long_one_named(sequence):
    short, long = (unseen(sequence, "left_wrist", steps=slice(10, end)) for end in (14, 30))
    assert all(np.isfinite(one).all() for one in animated(short).rotation)
    refusal(InputError, r"segment left_forearm is missing from 0.30 to 1.00 s.*whole-body fit", animated, long)


def test_a_person_who_comes_and_goes_is_held_before_and_after(sequence):
    """As in nearly every real recording, which begins and ends with an empty space."""
    xyz = sequence.xyz_world.copy()
    xyz[:8], xyz[-5:] = np.nan, np.nan
    # 10 Hz: 0.8 s and 0.5 s
    seen = replace(sequence, xyz_world=xyz, t_ns=np.arange(40) * 100_000_000)
    held, whole = animated(seen), animated(replace(sequence, t_ns=seen.t_ns))
    assert len(held) == 40
    rotation, position = np.stack(held.rotation, axis=1), np.stack(held.position, axis=1)
    np.testing.assert_allclose(rotation[8:35], np.stack(whole.rotation, axis=1)[8:35], atol=0.01)
    for before_or_after, edge in ((slice(0, 8), 8), (slice(35, 40), 34)):
        np.testing.assert_allclose(rotation[before_or_after] - rotation[edge], 0, atol=1e-9)
        np.testing.assert_allclose(position[before_or_after] - position[edge], 0, atol=1e-9)
    # a segment that is missing while the person is there is no such thing
    missing = unseen(seen, "left_wrist", steps=slice(8, 20))
    refusal(InputError, "left_forearm is missing from 0.80 to 2.00 s", animated, missing)


def test_skeletons_without_hands_and_heads_end_earlier():
    names = animated(sequence_of([walking(i / 30) for i in range(5)], "paper14", rate_hz=30.0)).names
    assert "head" not in names and "left_hand" not in names
    assert {"left_forearm_end", "right_shank_end"} <= set(names)


def test_gltf_holds_the_same_motion(sequence, tmp_path):
    animation = animated(sequence)
    write_gltf(tmp_path / "a.glb", animation, skin_of(animation))
    content, read = read_glb(tmp_path / "a.glb")
    samplers = content["animations"][0]["samplers"]
    for channel in content["animations"][0]["channels"]:
        node, sampler = channel["target"]["node"], samplers[channel["sampler"]]
        assert read(sampler["input"])[-1, 0] == pytest.approx(39 / 30, abs=1e-5)
        values = read(sampler["output"])
        if channel["target"]["path"] == "rotation":
            np.testing.assert_allclose(Rotation.from_quat(values).as_matrix(), animation.rotation[node], atol=1e-6)
            assert (np.abs(np.diff(values, axis=0)) < 0.5).all()
        else:
            np.testing.assert_allclose(values, animation.position[node], atol=1e-6)
    children = [c for node in content["nodes"] for c in node.get("children", [])]
    assert sorted(children + content["scenes"][0]["nodes"]) == list(range(len(content["nodes"])))


def test_what_the_files_cannot_hold_is_refused(sequence, tmp_path):
    animation = animated(sequence)
    stretched = [one.copy() for one in animation.position]
    stretched[2][3] += 0.1
    with pytest.raises(InputError, match=f"joints must keep their offset; these move: {animation.names[2]}"):
        write_bvh(tmp_path / "a.bvh", type(animation)(**{**vars(animation), "position": stretched}))
    refusal(InputError, r"expected a file ending in \.glb", write_gltf, tmp_path / "a.obj", animation, skin_of(animation))
    uneven = replace(sequence, t_ns=sequence.t_ns**2 // 10**6 + sequence.t_ns)
    refusal(InputError, "evenly spaced", animated, uneven)


# --- a person as a mesh: of their lengths, around their bones, in any place, and the same in the file


def animation(root=None):
    sequence = sequence_of([BENT, {**BENT, "left_knee": (20, 0, 0)}] * 6, **({} if root is None else {"root": root}))
    return animation_from_joints(sequence, joints_from_poses(sequence), 0)


def skinned_vertices(skeleton, skin) -> np.ndarray:
    """(T, V, 3) metres in the axes of the file: linear blend skinning."""
    rotation, position = world_of(skeleton)
    linear = rotation @ skin.joint_from_mesh[:, :3, :3]
    shift = (rotation @ skin.joint_from_mesh[:, :3, 3:])[..., 0] + position
    out = np.zeros((len(skeleton), *skin.vertices.shape))
    for k in range(skin.joint.shape[1]):
        turned = np.einsum("tvij,vj->tvi", linear[:, skin.joint[:, k]], skin.vertices) + shift[:, skin.joint[:, k]]
        out += skin.weight[:, k, None] * turned
    return out


@pytest.fixture(scope="module")
def moving():
    return animation()


def test_shapes_are_those_of_the_lengths() -> None:
    body, rng = template(), np.random.default_rng(0)
    for _ in range(5):
        points = body.points_of(rng.normal(size=len(body.vertex_shapes)))
        wanted = {name: float(np.linalg.norm(points[a] - points[b])) for name, (a, b) in length_names().items()}
        got = body.points_of(body.shape_of(wanted))
        for name, (a, b) in length_names().items():
            assert np.linalg.norm(got[a] - got[b]) == pytest.approx(wanted[name], abs=0.005), name
    np.testing.assert_allclose(body.shape_of({}), 0.0)


def test_a_tall_person_gets_a_tall_body(moving) -> None:
    of_mean, of_tall = (skin_of(replace(moving, offset=scale * moving.offset)).vertices for scale in (1.0, 1.1))
    assert np.ptp(of_tall, axis=0).max() > 1.06 * np.ptp(of_mean, axis=0).max()


def test_the_nose_of_the_mean_body_lies_below_its_ears_by_the_angle_of_the_neck_s_zero() -> None:
    points = template().points
    ahead, _, up = points["nose"] - (points["left_ear"] + points["right_ear"]) / 2
    assert np.arctan2(-up, ahead) == pytest.approx(NOSE_BELOW_RAD, abs=np.radians(0.1))


def test_flesh_is_around_the_bones(moving) -> None:
    """What moves with one segment alone lies about the line of that segment, between its ends."""
    skin, (_, joints) = skin_of(moving), world_of(moving)
    vertices, index = skinned_vertices(moving, skin), {name: j for j, name in enumerate(moving.names)}
    for side in ("left", "right"):
        for upper, lower in (("upper_arm", "forearm"), ("forearm", "hand"), ("thigh", "shank"), ("shank", "foot")):
            a, b = (index[f"{side}_{name}"] for name in (upper, lower))
            own = np.flatnonzero((skin.joint[:, 0] == a) & (skin.weight[:, 0] > 0.98))
            line = joints[:, b] - joints[:, a]
            away = vertices[:, own] - joints[:, a, None]
            part = np.einsum("tvi,ti->tv", away, line) / (line**2).sum(-1)[:, None]
            aside = np.linalg.norm(away - part[..., None] * line[:, None], axis=-1)
            assert len(own) > 5 and aside.max() < 0.16 and aside.mean() > 0.02, upper
            assert part.min() > -0.25 and part.max() < 1.2 and 0.3 < part.mean() < 0.7, upper


def test_it_faces_where_the_person_faces(moving) -> None:
    """At rest noses are before the ears and toes before the ankles, more than the back of the head and heels behind: +Z."""
    skin = skin_of(moving)
    own = skin.joint_from_mesh[skin.joint[:, 0]]
    rest = np.einsum("vij,vj->vi", own[:, :3, :3], skin.vertices) + own[:, :3, 3]
    for name, ahead_m, behind_m in (("head", 0.09, 0.18), ("left_foot", 0.12, 0.1)):
        of_it = rest[(skin.joint[:, 0] == moving.names.index(name)) & (skin.weight[:, 0] > 0.98)]
        assert of_it[:, 2].max() > ahead_m and of_it[:, 2].min() > -behind_m, name
    assert np.linalg.det(skin.joint_from_mesh[:, :3, :3]).min() > 0


def test_it_turns_with_the_person(moving) -> None:
    turn = Rotation.from_euler("z", 70, degrees=True).as_matrix()
    file_turn = Rotation.from_euler("y", 70, degrees=True).as_matrix()
    turned = animation(turn)
    one, other = (skinned_vertices(a, skin_of(a)) for a in (moving, turned))
    centred = [v - v.mean(axis=1, keepdims=True) for v in (one, other)]
    np.testing.assert_allclose(centred[0] @ file_turn.T, centred[1], atol=2e-6)


def test_a_skeleton_without_hands_carries_them_along() -> None:
    sequence = sequence_of([BENT] * 12, "coco17")
    bare = animation_from_joints(sequence, joints_from_poses(sequence), 0)
    skin = skin_of(bare)
    assert not any(name.endswith("_hand") for name in bare.names) and np.isfinite(skinned_vertices(bare, skin)).all()
    np.testing.assert_allclose(skin.weight.sum(axis=1), 1.0)


def test_the_file_moves_as_we_do(moving, tmp_path) -> None:
    """Linear blend skinning by the glTF specification, from the bytes of the file alone."""
    skin = skin_of(moving)
    path = tmp_path / "body.glb"
    write_gltf(path, moving, skin=skin)
    content, values = read_glb(path)
    mesh = content["meshes"][0]["primitives"][0]
    joint, weight, rest = (values(mesh["attributes"][name]) for name in ("JOINTS_0", "WEIGHTS_0", "POSITION"))
    inverse = np.swapaxes(values(content["skins"][0]["inverseBindMatrices"]).reshape(-1, 4, 4), 1, 2)
    rotation, position = world_of(moving)
    frame = 1
    world = np.tile(np.eye(4), (len(moving.names), 1, 1))
    world[:, :3, :3], world[:, :3, 3] = rotation[frame], position[frame]
    matrices = np.einsum("vk,vkij->vij", weight, (world @ inverse)[joint])
    moved = np.einsum("vij,vj->vi", matrices, np.c_[rest, np.ones(len(rest))])[:, :3]
    np.testing.assert_allclose(moved, skinned_vertices(moving, skin)[frame], atol=1e-5)
    assert values(mesh["indices"]).max() == len(rest) - 1
    assert not joint[weight == 0].any(), "the specification: unused joints are 0"
    np.testing.assert_allclose(np.linalg.norm(values(mesh["attributes"]["NORMAL"]), axis=1), 1.0, atol=1e-5)
