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
from posefuse_sim.build import live_scene, shots_of
from posefuse_sim.cameras import placed_cameras, rig_from_cameras
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


def _moved(motion: str) -> str:
    """A file of one person with this motion."""
    return f"{_TOP}people: [{{motion: {{{motion}}}}}]"


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
        # the keys of this kind alone: a list has `cameras`, a ring has not
        (_moved("kind: walk, path: {shape: circle, speed: 3}"), r"there are: centre_m, clockwise, radius_m, shape, start_deg$"),
        ("duration_s: 1\ncameras: {kind: ring, cout: 3}", r"there are: centre_m, count, .*sensor$"),
        (
            f"{_TOP}occluders: [{{kind: wall, from_m: [0, 0], to_m: [1, 0], size_m: 1}}]",
            r"there are: colour, from_m, height_m, kind, thickness_m, to_m$",
        ),
        ("duration_s: 1\ncameras: {kind: ring, sensor: {drop_fraction: 1.0}}", "drop_fraction: .*less than 1, got 1.0"),
        ("duration_s: 1\ncameras: {kind: list, cameras: []}", "cameras: .*at least 1 item"),
        ("[1, 2]", "expected keys with values at the top, got list"),
        # settings of another kind of motion
        (
            _moved("kind: tpose, period_s: 2"),
            r"people\.0\.motion\.period_s: tpose has none; there are: heading_deg, kind, position_m$",
        ),
        (_moved("kind: squat, sway: 0"), r"people\.0\.motion\.sway: squat has none"),
        (_moved("kind: trc, file: a, person: 1"), r"people\.0\.motion\.person: trc has none"),
        (_moved("kind: bvh, file: a.bvh"), r"people\.0\.motion: .*'trc', 'result'"),
    ],
)
def test_wrong_files_are_refused_in_one_line(tmp_path, text, message):
    refusal(ConfigError, rf"scene\.yaml: .*{message}", _read, tmp_path, text)


def _eye(*position_m: float, **sensor: float) -> dict:
    return {"cameras": listed({"name": "eye", "position_m": position_m, "look_at_m": [0.0, 0.0, 0.2], "sensor": sensor})}


def _timed(**sensor: float) -> dict:
    """Of a camera with such a clock."""
    return {**_eye(3.0, 0.0, 1.0, **sensor), "duration_s": 40.0, "start_s": 2.0, "rate_hz": 25.0, "seed": 3}


def _cube(**settings: object) -> dict:
    return {"props": [{"kind": "aruco_cube", **settings}]}


def _of_one(person: dict, **body: float) -> dict:
    return {"people": [{**person, "body": body}]}


def _walk(speed_mps: float = 1.0, **path: object) -> dict:
    return {"motion": {"kind": "walk", "path": path, "speed_mps": speed_mps}}


def _around(**ring: object) -> dict:
    return {"cameras": {"kind": "ring", **ring}}


_MAN = {"motion": {"kind": "tpose"}}
_FAR = {"motion": {"kind": "walk", "path": {"shape": "circle", "radius_m": 6.0}}}
_CLUTTER = {"kind": "clutter", "keep_clear_m": 3.0}
_SMALL = {"size_m": [3.0, 8.0]}


