"""Actors: other people's COLLADA readers find our bones, skin and pictures where the scene has them."""

import numpy as np
import pytest
from checks import refusal
from scipy.spatial import cKDTree

from posefuse.core import ConfigError, InputError
from posefuse_sim.gazebo.animation import baked, halfway
from posefuse_sim.gazebo.collada import ColladaSkeleton, Mesh, Surface, write_collada

MM = 1e-3
# at no time of a key
TIMES_S = np.sort(np.random.default_rng(8).uniform(0, 1.0, 20))


@pytest.fixture(scope="module")
def read_person(written, gazebo_reader):
    return gazebo_reader(written.world.folder / "meshes" / "person0.dae", TIMES_S)


def test_gazebo_finds_the_bones_where_the_truth_has_them(written, read_person):
    facts, poses, _ = read_person
    body = written.live.people[0].body
    rest = np.tile(np.eye(4), (len(body.bone_names), 1, 1))
    rest[:, :3, 3] = body.bone_head_rest
    truth = written.live.bones(TIMES_S)[0] @ rest
    by_name = {name.translate({ord("."): "_", ord("-"): "_"}): b for b, name in enumerate(body.bone_names)}
    assert facts["root"] == "root" and facts["joints"] == len(poses[0]) > 25
    apart_m, turned = [], []
    for t, joints in enumerate(poses):
        for name, flat in joints.items():
            pose, expected = np.reshape(flat, (4, 4)), truth[t, by_name[name]]
            apart_m.append(np.linalg.norm(pose[:3, 3] - expected[:3, 3]))
            turned.append(np.abs(pose[:3, :3] - expected[:3, :3]).max())
    assert max(apart_m) < 1 * MM
    assert max(turned) < 0.02
    # and the motion is one: a person who stands still would be half a metre off
    assert np.linalg.norm(truth[-1, 0, :3, 3] - truth[0, 0, :3, 3]) > 0.5


def test_gazebo_finds_the_skin_where_our_renderer_draws_it(written, read_person):
    *_, skin = read_person
    expected = written.live.people[0].body.vertices(written.live.bones(TIMES_S[-1:])[0])[0]
    apart_m, nearest = cKDTree(np.array(skin)).query(expected)
    # a vertex is attached to its four strongest joints only, ours on up to nine: few toes and armpits differ
    assert np.median(apart_m) < 0.1 * MM and np.quantile(apart_m, 0.99) < 1 * MM and apart_m.max() < 10 * MM
    assert len(np.unique(nearest)) > 0.99 * len(expected)


def test_nothing_of_the_motion_is_outside_the_box_that_culls_it(written, read_person):
    facts, *_ = read_person
    skin = written.live.people[0].body.vertices(written.live.bones(np.linspace(0, 1, 20))[0])
    assert (skin.min(axis=(0, 1)) > facts["min"]).all() and (skin.max(axis=(0, 1)) < facts["max"]).all()


def test_gazebo_plays_whole_milliseconds_of_it(read_person):
    # it cuts the length down to milliseconds: 2.3 s would become 2.299 s and the truth would run ahead of it
    facts, *_ = read_person
    assert int(facts["length_s"] * 1000) == 1000


def test_gazebo_finds_a_waved_cube_and_its_picture(written, gazebo_reader):
    facts, poses, skin = gazebo_reader(written.world.folder / "meshes" / "cube.dae", TIMES_S)
    truth = written.live.prop_poses(TIMES_S)[0].matrix4()
    for joints, expected in zip(poses, truth, strict=True):
        np.testing.assert_allclose(np.reshape(joints["thing"], (4, 4)), expected, atol=1 * MM)
    (material,) = facts["materials"]
    assert material["texture"].endswith("cube.png")
    corners = written.live.props[0].vertices @ truth[-1, :3, :3].T + truth[-1, :3, 3]
    assert cKDTree(np.array(skin)).query(corners)[0].max() < 1 * MM


