"""A recorded person walks in Gazebo: a scene whose motion is a posefuse result."""

from dataclasses import replace

import built
import numpy as np
import pytest

import posefuse as pf
from posefuse.core import SKELETONS
from posefuse.formats.recording import write_recording
from posefuse.formats.truth import read_truth
from posefuse_sim.build import live_scene
from posefuse_sim.gazebo.export import shown_scene
from posefuse_sim.motion.settings import RecordedSettings
from posefuse_sim.scene import PersonSettings, read_scene, write_scene

KEYPOINTS = SKELETONS["anatomical23"]
LEGS = KEYPOINTS.indices(["left_knee", "right_knee", "left_ankle", "right_ankle"])
TIMES_S = np.arange(31) / 30


@pytest.fixture(scope="module")
def recorded(tmp_path_factory, scene):
    """The scene's walker as `posefuse track` would have recorded them, and the scene with that result in their place."""
    folder = tmp_path_factory.mktemp("recorded")
    live = live_scene(scene)
    xyz = live.people[0].at(TIMES_S).keypoints_world[:, None]
    poses = built.poses(xyz, skeleton=KEYPOINTS, t_ns=(TIMES_S * 1e9).astype(np.int64), ids=[4])
    (folder / "result").mkdir()
    write_recording(folder / "result", built.recording(live.rig, poses, score=0.0))
    motion = RecordedSettings(kind="result", file=str(folder / "result"))
    write_scene(replace(scene, people=(PersonSettings(motion=motion),), props=()), folder)
    world = pf.gazebo_world(next(folder.glob("*.yaml")), folder / "world", release="jetty")
    return world, xyz[:, 0]


def test_the_truth_walks_where_the_recorded_person_walked(recorded):
    world, xyz = recorded
    truth = read_truth(world.folder / "truth" / "truth.npz")
    at = np.stack(
        [np.interp(TIMES_S[:-1], truth.t_ns / 1e9, truth.xyz_world[:, 0, j, i]) for j in LEGS for i in range(3)], axis=-1
    )
    apart_m = np.linalg.norm(at.reshape(len(at), len(LEGS), 3) - xyz[:-1][:, LEGS], axis=-1)
    assert np.median(apart_m) < 5e-3
    # they walk: standing still would be metres away
    assert np.linalg.norm(xyz[-1, LEGS] - xyz[0, LEGS], axis=-1).max() > 0.8


def test_the_scene_that_is_kept_names_the_recording(recorded):
    world, _ = recorded
    kept = read_scene(world.folder / "scene.yaml").people[0].motion
    assert kept.kind == "result"


def test_gazebo_finds_the_bones_of_the_recorded_person(recorded, gazebo_reader):
    world, _ = recorded
    times_s = np.sort(np.random.default_rng(5).uniform(0, 1.0, 10))
    _, poses, _ = gazebo_reader(world.folder / "meshes" / "person0.dae", times_s)
    live = live_scene(shown_scene(read_scene(world.folder / "scene.yaml"))[0])
    truth = live.bones(times_s)[0]
    by_name = {name.translate({ord("."): "_", ord("-"): "_"}): b for b, name in enumerate(live.bodies[0].bone_names)}
    apart_m = [
        np.linalg.norm(np.reshape(flat, (4, 4))[:3, 3] - truth[t, by_name[name], :3, 3])
        for t, joints in enumerate(poses)
        for name, flat in joints.items()
    ]
    assert max(apart_m) < 1e-3
