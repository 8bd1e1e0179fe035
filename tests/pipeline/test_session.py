"""A session folder is understood by convention, and what cannot be distinguished is an error that says what to do."""

import csv
import re
import shutil
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from built import detections, standing
from checks import refusal
from commands import oracle
from studies import write_openpose
from videos import remuxed

import posefuse as pf
from posefuse.cli.main import main
from posefuse.core import SE3, SKELETONS, CalibrationError, ConfigError, DetectionBatch, InputError, LookKind, Observations, Rig
from posefuse.core.skeleton import COCO17
from posefuse.evaluation.tracks import plain_name, read_tracks
from posefuse.formats.recording import read_recording
from posefuse.formats.rig import write_rig
from posefuse.pipeline.config import (
    CONFIG_FILE,
    CameraInput,
    TrackConfig,
    changed_config,
    changes_of,
    read_config,
    settings_by_key,
)
from posefuse.pipeline.opening import build_source, open_session
from posefuse.pipeline.session import find_session
from posefuse.pipeline.track import _check_people
from posefuse.pipeline.writing import build_sinks
from posefuse.sources import VIDEO_SUFFIXES


@pytest.fixture
def session(tmp_path: Path, ring_rig) -> Path:
    write_rig(tmp_path / "rig.toml", ring_rig(3).renamed({"cam00": "cam_01", "cam01": "cam_02", "cam02": "cam_10"}))
    return tmp_path


