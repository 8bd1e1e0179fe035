"""A person as a mesh: of their lengths, around their bones, in any place, and the same in the file."""

import numpy as np
import pytest
from figure import BENT
from glb import read_glb
from scipy.spatial.transform import Rotation

from posefuse.formats.gltf import write_gltf
from posefuse.kinematics import joints_from_poses
from posefuse.kinematics.animation import animation_from_joints
from posefuse.kinematics.definitions import NOSE_BELOW_RAD
from posefuse.kinematics.skin import length_names, skin_of, template


def animation(posed, root=None):
    sequence = posed([BENT, {**BENT, "left_knee": (20, 0, 0)}] * 6, **({} if root is None else {"root": root}))
    return animation_from_joints(sequence, joints_from_poses(sequence), 0)


def skinned_vertices(skeleton, skin) -> np.ndarray:
    """(T, V, 3) metres in the axes of the file: linear blend skinning."""
    rotation, position = skeleton.world()
    linear = rotation @ skin.joint_from_mesh[:, :3, :3]
    shift = (rotation @ skin.joint_from_mesh[:, :3, 3:])[..., 0] + position
    out = np.zeros((len(skeleton), *skin.vertices.shape))
    for k in range(skin.joint.shape[1]):
        turned = np.einsum("tvij,vj->tvi", linear[:, skin.joint[:, k]], skin.vertices) + shift[:, skin.joint[:, k]]
        out += skin.weight[:, k, None] * turned
    return out


@pytest.fixture(scope="module")
def moving(posed):
    return animation(posed)


def test_shapes_are_those_of_the_lengths() -> None:
    body, rng = template(), np.random.default_rng(0)
    for _ in range(5):
        points = body.points_of(rng.normal(size=len(body.vertex_shapes)))
        wanted = {name: float(np.linalg.norm(points[a] - points[b])) for name, (a, b) in length_names().items()}
        got = body.points_of(body.shape_of(wanted))
        for name, (a, b) in length_names().items():
            assert np.linalg.norm(got[a] - got[b]) == pytest.approx(wanted[name], abs=0.005), name
    np.testing.assert_allclose(body.shape_of({}), 0.0)


def test_a_tall_person_gets_a_tall_body() -> None:
    body = template()
    mean = {name: float(np.linalg.norm(body.points[a] - body.points[b])) for name, (a, b) in length_names().items()}
    tall = body.vertices + np.tensordot(body.shape_of({name: 1.1 * m for name, m in mean.items()}), body.vertex_shapes, 1)
    assert np.ptp(tall[:, 2]) > 1.06 * np.ptp(body.vertices[:, 2])


def test_the_nose_of_the_mean_body_lies_below_its_ears_by_the_angle_of_the_neck_s_zero() -> None:
    points = template().points
    ahead, _, up = points["nose"] - (points["left_ear"] + points["right_ear"]) / 2
    assert np.arctan2(-up, ahead) == pytest.approx(NOSE_BELOW_RAD, abs=np.radians(0.1))


def test_flesh_is_around_the_bones(moving) -> None:
    """What moves with one segment alone lies about the line of that segment, between its ends."""
    skin, (_, joints) = skin_of(moving), moving.world()
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


def test_it_turns_with_the_person(posed, moving) -> None:
    turn = Rotation.from_euler("z", 70, degrees=True).as_matrix()
    file_turn = Rotation.from_euler("y", 70, degrees=True).as_matrix()
    turned = animation(posed, turn)
    one, other = (skinned_vertices(a, skin_of(a)) for a in (moving, turned))
    centred = [v - v.mean(axis=1, keepdims=True) for v in (one, other)]
    np.testing.assert_allclose(centred[0] @ file_turn.T, centred[1], atol=2e-6)


def test_a_skeleton_without_hands_carries_them_along(posed) -> None:
    sequence = posed([BENT] * 12, "coco17")
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
    rotation, position = moving.world()
    frame = 1
    world = np.tile(np.eye(4), (len(moving.names), 1, 1))
    world[:, :3, :3], world[:, :3, 3] = rotation[frame], position[frame]
    matrices = np.einsum("vk,vkij->vij", weight, (world @ inverse)[joint])
    moved = np.einsum("vij,vj->vi", matrices, np.c_[rest, np.ones(len(rest))])[:, :3]
    np.testing.assert_allclose(moved, skinned_vertices(moving, skin)[frame], atol=1e-5)
    assert values(mesh["indices"]).max() == len(rest) - 1
    np.testing.assert_allclose(np.linalg.norm(values(mesh["attributes"]["NORMAL"]), axis=1), 1.0, atol=1e-5)
