"""The world file: libsdformat reads from it what the scene says."""

import os
import subprocess
import xml.etree.ElementTree as ElementTree
from dataclasses import replace

import built
import cv2
import numpy as np
import pytest
import yaml
from calibrating import refined
from checks import refusal
from scenes import chess_corners
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from posefuse.core import SE3, Camera, ConfigError, InputError
from posefuse.core.ideal_image import drawn_camera
from posefuse.formats.rig import read_rig
from posefuse.formats.truth import read_loop, read_truth
from posefuse_ros.camera_info import RigLens
from posefuse_sim.build import live_scene
from posefuse_sim.cameras import SensorSettings, rig_from_cameras
from posefuse_sim.gazebo import export_world
from posefuse_sim.gazebo.animation import baked, halfway
from posefuse_sim.gazebo.export import shown_scene
from posefuse_sim.gazebo.world import CAM_FROM_LINK, CENTRE_PX, pose_text, world_from_link
from posefuse_sim.render.model import render_model
from posefuse_sim.render.shot import CameraShooter, body_poses
from posefuse_sim.render.stage import RenderStage


def camera_from_gazebo(read: dict) -> Camera:
    """The camera that one of Gazebo, as `libsdformat` lists it, is in our conventions."""
    (fx, fy), (cx, cy) = read["f"], read["c"]
    rotation = CAM_FROM_LINK @ SE3(np.array(read["wxyz"]), np.array(read["xyz"])).inverse().matrix()
    pose = SE3.from_matrix(rotation, -rotation @ np.array(read["xyz"]))
    K = np.array([[fx, 0, cx - CENTRE_PX], [0, fy, cy - CENTRE_PX], [0, 0, 1]])
    return built.camera(K, pose=pose, name=read["name"], size_wh=tuple(read["size"]))


def test_libsdformat_reads_the_cameras_of_the_rig(written, libsdformat):
    read = libsdformat(written.sdf)
    assert read["version"] == "1.9"
    assert [one["name"] for one in read["cameras"]] == list(written.live.rig.names)
    for one, camera, rate_hz in zip(read["cameras"], written.live.rig, (20, 12.5, 20), strict=True):
        drawn, back = drawn_camera(camera), camera_from_gazebo(one)
        assert one["has_intrinsics"] and one["skew"] == 0
        assert one["rate_hz"] == rate_hz and one["topic"] == f"/{camera.name}/image"
        assert back.size_wh == drawn.size_wh
        np.testing.assert_allclose(back.K, drawn.K, rtol=0, atol=1e-6)
        np.testing.assert_allclose(back.cam_from_world.matrix4(), drawn.cam_from_world.matrix4(), rtol=0, atol=1e-6)
    assert [one["noise"] for one in read["cameras"]] == pytest.approx([0, 2 / 255, 0])


def test_libsdformat_reads_boxes_and_people(written, libsdformat):
    read = libsdformat(written.sdf)
    models = {one["name"]: one for one in read["models"]}
    box = written.live.boxes[0]
    assert models["occluder0"]["size"] == pytest.approx(list(2 * box.half_m))
    assert models["occluder0"]["wxyz"] == pytest.approx(list(box.world_from_box.wxyz), abs=1e-9)
    assert all(one["static"] for one in read["models"])
    assert {one["name"] for one in read["actors"]} == {"person0"}
    for one in read["actors"]:
        assert (written.world.folder / one["skin"]).is_file()
        # its own motion, from time 0, again and again, moved by no trajectory
        assert one["skin"] == one["animation"] and one["trajectories"] == 0
        assert (one["loop"], one["delay"], one["auto"]) == (1, 0, 1)
        assert one["xyz"] == [0, 0, 0] and one["wxyz"] == [1, 0, 0, 0]


def test_the_room_is_closed_and_holds_the_scene(written, libsdformat):
    """Floor below zero, four walls whose inner faces bound the floor, in colours of their pictures."""
    parts = {one["name"]: one for one in libsdformat(written.sdf)["models"] if one["name"].startswith("room_")}
    low, high = (
        {name: np.array(one["xyz"]) + sign * np.array(one["size"]) / 2 for name, one in parts.items()} for sign in (-1, 1)
    )
    width, depth = written.live.room_size_m
    assert len(parts) == 5 and high["room_floor"] == pytest.approx([width / 2, depth / 2, 0])
    faces = [low["room_wall0"][0], low["room_wall3"][1], -high["room_wall2"][0], -high["room_wall1"][1]]
    assert faces == pytest.approx([width / 2, depth / 2, width / 2, depth / 2])
    assert all(high[f"room_wall{i}"][2] == pytest.approx(written.live.scene.room.height_m) for i in range(4))
    assert all(0.2 < channel < 0.9 for one in parts.values() for channel in one["colour"])
    assert parts["room_floor"]["colour"] != pytest.approx(parts["room_wall0"]["colour"], abs=0.05)