def touch(folder: Path, names: Iterable[str]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        (folder / name).touch()


@pytest.mark.parametrize(
    "names",
    [
        ["cam_01.mp4", "cam_02.mp4", "cam_10.mp4"],
        ["Cam1.avi", "cam02.MP4", "cam10.mkv"],
        ["trial3_cam01.mp4", "trial3_cam02.mp4", "trial3_cam10.mp4"],
        ["1.mp4", "2.mp4", "10.mp4"],
    ],
)
@pytest.mark.parametrize("place", [".", "videos"])
def test_videos_find_their_cameras_whatever_the_spelling(session: Path, names: list[str], place: str) -> None:
    touch(session / place, names)
    found = find_session(session, TrackConfig())
    assert [(entry.camera, entry.path.name) for entry in found.inputs] == list(zip(found.rig.names, names, strict=True))
    assert {entry.kind for entry in found.inputs} == {"videos"}
    assert found.notes == ()


def test_a_session_of_freemocap_is_found_as_it_is(session: Path) -> None:
    """Its calibration and its folder of videos had to be named one by one."""
    calibration = (session / "rig.toml").rename(session / "walk_camera_calibration.toml")
    touch(session / "synchronized_videos", [f"cam_{number}_synchronized.mp4" for number in ("01", "02", "10")])
    found = find_session(session, TrackConfig())
    assert found.rig_path == calibration and [entry.camera for entry in found.inputs] == ["cam_01", "cam_02", "cam_10"]


def test_images_and_pose_folders(session: Path) -> None:
    for name in ("cam_01", "cam_02", "cam_10"):
        touch(session / "images" / name, ["0001.jpg", "0002.jpg"])
        touch(session / "openpose_json" / f"{name}_json", ["a.0000.json"])
    assert {entry.kind for entry in find_session(session, TrackConfig()).inputs} == {"images"}
    poses = find_session(session, TrackConfig(input="pose2d"))
    assert [entry.path.name for entry in poses.inputs] == ["cam_01_json", "cam_02_json", "cam_10_json"]


@pytest.mark.parametrize("place", ["pose2d/{}/predictions/video.json", "pose2d/predictions/{}.json"])
def test_predictions_of_mmpose_are_found_as_it_writes_them(session: Path, place: str) -> None:
    for name in ("cam_01", "cam_02", "cam_10"):
        path = session / place.format(name)
        touch(path.parent, [path.name])
    found = find_session(session, TrackConfig())
    assert [(entry.camera, entry.kind) for entry in found.inputs] == [(name, "pose2d") for name in found.rig.names]


def test_the_rate_of_images_is_asked_for_in_one_line(session: Path, recwarn: pytest.WarningsRecorder) -> None:
    for name in ("cam_01", "cam_02", "cam_10"):
        touch(session / "images" / name, ["0001.jpg", "0002.jpg"])
    with pytest.raises(InputError, match=r"images of cam_01, cam_02, cam_10 do not state their frame rate; add `rate_hz=HZ`"):
        open_session(find_session(session, TrackConfig()), TrackConfig())
    assert not recwarn.list


def test_a_calibrated_camera_without_data_is_left_aside_and_said(session: Path) -> None:
    touch(session, ["cam_01.mp4", "cam_10.mp4"])
    found = find_session(session, TrackConfig())
    assert found.rig.names == ("cam_01", "cam_10")
    assert found.notes == ("camera cam_02: calibrated, but no videos found; left aside",)


def test_the_config_names_skips_and_overrules(session: Path) -> None:
    touch(session, ["cam_01.mp4", "cam_02.mp4", "extra.mp4"])
    cameras = {"cam_10": CameraInput(video="extra.mp4", offset_s=0.25), "cam_02": CameraInput(skip=True)}
    found = find_session(session, TrackConfig(cameras=cameras))
    assert [(entry.camera, entry.path.name) for entry in found.inputs] == [("cam_01", "cam_01.mp4"), ("cam_10", "extra.mp4")]
    assert found.inputs[1].settings.offset_s == 0.25


def refused(session: Path, config: TrackConfig = TrackConfig()) -> str:  # noqa: B008 - a frozen value
    return refusal((InputError, CalibrationError), "", find_session, session, config)


def test_what_is_wrong_is_named(session: Path, tmp_path: Path) -> None:
    (session / "cam_01.h264").touch()
    line = refused(session)
    assert all(f"{kind} (." in line for kind in ("videos", "images", "pose2d")) and all(one in line for one in VIDEO_SUFFIXES)
    touch(session, ["cam_01.mp4"])
    assert "at least 2 calibrated cameras, got 1" in refused(session)
    touch(session, ["cam_02.mp4", "a person.mp4"])
    message = refused(session)
    assert "a person.mp4" in message and "cam_01, cam_02, cam_10" in message and '[cameras.cam_01] video = "..."' in message
    touch(session / "pose2d" / "side", ["a.0000.json"])
    assert '[cameras.cam_01] pose2d = "..."' in refused(session, TrackConfig(input="pose2d"))
    (session / "a person.mp4").unlink()
    touch(session, ["trial_cam_02.mp4"])
    assert "second one for camera cam_02" in refused(session)
    assert "no camera cam_99" in refused(session, TrackConfig(cameras={"cam_99": CameraInput(video="x.mp4")}))
    assert "no such file" in refused(session, TrackConfig(cameras={"cam_01": CameraInput(video="x.mp4")}))
    both = TrackConfig(cameras={"cam_01": CameraInput(video="cam_01.mp4", images="y")})
    assert "one of video, images, pose2d, got 2" in refused(session, both)
    assert "no such calibration file" in refused(session, TrackConfig(rig="none.toml"))
    assert "no such session folder" in refused(tmp_path / "nowhere")
    (session / "rig.toml").unlink()
    assert "no calibration file" in refused(session)


def detections_of(found: dict[str, int], depth: bool) -> Observations:
    """One time step in which each camera found so many people."""
    places = {name: np.full((count, len(COCO17), 2), 100.0) for name, count in found.items()}
    seen = tuple(detections(name, xy, depth_m=np.ones_like(xy) if depth else None) for name, xy in places.items())
    batch = DetectionBatch(step=0, t_ns=0, kind=LookKind.SEARCH, detections=seen)
    people = np.concatenate([np.arange(n) for n in found.values()])
    return Observations.from_batches(COCO17, tuple(found), [batch]).with_person_ids(people)


@pytest.mark.parametrize(("depth", "seeing", "enough"), [(False, 2, True), (False, 1, False), (True, 1, True), (True, 0, False)])
def test_a_person_in_too_few_cameras_is_refused_with_their_number(depth: bool, seeing: int, enough: bool, recwarn) -> None:
    found = {f"cam{c}": int(c < seeing) for c in range(3)}
    if enough:
        _check_people(detections_of(found, depth))
    else:
        with pytest.raises(InputError, match=rf"a person was found in {seeing} of 3 cameras.*no person in: .*cam2"):
            _check_people(detections_of(found, depth))
    assert [str(one.message).split(":")[0] for one in recwarn] == [f"camera cam{c}" for c in range(seeing, 3)]


@pytest.mark.parametrize(("cameras", "own_threads"), [(1, True), (4, True), (5, False), (9, False)])
def test_videos_have_decoding_threads_of_their_own_only_where_cameras_leave_cores_idle(
    demo_session: Path, monkeypatch: pytest.MonkeyPatch, cameras: int, own_threads: bool
) -> None:
    monkeypatch.setattr("posefuse.pipeline.opening.usable_cores", lambda: 5)
    entry = find_session(demo_session, TrackConfig()).inputs[0]
    assert build_source(entry, TrackConfig(), cameras)._config.threads == own_threads


# --- how a result was made is written in it, with the date that the camera wrote into its video


@pytest.mark.parametrize("stated", ["2026-03-01T09:30:00Z", None])
def test_the_date_of_the_first_video_is_that_of_the_recording(demo_session: Path, tmp_path: Path, stated: str | None) -> None:
    session = Path(shutil.copytree(demo_session, tmp_path / "session"))
    if stated is not None:
        remuxed(demo_session / "videos" / "cam00.mp4", session / "videos" / "cam00.mp4", stated=stated)
    about = pf.track(session, end_s=0.2, settings=oracle()).provenance
    assert about.get("recorded") == stated
    assert (about["session"], about["inputs"]["cam00"]) == ("session", "cam00.mp4")
    assert about["config"]["end_s"] == 0.2


# --- sessions of other tools' 2D poses: a whole Pose2Sim project by one command, and no frame rate out of thin air


HALPE = SKELETONS["halpe_26"]
FRAMES = 14
MIDDLE = {"head": (0, 0, 1.8), "neck": (0, 0, 1.5), "mid_hip": (0, 0, 0.95)}


def person() -> np.ndarray:
    """(T, K, 3) a person who glides along x."""
    return standing(skeleton=HALPE, **MIDDLE) + np.arange(FRAMES)[:, None, None] * [0.02, 0, 0]


@pytest.fixture
def project(ring_rig: Callable[..., Rig], tmp_path: Path) -> Path:
    """A Pose2Sim project: calibration/ and pose/, as its own pose estimation leaves it; and its frame rate."""
    rig = ring_rig(3)
    folder = tmp_path / "project"
    (folder / "calibration").mkdir(parents=True)
    write_rig(folder / "calibration" / "Calib_scene.toml", rig)
    write_poses(folder, rig, person())
    (folder / CONFIG_FILE).write_text("rate_hz = 50\n")
    return folder


def write_poses(folder: Path, rig: Rig, xyz: np.ndarray) -> None:
    """OpenPose's form of 3D points (T, K, 3) as each camera sees them."""
    for camera in rig:
        write_openpose(folder / "pose" / f"{camera.name}_json", dict(enumerate(camera.project(xyz)[:, None])))


def track(folder: Path, out: Path, *more: str, outputs: str = "trc") -> int:
    return main(["track", str(folder), "--out", str(out), "--outputs", outputs, "--set", "joint_centres=false", *more])


def test_a_pose2sim_project_is_tracked_by_one_command(project: Path, tmp_path: Path) -> None:
    assert track(project, tmp_path / "out") == 0
    poses = read_recording(tmp_path / "out").poses
    assert poses.skeleton == HALPE and set(np.diff(poses.t_ns)) == {20_000_000}
    assert np.nanmax(np.linalg.norm(poses.xyz_world[:, 0] - person(), axis=-1)) < 0.01


def test_a_scale_of_2d_poses_is_refused_because_their_size_is_not_known(project: Path, tmp_path: Path, capsys) -> None:
    assert track(project, tmp_path / "out", "--set", "cameras.cam01.scale=true") == 1
    assert "camera cam01: scale: 2D poses do not state the size of their images; scale size and matrix" in capsys.readouterr().err


@pytest.mark.parametrize(("metres", "tall"), [(0.1, r"0\.1\d"), (3.28, r"(5\.9|6\.0)\d")], ids=["decimetres", "feet"])
def test_translations_in_another_unit_show_in_the_size_of_people(
    project: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], ring_rig: Callable[..., Rig], metres: float, tall: str
) -> None:
    rig = ring_rig(3)
    other = [SE3(camera.cam_from_world.wxyz, metres * camera.cam_from_world.xyz) for camera in rig]
    rig = replace(rig, cameras=tuple(replace(camera, cam_from_world=pose) for camera, pose in zip(rig, other, strict=True)))
    write_rig(project / "calibration" / "Calib_scene.toml", rig)
    assert track(project, tmp_path / "out") == 0
    assert re.search(rf"Calib_scene.toml: people are {tall} m tall by this calibration", capsys.readouterr().err)


