"""Scene files: what is read, and what is refused with file, key, expected and got."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from checks import refusal
from scenes import listed, scene

from posefuse.core import ConfigError
from posefuse.formats.truth import read_truth
from posefuse_sim import Scene, read_scene
from posefuse_sim.build import live_scene
from posefuse_sim.scene import plain_settings

_EXAMPLES = sorted((Path(__file__).resolve().parents[2] / "examples" / "scenes").glob("*.yaml"))


def _read(tmp_path: Path, text: str) -> Scene:
    path = tmp_path / "scene.yaml"
    path.write_text(text)
    return read_scene(path)


def test_there_are_examples():
    assert {"demo", "tpose_8cam", "tpose_8cam_occluded", "walk_4cam", "paths_circle"} <= {path.stem for path in _EXAMPLES}


@pytest.mark.parametrize("path", _EXAMPLES, ids=lambda path: path.stem)
def test_examples_are_valid_and_written_settings_read_back_equal(path, tmp_path):
    read = read_scene(path)
    assert _read(tmp_path, yaml.safe_dump(plain_settings(read))) == read


def test_the_papers_walking_scene_is_the_papers():
    read = read_scene(next(path for path in _EXAMPLES if path.stem == "walk_4cam"))
    assert (read.duration_s, read.rate_hz, read.cameras.count, read.cameras.radius_m) == (60, 30, 4, 4.5)
    assert read.people[0].motion.speed_mps == 1.35


_TOP = "duration_s: 1\ncameras: {kind: ring}\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (f"{_TOP}colour: red", r"unknown key 'colour'; there are: .*duration_s"),
        ("duration_s: 1\ncameras: {kind: ring, count: 0}", r"cameras\.ring\.count: .*greater than or equal to 1, got 0"),
        ("duration_s: 1\ncameras: {kind: ring, count: 1000000}", "less than or equal to 1000, got 1000000"),
        ("duration_s: 1\ncameras: {kind: ring, image: {size_px: [20000, 9]}}", "less than or equal to 16384, got 20000"),
        (f"{_TOP}rate_hz: 0", "rate_hz: .*greater than 0, got 0"),
        ("duration_s: 1\ncameras: {kind: sphere}", "cameras: .*'ring'.*'list'.*got"),
        ("duration_s: 5 s\ncameras: {kind: ring}", "duration_s: .*number.*got '5 s'"),
        ("cameras: {kind: ring}", "duration_s: missing"),
        ("duration_s: 1\ncameras: {kind: ring, image: {width: 640}}", r"unknown key '.*image\.width'"),
        ("duration_s: 1\ncameras: {kind: ring, sensor: {drop_fraction: 1.0}}", "drop_fraction: .*less than 1, got 1.0"),
        ("duration_s: 1\ncameras: {kind: list, cameras: []}", "cameras: .*at least 1 item"),
        (
            "duration_s: 1\ncameras: {kind: list, cameras: [&a {name: a, position_m: [1, 0, 2]}, *a]}",
            "name: used twice: a",
        ),
        (
            f"{_TOP}props: [{{kind: aruco_cube, path: {{kind: carried, person: 2}}}}]",
            r"props: cube: path\.person: no person 2; there are: none",
        ),
        ("[1, 2]", "expected keys with values at the top, got list"),
    ],
)
def test_wrong_files_are_refused_in_one_line(tmp_path, text, message):
    refusal(ConfigError, rf"scene\.yaml: .*{message}", _read, tmp_path, text)


def _eye(*position_m: float) -> dict:
    return {"cameras": listed({"name": "eye", "position_m": position_m, "look_at_m": [0.0, 0.0, 0.2]})}


_MAN = {"motion": {"kind": "tpose"}}
_FAR = {"motion": {"kind": "walk", "path": {"shape": "circle", "radius_m": 6.0}}}
_BOX = {"kind": "box", "position_m": [2.0, 0.0, 1.0], "size_m": [0.6, 0.6, 0.6]}
_SMALL = {"size_m": [3.0, 8.0]}


@pytest.mark.gl
@pytest.mark.parametrize(
    ("content", "message"),
    [
        (
            {**_eye(0.0, 0.1, 1.3), "people": [_MAN]},
            r"camera eye: stands at \(0.00, 0.10, 1.30\) m, inside or touching people\.0 at 0.0 s; keep 0.25 m",
        ),
        ({"people": [_FAR]}, r"people\.0: leaves the floor of .* at 0.0 s; make room.size_m larger"),
        ({**_eye(2.1, 0.1, 1.2), "occluders": [_BOX]}, r"camera eye: stands at .* inside box 0 of the occluders"),
        ({"room": _SMALL}, r"camera cam00: stands at .* outside the room of \(3.00, 8.00\) m"),
    ],
)
def test_people_and_cameras_are_kept_from_each_other_and_within_the_room(content, message):
    refusal(ConfigError, message, live_scene, scene(**content))


def test_without_walls_cameras_may_stand_beyond_the_floor():
    live_scene(scene(room={**_SMALL, "walls": "none"}))


@pytest.mark.parametrize(
    ("motion", "message"),
    [
        ("kind: tpose, period_s: 2", r"people\.0\.motion\.period_s: tpose has none; there are: heading_deg, kind, position_m$"),
        ("kind: squat, sway: 0", r"people\.0\.motion\.sway: squat has none"),
        ("kind: idle, path: [[0, 0.3, 0, 1]]", r"people\.0\.motion\.path: idle has none"),
        ("kind: hand_path", r"people\.0\.motion\.path: missing"),
        ("kind: trc, file: a.trc, heading_deg: 3", r"people\.0\.motion\.heading_deg: trc has none; there are: file, kind, loop"),
        ("kind: bvh, file: a.bvh, up: z", r"people\.0\.motion\.up: bvh has none"),
    ],
)
def test_settings_of_another_kind_of_motion_are_refused(tmp_path, motion, message):
    refusal(ConfigError, message, _read, tmp_path, f"{_TOP}people: [{{motion: {{{motion}}}}}]")


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"marker_m": 0.3}, "prop cube: marker_m 0.3 leaves no white border inside side_m 0.2"),
        ({"dictionary": "DICT_9X9"}, "prop cube: dictionary: no 'DICT_9X9'; there are: .*DICT_4X4_50"),
        ({"first_id": 47}, "prop cube: DICT_4X4_50 has 50 markers, marker 50 is needed"),
    ],
)
def test_marker_settings_that_cannot_be_are_refused(settings, message):
    refusal(ConfigError, message, live_scene, scene(props=[{"kind": "aruco_cube", **settings}]))


@pytest.mark.gl
def test_the_bundled_clip_is_the_demo_scene_of_today():
    """When this fails, `make demo-clip` renders it again."""
    bundled = _EXAMPLES[0].parents[1] / "demo"
    demo = read_scene(bundled / "scene.yaml")
    assert demo == read_scene(bundled.parent / "scenes" / "demo.yaml")
    live, truth = live_scene(demo), read_truth(bundled / "truth" / "truth.npz")
    assert live.rig.id == truth.rig.id
    np.testing.assert_allclose(live.keypoints(truth.t_ns[::50] / 1e9), truth.xyz_world[::50], atol=1e-4)