@pytest.mark.gl
@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"people": [_FAR]}, r"people\.0: leaves the floor of .* at 0.0 s; make room.size_m larger"),
        ({"room": _SMALL}, r"camera cam00: stands at .* outside the room of \(3.00, 8.00\) m"),
        (_cube(marker_m=0.3), "prop cube: marker_m 0.3 leaves no white border inside side_m 0.2"),
        (_cube(dictionary="DICT_9X9"), "marker dictionary: unknown name 'DICT_9X9'; there are: .*DICT_4X4_50"),
        (_cube(first_id=47), "prop cube: DICT_4X4_50 has 50 markers, marker 50 is needed"),
        (_around(overrides={"cam9": {}}), "no camera 'cam9'; there are: cam00, cam01, cam02, cam03"),
        (_around(image={"distortion": [0.1]}), r"camera cam00: distortion.*got 1"),
        (_around(image={"K": [[-5.0, 0, 1], [0, 5.0, 1], [0, 0, 1]]}), "camera cam00: K: expected"),
        ({"cameras": listed(*[{"name": "a", "position_m": [1, 0, 2]}] * 2)}, "cameras: .*unique, got twice: a"),
        (_around(radius_m=1e308), "camera cam00: expected a position within 1e.06 m of look_at_m"),
        (_eye(0.0, 0.0, 0.2), "camera eye: look_at_m is its own position"),
        (_timed(offset_s=-3.0), r"camera eye: its clock starts at -1.000 s.*set start_s to at least 3.000"),
        (_timed(phase_s=50.0), "camera eye: no frame is left.*make duration_s longer"),
        ({"occluders": [{**_CLUTTER, "area_m": [1.0, 1.0]}]}, r"only 0 of 6 boxes fit.*make the area larger"),
        (_of_one(_MAN, height_m=2.3, age_years=5), r"height_m: expected \d+\.\d+ to \d+\.\d+ m .* got 2\.30 m"),
        (_of_one(_walk(shape="line", start_m=[0, 0], end_m=[0.5, 0])), "end_m: expected at least 1.0 m from start_m, got 0.50 m"),
        (_of_one(_walk(2.0, shape="circle", radius_m=0.5)), r"speed_mps: expected at most 1.12 m/s on a circle .* got 2.0"),
        (_of_one(_walk(shape="random", low_m=[0, 0], high_m=[1, 5])), "high_m: expected at least 2 m beyond low_m"),
        (
            _of_one(_walk(2.0, shape="line", start_m=[0, 0], end_m=[5, 0]), age_years=7, height_m=1.2),
            r"speed_mps: expected at most 1\.\d\d m/s for a hip height of 0\.\d\d m \(faster is running",
        ),
    ],
)
def test_a_scene_that_cannot_be_is_refused(content, message):
    refusal(ConfigError, message, live_scene, scene(**content))


def test_without_walls_cameras_may_stand_beyond_the_floor():
    live_scene(scene(room={**_SMALL, "walls": "none"}))


@pytest.mark.gl
def test_the_bundled_clip_is_the_demo_scene_of_today():
    """When this fails, `make demo-clip` renders it again."""
    bundled = _EXAMPLES[0].parents[1] / "demo"
    demo = read_scene(bundled / "scene.yaml")
    assert demo == read_scene(bundled.parent / "scenes" / "demo.yaml")
    live, truth = live_scene(demo), read_truth(bundled / "truth" / "truth.npz")
    assert live.rig.id == truth.rig.id
    np.testing.assert_allclose(live.keypoints(truth.t_ns[::50] / 1e9), truth.xyz_world[::50], atol=1e-4)


# --- where cameras stand and look


def _ring(**content):
    return rig_from_cameras(placed_cameras(scene(cameras={"kind": "ring", **content}).cameras))


def _seen_by(xyz, **content):
    """px of a point in one camera at a place of its own."""
    return rig_from_cameras(placed_cameras(scene(cameras=listed({"name": "a", **content})).cameras)).project(np.array(xyz))[0]


def test_a_ring_looks_at_its_point_from_its_circle():
    rig = _ring(count=5, radius_m=3.0, height_m=1.7, centre_m=[0.5, -1.0], look_at_m=[0.2, 0.1, 0.9])
    centres = rig.centres_world()
    np.testing.assert_allclose(np.hypot(centres[:, 0] - 0.5, centres[:, 1] + 1.0), 3.0)
    np.testing.assert_allclose(centres[:, 2], 1.7)
    middle = np.tile([(640 - 1) / 2, (480 - 1) / 2], (5, 1))
    np.testing.assert_allclose(rig.project(np.array([0.2, 0.1, 0.9])), middle, atol=1e-9)


def test_up_is_up_in_every_picture():
    rig = _ring()
    low, high = rig.project(np.array([0, 0, 0.5])), rig.project(np.array([0, 0, 1.5]))
    assert (high[:, 1] < low[:, 1] - 50).all()
    np.testing.assert_allclose(high[:, 0], low[:, 0], atol=1e-9)