def test_without_a_frame_rate_it_asks_for_one(project: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (project / CONFIG_FILE).unlink()
    assert track(project, tmp_path / "out") == 1
    error = capsys.readouterr().err
    assert "--rate" in error and "rate_hz" in error and "posefuse.toml" in error
    assert track(project, tmp_path / "out", "--rate", "25") == 0
    assert set(np.diff(read_recording(tmp_path / "out").poses.t_ns)) == {40_000_000}


def test_the_videos_next_to_them_state_the_rate(project: Path, tmp_path: Path, demo_session: Path) -> None:
    (project / CONFIG_FILE).unlink()
    (project / "videos").mkdir()
    (project / "videos" / "cam00.mp4").write_bytes((demo_session / "videos" / "cam00.mp4").read_bytes())
    assert track(project, tmp_path / "out", "--input", "pose2d") == 0
    (period,) = set(np.diff(read_recording(tmp_path / "out").poses.t_ns))
    from posefuse.sources import VideoConfig

    times = np.asarray(VideoConfig(demo_session / "videos" / "cam00.mp4", "cam00").build().times_ns())
    assert abs(period - np.median(np.diff(times))) < 1000


def test_a_table_per_camera_is_data_as_well(project: Path, tmp_path: Path, ring_rig: Callable[..., Rig]) -> None:
    columns = [(name, part) for name in SKELETONS["blazepose33"].keypoints for part in ("x", "y", "likelihood")]
    rng = np.random.default_rng(0)
    body = person()[:, HALPE.index("mid_hip")][:, None] + rng.normal(0, 0.3, (33, 3))
    for camera in ring_rig(3):
        for file in (project / "pose" / f"{camera.name}_json").iterdir():
            file.unlink()
        (project / "pose" / f"{camera.name}_json").rmdir()
        with (project / "pose" / f"{camera.name}.csv").open("w", newline="") as file:
            rows = csv.writer(file)
            rows.writerow(["scorer", *(["net"] * len(columns))])
            rows.writerows([title, *(column[i] for column in columns)] for i, title in enumerate(("bodyparts", "coords")))
            for i, xy in enumerate(camera.project(body)):
                rows.writerow([i, *np.concatenate([xy, np.full((33, 1), 0.9)], axis=-1).ravel().tolist()])
    assert track(project, tmp_path / "out", "--raw") == 0
    poses = read_recording(tmp_path / "out").poses
    assert poses.skeleton.name == "blazepose33"
    assert np.nanmedian(np.linalg.norm(poses.xyz_world[:, 0] - body, axis=-1)) < 1e-3


def test_hands_and_face_reach_3d_and_every_file(project: Path, tmp_path: Path, ring_rig: Callable[..., Rig]) -> None:
    whole = SKELETONS["coco_wholebody_133"]
    body = {name: person()[0, k] for k, name in enumerate(HALPE.keypoints)}
    rng = np.random.default_rng(0)
    rest = []
    for name in whole.keypoints:
        # what the body lacks lies about its wrist, or in front of its nose
        hand = any(part in name for part in ("hand", "thumb", "index", "middle", "ring", "pinky"))
        about = body[f"{name.partition('_')[0]}_wrist"] if hand else body["nose"]
        rest.append(body.get(name, about + rng.uniform(-0.06, 0.06, 3)))
    xyz = np.array(rest) + np.arange(FRAMES)[:, None, None] * [0.02, 0, 0]
    write_poses(project, ring_rig(3), xyz)
    out = tmp_path / "out"
    assert track(project, out, outputs="trc,c3d") == 0
    poses = read_recording(out).poses
    assert poses.skeleton == whole
    assert np.nanmedian(np.linalg.norm(poses.xyz_world[:, 0] - xyz, axis=-1)) < 0.002
    assert np.isfinite(poses.xyz_world).all()
    for name in ("pose.trc", "pose.c3d"):
        tracks = read_tracks(out / name)
        places = [tracks.points.index(plain_name(keypoint)) for keypoint in whole.keypoints]
        # a file keeps tenths of millimetres
        np.testing.assert_allclose(tracks.xyz_m[:, places], poses.xyz_world[:, 0], atol=2e-4, err_msg=name)
    from posefuse.core.palette import LEFT, RIGHT
    from posefuse.outputs.drawing import bone_colours

    colours = dict(zip(whole.bones, bone_colours(whole), strict=True))
    assert colours["left_hand_root", "left_index1"] == LEFT.image_rgb and colours["right_ring2", "right_ring3"] == RIGHT.image_rgb


@pytest.mark.parametrize(
    ("frames", "start_s", "words"),
    [
        ({"cam00": [1], "cam01": [20261122153000]}, 0.0, "frame numbers 1 to 20261122153000: 2.026e+13 time steps"),
        ({"cam00": range(40), "cam01": range(20)}, 0.0, "warning: camera cam01: it stops at 0.63 s, the recording at 1.30 s"),
        ({"cam00": range(90), "cam01": [*range(15), *range(70, 90)]}, 0.5, "cam01: 73% of its frames cannot be read (55 of 75)"),
    ],
    ids=["numbered by date", "truncated", "a part is missing, from --start on"],
)
def test_what_the_numbers_of_openpose_files_show_is_named(frames, start_s, words, demo_session, tmp_path, capsys) -> None:
    for camera, numbers in frames.items():
        write_openpose(tmp_path / "session" / "pose2d" / camera, dict.fromkeys(numbers, np.full((1, 17, 2), [300.0, 200.0])))
    (tmp_path / "session" / "rig.toml").write_bytes((demo_session / "rig.toml").read_bytes())
    out, options = tmp_path / "out", ("--outputs", "", "--rate", "30", "--start", f"{start_s}")
    main(["track", str(tmp_path / "session"), "--out", str(out), *options])
    assert words in " ".join(capsys.readouterr().err.split())


# --- settings: every default once, every wrong key or value one line that says what is allowed


def test_overrides_replace_values_of_the_file(tmp_path: Path) -> None:
    path = tmp_path / "posefuse.toml"
    path.write_text('start_s = 1.5\n[fuse]\nweights = "score"\n[cameras.left]\noffset_s = 0.02\n')
    config = read_config(path, changes_of(["fuse.score_threshold=0.3", "end_s=4", "cameras.right.video=a b.mp4"]))
    assert (config.start_s, config.end_s) == (1.5, 4.0)
    assert (config.fuse.weights, config.fuse.score_threshold) == ("score", 0.3)
    assert config.cameras["left"].offset_s == 0.02
    assert config.cameras["right"].video == "a b.mp4"
    assert read_config(None) == TrackConfig()


@pytest.mark.parametrize(
    ("overrides", "parts"),
    [
        (["colour=red"], ["unknown key 'colour'", "fuse"]),
        (["fuse.weight=all"], ["unknown key 'fuse.weight'", "weights", "score_threshold"]),
        (["fuse.weights=best"], ["fuse.weights", "'best'", "robust"]),
        (["cameras.left.vid=a"], ["unknown key 'cameras.left.vid'", "video"]),
        (["rate_hz=-5"], ["rate_hz", "greater than or equal to 0.001", "-5"]),
        (["rate_hz=1e9"], ["rate_hz"]),
        (["rate_hz=nan"], ["rate_hz"]),
        (["cameras.a.offset_s=1e12"], ["offset_s"]),
        (["end_s=inf"], ["end_s"]),
        (["rate_hz"], ["expected KEY=VALUE"]),
        (["start_s=1", "start_s.more=2"], ["start_s is a value"]),
        (["outputs=trc"], ["outputs: expected names, such as", '["trc", "csv"]', "'trc'"]),
    ],
)
def test_a_wrong_setting_names_itself_and_what_is_allowed(overrides: list[str], parts: list[str]) -> None:
    message = refusal(ConfigError, "", lambda: read_config(None, changes_of(overrides)))
    for part in parts:
        assert part in message


def test_a_broken_file_is_named(tmp_path: Path) -> None:
    path = tmp_path / "posefuse.toml"
    path.write_text("fuse = [")
    refusal(ConfigError, r"posefuse\.toml: cannot be parsed as TOML", read_config, path)
    refusal(ConfigError, "no such file", read_config, tmp_path / "none.toml")


def test_a_model_card_in_a_settings_file_lies_next_to_it(tmp_path: Path) -> None:
    path = tmp_path / "posefuse.toml"
    path.write_text('[detector]\nname = "onnx"\n[detector.options]\ncard = "rtmpose.toml"\n')
    assert read_config(path).detector.options["card"] == str(tmp_path / "rtmpose.toml")
    assert settings_by_key(path)["detector.options.card"] == str(tmp_path / "rtmpose.toml")
    assert read_config(None, {"detector.options.card": "a.toml"}).detector.options["card"] == "a.toml"


def test_an_output_takes_options_by_name_and_a_wrong_one_is_refused_before_work(tmp_path: Path) -> None:
    path = tmp_path / "posefuse.toml"
    path.write_text("[outputs.overlay]\nwidth_px = 320\n[outputs.trc]\n")
    csv_too = {"outputs": ("csv", "overlay")}

    def read(file: Path | None, changes: dict[str, Any] | None = None) -> dict[str, object]:
        return read_config(file, changes or {}).outputs

    width = {**read(None), "overlay": {"width_px": 320}}
    assert read(None, {"outputs.overlay.width_px": 320}) == width
    assert read(path) == {"overlay": {"width_px": 320}, "trc": {}}
    # one that the file describes keeps its description where the outputs are named again, and a key adds to it
    assert read(path, csv_too) == {"csv": {}, "overlay": {"width_px": 320}}
    assert read(path, {**csv_too, "outputs.overlay.height_px": 240})["overlay"] == {"width_px": 320, "height_px": 240}
    assert changed_config(TrackConfig(), {"outputs": ("trc",), "outputs.csv.x": 1}).outputs == {"trc": {}, "csv": {"x": 1}}
    sink = build_sinks(read(path, csv_too))[1]
    assert sink.width_px == 320
    for wrong, line in (
        ({"overlay": {"width": 3}}, "outputs overlay: unknown key 'width'; there are:"),
        ({"hight": {}}, "no plug-in 'hight' among outputs; there are:"),
    ):
        refusal(ConfigError, line, build_sinks, wrong)