@pytest.mark.parametrize("pitch_deg", [-90, -89.999, 0, 37, 90])
def test_a_pose_survives_roll_pitch_and_yaw(pitch_deg):
    # independent of our quaternions: the rotation that SDF defines
    rng = np.random.default_rng(5)
    roll, yaw = rng.uniform(-np.pi, np.pi, 2)
    rotation = Rotation.from_euler("xyz", [roll, np.deg2rad(pitch_deg), yaw]).as_matrix()
    pose = SE3.from_matrix(rotation, [1.0, -2.0, 0.5])
    numbers = np.array(pose_text(pose).split(), float)
    np.testing.assert_allclose(numbers[:3], pose.xyz)
    np.testing.assert_allclose(Rotation.from_euler("xyz", numbers[3:]).as_matrix(), pose.matrix(), atol=1e-7)


def test_pixel_centres_lie_half_a_pixel_from_the_edge(written):
    """Gazebo's OpenGL projection, written out from its definition, puts points where our camera sees them.

    gz-sensors multiplies the clip matrix of the box 0..width, 0..height by the perspective of fx, fy, cx and height - cy: so u
    is 0 at the left edge of the image, where our first pixel, with its centre at 0, begins at -0.5.
    """
    rng = np.random.default_rng(1)
    root = ElementTree.parse(written.sdf).getroot()
    for camera in written.live.rig:
        drawn = drawn_camera(camera)
        sensor = root.find(f".//model[@name='{camera.name}']//camera")
        fx, fy, cx, cy = (float(sensor.find(f"lens/intrinsics/{key}").text) for key in ("fx", "fy", "cx", "cy"))
        keys = ("image/width", "image/height", "clip/near", "clip/far")
        width, height, near, far = (float(sensor.find(key).text) for key in keys)
        clip = np.diag([2 / width, 2 / height, -2 / (far - near), 1.0])
        clip[:3, 3] = [-1, -1, -(far + near) / (far - near)]
        seen = np.array([[fx, 0, -cx, 0], [0, fy, -(height - cy), 0], [0, 0, near + far, near * far], [0, 0, -1, 0]])
        xyz_cam = rng.uniform([-0.4, -0.3, 1], [0.4, 0.3, 6], (50, 3))
        # OpenGL looks along -z with y up
        drawn_at = (clip @ seen @ np.column_stack([xyz_cam * [1, -1, -1], np.ones(50)]).T).T
        ndc = drawn_at[:, :2] / drawn_at[:, 3:]
        edge_px = (ndc * [1, -1] + 1) / 2 * [width, height]
        expected = drawn.px_from_norm(xyz_cam[:, :2] / xyz_cam[:, 2:])
        np.testing.assert_allclose(edge_px - 0.5, expected, atol=1e-9)


def test_a_gazebo_camera_looks_along_its_x(scene):
    camera = replace(scene.cameras.cameras[0], roll_deg=0)
    forward, left, up = world_from_link(rig_from_cameras((camera,)).cameras[0]).matrix().T
    towards = np.array(camera.look_at_m) - camera.position_m
    np.testing.assert_allclose(forward, towards / np.linalg.norm(towards), atol=1e-12)
    assert up[2] > 0 and abs(left[2]) < 1e-12


def test_next_to_the_world_stand_rig_truth_and_settings(written):
    folder = written.world.folder
    assert read_rig(folder / "rig.toml").id == written.live.rig.id
    truth = read_truth(folder / "truth" / "truth.npz")
    assert read_loop(folder / "truth") == 1_000_000_000
    assert truth.t_ns[0] == 0 and np.diff(truth.t_ns).max() <= 1e9 / 240 + 1
    expected = written.live.keypoints(truth.t_ns / 1e9)
    np.testing.assert_allclose(truth.xyz_world, expected, atol=1e-12)
    # what Gazebo does not show is not in the truth
    assert list(truth.views[1].t_ns[:3]) == [0, 80_000_000, 160_000_000]