def test_the_field_of_view_is_between_the_edges():
    camera = _ring(count=1, image={"size_px": [800, 600], "horizontal_fov_deg": 70.0}).cameras[0]
    left, right = camera.norm_from_px(np.array([[-0.5, 299.5], [799.5, 299.5]]))[:, 0]
    assert np.rad2deg(np.arctan(right) - np.arctan(left)) == pytest.approx(70.0)


def test_roll_turns_the_camera_clockwise_so_the_world_turns_the_other_way():
    above = _seen_by([0.0, 0.0, 1.5], position_m=[0.0, -3.0, 1.0], look_at_m=[0.0, 0.0, 1.0], roll_deg=90.0)
    # turned clockwise by a quarter, what was up is now on the left
    assert above[0] < 300 and above[1] == pytest.approx(239.5)


def test_a_camera_may_look_straight_down():
    north = _seen_by([0.0, 0.5, 0.0], position_m=[0.0, 0.0, 3.0], look_at_m=[0.0, 0.0, 0.0])
    assert north[1] < 239 and north[0] == pytest.approx(319.5)


def test_overrides_change_one_camera_only():
    rig = _ring(count=3, overrides={"cam01": {"image": {"size_px": [320, 200]}, "sensor": {"readout_s": 0.01}}})
    assert [camera.size_wh for camera in rig] == [(640, 480), (320, 200), (640, 480)]
    assert [camera.readout_s for camera in rig] == [0.0, 0.01, 0.0]


# --- clocks: what a camera exposes when, and what it writes on it


def _shots(seed=3, index=1, rate_hz=25.0, start_s=2.0, duration_s=40.0, **sensor):
    cameras = listed({"name": "left", "position_m": [3.0, 0.0, 1.0], "sensor": sensor})
    made = scene(duration_s=duration_s, start_s=start_s, rate_hz=rate_hz, seed=seed, cameras=cameras)
    return shots_of(made, index, made.cameras.cameras[0])


def test_offset_and_drift_are_a_line_through_true_and_stamped_times():
    shots = _shots(offset_s=-0.7, drift_ppm=150.0, jitter_s=0.002, drop_fraction=0.1)
    slope, offset = np.polyfit(shots.t_ns / 1e9, shots.stamp_ns / 1e9, 1)
    assert slope - 1 == pytest.approx(150e-6, rel=1e-6)
    assert offset == pytest.approx(-0.7, abs=1e-8)


def test_a_fast_clock_takes_frames_sooner():
    shots = _shots(drift_ppm=5000.0)
    assert np.diff(shots.t_ns).mean() == pytest.approx(1e9 / 25 / 1.005, rel=1e-9)
    # in its own opinion it is exactly on time
    assert np.diff(shots.stamp_ns) == pytest.approx(1e9 / 25, abs=2)


def test_jitter_has_its_size_and_the_stamps_know_it():
    shots = _shots(jitter_s=0.003)
    off_s = shots.t_ns / 1e9 - (2.0 + shots.seq / 25.0)
    assert np.std(off_s[1:]) == pytest.approx(0.003, rel=0.1)
    np.testing.assert_allclose(shots.stamp_ns, shots.t_ns, atol=1)


def test_dropped_frames_leave_gaps_in_the_numbers():
    shots = _shots(drop_fraction=0.2)
    assert len(shots) == pytest.approx(800, abs=50)
    np.testing.assert_array_equal(shots.t_ns, np.round((2.0 + shots.seq / 25.0) * 1e9))
    assert (np.diff(shots.seq) > 1).any()


def test_wild_jitter_keeps_the_order():
    assert (np.diff(_shots(jitter_s=0.5).t_ns) > 0).all()


def test_same_seed_same_shots_and_cameras_differ():
    faults = {"jitter_s": 0.002, "drop_fraction": 0.1}
    np.testing.assert_array_equal(_shots(**faults).t_ns, _shots(**faults).t_ns)
    assert not np.array_equal(_shots(**faults).seq, _shots(index=2, **faults).seq)
    assert not np.array_equal(_shots(**faults).seq, _shots(seed=4, **faults).seq)