def test_a_second_reader_agrees(written):
    collada = pytest.importorskip("collada", reason="pycollada is not installed")
    body = written.live.people[0].body
    read = collada.Collada(str(written.world.folder / "meshes" / "person0.dae"))
    assert read.assetInfo.upaxis == "Z_UP" and read.assetInfo.unitmeter == 1
    (geometry,) = read.geometries
    triangles = np.concatenate([part.vertex[part.vertex_index] for part in geometry.primitives])
    assert len(triangles) == len(body.faces) + 8
    expected = np.sort(body.vertices_rest[body.faces].reshape(-1, 9), axis=0)
    ours = triangles[np.linalg.norm(triangles[:, 1] - triangles[:, 0], axis=-1) > 1e-4].reshape(-1, 9)
    np.testing.assert_allclose(np.sort(ours, axis=0), expected, atol=1e-6)
    (skin,) = read.controllers
    assert skin.max_joint_index < skin.weight_joints.data.size
    held = np.diff(np.concatenate([[0], np.cumsum(skin.vcounts)]))
    assert held.max() <= 4 and len(held) == len(geometry.primitives[0].vertex)
    names = [str(name) for name in skin.weight_joints.data.ravel()]
    binds = [np.linalg.inv(skin.joint_matrices[name]) for name in names]
    by_name = {name.translate({ord("."): "_", ord("-"): "_"}): b for b, name in enumerate(body.bone_names)}
    for name, bind in zip(names, binds, strict=True):
        np.testing.assert_allclose(bind[:3, 3], body.bone_head_rest[by_name[name]], atol=1e-6)
        np.testing.assert_allclose(bind[:3, :3], np.eye(3), atol=1e-6)
    assert len(read.animations) == len(names)


def test_every_picture_that_a_mesh_names_is_there(written):
    for file in (written.world.folder / "meshes").glob("*.dae"):
        text = file.read_text()
        for name in {part.split("</init_from>")[0] for part in text.split("<init_from>")[1:]}:
            assert name.endswith("-image") or (file.parent / name).is_file(), f"{file.name}: {name}"


def test_keys_are_denser_where_the_motion_is_sharper():
    def poses(t_s):
        pose = np.tile(np.eye(4), (len(t_s), 1, 1, 1))
        # an even swing, and a blow at 0.52 s that turns 5 m/s round
        pose[:, 0, 0, 3] = 0.02 * np.sin(2 * t_s)
        pose[:, 0, 2, 3] = 5 * np.maximum(0.04 - np.abs(t_s - 0.52), 0)
        return pose

    t_s, world = baked(poses, np.array([-1]), 1.0, 20)
    gaps = np.diff(t_s)
    assert gaps.max() == pytest.approx(0.05, abs=1e-4) and gaps.min() < 0.002
    # the last key is a little later, see `baked`
    ends_s = np.append(t_s[:-1], 1.0)
    off = halfway(world, np.array([-1])) - poses((ends_s[1:] + ends_s[:-1]) / 2)
    assert np.linalg.norm(off[..., :3, 3], axis=-1).max() <= 0.0005
    with pytest.raises(ConfigError, match=r"the motion jumps at 0\.4"):
        baked(lambda t_s: poses(t_s) * np.where(t_s < 0.47, 1, 2)[:, None, None, None], np.array([-1]), 1.0, 20)


def test_halfway_is_half_the_turn_of_each_joint_in_its_parent():
    angle = np.array([0.2, 1.0])
    cosine, sine = np.cos(angle), np.sin(angle)
    world = np.tile(np.eye(4), (2, 2, 1, 1))
    world[:, 0, :2, :2] = np.stack([np.stack([cosine, -sine], -1), np.stack([sine, cosine], -1)], axis=1)
    world[:, 1] = world[:, 0]
    # the child sits 1 m out on its turning parent: halfway it is still 1 m out, not on the chord
    world[:, 1, 0, 3], world[:, 1, 1, 3] = cosine, sine
    (middle,) = halfway(world, np.array([-1, 0]))
    np.testing.assert_allclose(middle[1, :2, 3], [np.cos(0.6), np.sin(0.6)], atol=1e-12)


@pytest.mark.parametrize("names", [("a.b",), ("a", "a"), ("two words",)])
def test_joints_with_names_that_readers_take_for_another_are_refused(names, tmp_path):
    count = len(names)
    skeleton = ColladaSkeleton(
        names=names,
        parent=np.arange(count) - 1,
        world_from_joint_rest=np.tile(np.eye(4), (count, 1, 1)),
        index=np.zeros((3, 4), int),
        weight=np.array([[1.0, 0, 0, 0]] * 3),
        t_s=np.array([0.0, 1.0]),
        parent_from_joint=np.tile(np.eye(4), (2, count, 1, 1)),
    )
    mesh = Mesh(vertices=np.eye(3), normals=np.eye(3), uv=np.zeros((3, 2)), parts={"part": (Surface(), np.array([[0, 1, 2]]))})
    refusal(InputError, "unique names", write_collada, tmp_path / "a.dae", mesh, skeleton)
    assert not list(tmp_path.iterdir())