def test_the_bridge_brings_clock_images_and_camera_info(written):
    entries = yaml.safe_load((written.world.folder / "bridge.yaml").read_text())
    topics = {entry["ros_topic_name"]: entry for entry in entries}
    assert set(topics) == {"/clock"} | {f"/{name}/{what}" for name in written.live.rig.names for what in ("image", "camera_info")}
    assert topics["/bent/image"]["ros_type_name"] == "sensor_msgs/msg/Image"
    assert {entry["direction"] for entry in entries} == {"GZ_TO_ROS"}
    assert all(entry["gz_type_name"].startswith("gz.msgs.") for entry in entries)
    launch = written.world.folder / "launch.sh"
    assert os.access(launch, os.X_OK)
    assert subprocess.run(["sh", "-n", str(launch)], check=False, timeout=60).returncode == 0
    without_gz = {"PATH": "/usr/bin:/bin"}
    missing = subprocess.run([str(launch)], capture_output=True, text=True, check=False, env=without_gz, timeout=60)
    assert missing.returncode == 1 and "gz: not found" in missing.stderr


def test_what_cannot_be_is_refused_in_one_line(scene, tmp_path):
    scene = replace(scene, people=())
    refusal(ConfigError, r"duration_s: expected .* got 1200 s", export_world, replace(scene, duration_s=1200), tmp_path / "a")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("precious")
    refusal(InputError, "mine", export_world, scene, tmp_path / "mine", replace_older=True)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["mine"]
    assert (tmp_path / "mine" / "notes.txt").read_text() == "precious"


# --- our renderer, driven by the cameras that libsdformat reads from the world, draws the pictures of the scene


@pytest.fixture(scope="module")
def furnished(scene):
    """The scene with its props, which Gazebo does not show."""
    return live_scene(replace(shown_scene(scene), props=scene.props))


@pytest.fixture(scope="module")
def draw(furnished, backend):
    live = furnished
    stage = RenderStage(render_model(live, live.rig, backend), backend)

    def draw_(camera, t_s=0.4):
        poses = body_poses(live, np.array([t_s]))
        shooter = CameraShooter(camera, SensorSettings(), stage)
        return shooter.shoot(poses, np.zeros((0, 3)), np.zeros(0, bool), np.zeros(0), [0]).image

    yield draw_
    stage.close()


@pytest.fixture(scope="module")
def read_cameras(written, libsdformat):
    return {one["name"]: camera_from_gazebo(one) for one in libsdformat(written.sdf)["cameras"]}


def _shift_px(one, other):
    grey = [cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.float32) for image in (one, other)]
    return np.abs(cv2.phaseCorrelate(*grey, cv2.createHanningWindow(grey[0].shape[::-1], cv2.CV_32F))[0]).max()


@pytest.mark.gl
@pytest.mark.parametrize("name", ["plain", "above"])
def test_cameras_read_from_the_world_draw_the_same_picture(name, written, draw, read_cameras):
    ours, theirs = draw(written.live.rig[name]), draw(read_cameras[name])
    assert np.abs(ours.astype(int) - theirs).mean() < 0.05 and _shift_px(ours, theirs) < 0.01
    # half a pixel, as much as the two conventions differ by, would be seen
    K = read_cameras[name].K + np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
    moved = draw(replace(read_cameras[name], K=K))
    assert np.abs(ours.astype(int) - moved).mean() > 0.5 and _shift_px(ours, moved) > 0.3


@pytest.mark.gl
def test_the_lens_at_intake_makes_our_picture_of_an_ideal_one(written, furnished, draw, read_cameras):
    camera, ideal = written.live.rig["bent"], draw(read_cameras["bent"])
    assert ideal.shape[:2][::-1] == drawn_camera(camera).size_wh != camera.size_wh
    ours, taken_in = draw(camera), RigLens(camera)(ideal)
    assert taken_in.shape == ours.shape
    assert np.abs(ours.astype(int) - taken_in).mean() < 0.3 and _shift_px(ours, taken_in) < 0.05
    # and where the board is seen, its corners are where the rig's lens puts them
    [board] = furnished.scene.props
    expected = camera.project(furnished.prop_poses(np.zeros(1))[0][0] @ chess_corners(board))
    assert np.linalg.norm((refined(taken_in, expected, 2) - expected).mean(axis=0)) < 0.2


# --- actors: other people's COLLADA readers find our bones, skin and pictures where the scene has them


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
    # and the motion is one: a person who stands still would be off by half a metre
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


def test_gazebo_finds_the_colours_of_clothes_skin_and_hair(written, read_person):
    colours = np.array(read_person[0]["colours"])
    np.testing.assert_allclose(
        colours[np.lexsort(colours.T)], (own := written.live.people[0].body.colours)[np.lexsort(own.T)], atol=1e-6
    )


def test_gazebo_plays_whole_milliseconds_of_it(read_person):
    # it cuts the length down to milliseconds: 2.3 s would become 2.299 s and the truth would run ahead of it
    facts, *_ = read_person
    assert int(facts["length_s"] * 1000) == 1000


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
