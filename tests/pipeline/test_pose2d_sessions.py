"""Sessions of other tools' 2D poses: a whole Pose2Sim project by one command, and no frame rate out of thin air."""

import csv
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from built import standing
from studies import write_openpose

from posefuse.cli.main import main
from posefuse.core import SE3, SKELETONS, Rig
from posefuse.evaluation.tracks import plain_name, read_tracks
from posefuse.formats.recording import read_recording
from posefuse.formats.rig import write_rig

HALPE = SKELETONS["halpe_26"]
FRAMES = 14
MIDDLE = {"head": (0, 0, 1.8), "neck": (0, 0, 1.5), "mid_hip": (0, 0, 0.95)}


def person() -> np.ndarray:
    """(T, K, 3) a person who glides along x."""
    return standing(skeleton=HALPE, **MIDDLE) + np.arange(FRAMES)[:, None, None] * [0.02, 0, 0]


@pytest.fixture
def project(ring_rig: Callable[..., Rig], tmp_path: Path) -> Path:
    """A Pose2Sim project: Config.toml, calibration/ and pose/, as its own pose estimation leaves it."""
    rig = ring_rig(3)
    folder = tmp_path / "project"
    (folder / "calibration").mkdir(parents=True)
    write_rig(folder / "calibration" / "Calib_scene.toml", rig)
    write_poses(folder, rig, person())
    (folder / "Config.toml").write_text('[project]\nframe_rate = 50\n[pose]\npose_model = "Body_with_feet"\n')
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


def test_a_trial_of_a_session_uses_the_calibration_above_it(project: Path, tmp_path: Path) -> None:
    trial = project / "Trial_1"
    trial.mkdir()
    (project / "pose").rename(trial / "pose")
    assert track(trial, tmp_path / "out") == 0
    assert set(np.diff(read_recording(tmp_path / "out").poses.t_ns)) == {20_000_000}


def test_without_a_frame_rate_it_asks_for_one(project: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (project / "Config.toml").write_text('[project]\nframe_rate = "auto"\n')
    assert track(project, tmp_path / "out") == 1
    error = capsys.readouterr().err
    assert "--rate" in error and "rate_hz" in error and "posefuse.toml" in error
    assert track(project, tmp_path / "out", "--rate", "25") == 0
    assert set(np.diff(read_recording(tmp_path / "out").poses.t_ns)) == {40_000_000}


def test_the_videos_next_to_them_state_the_rate(project: Path, tmp_path: Path, demo_session: Path) -> None:
    (project / "Config.toml").unlink()
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
    assert track(project, out, outputs="trc,c3d,csv") == 0
    poses = read_recording(out).poses
    assert poses.skeleton == whole
    assert np.nanmedian(np.linalg.norm(poses.xyz_world[:, 0] - xyz, axis=-1)) < 0.002
    assert np.isfinite(poses.xyz_world).all()
    for name in ("pose.trc", "pose.c3d", "pose.csv"):
        tracks = read_tracks(out / name)
        places = [tracks.points.index(plain_name(keypoint)) for keypoint in whole.keypoints]
        # a file keeps tenths of millimetres
        np.testing.assert_allclose(tracks.xyz_m[:, places], poses.xyz_world[:, 0], atol=2e-4, err_msg=name)
    from posefuse.core.palette import LEFT, RIGHT
    from posefuse.outputs.drawing import bone_colours

    colours = dict(zip(whole.bones, bone_colours(whole), strict=True))
    assert colours["left_hand_root", "left_index1"] == LEFT.image_rgb and colours["right_ring2", "right_ring3"] == RIGHT.image_rgb


@pytest.mark.parametrize(
    ("frames", "words"),
    [
        ({"cam00": [1], "cam01": [20261122153000]}, "frame numbers 1 to 20261122153000: 2.026e+13 time steps"),
        ({"cam00": range(40), "cam01": range(20)}, "warning: camera cam01: it stops at 0.63 s, the recording at 1.30 s"),
    ],
    ids=["numbered by date", "truncated"],
)
def test_what_the_numbers_of_openpose_files_show_is_named(frames: dict, words: str, demo_session, tmp_path, capsys) -> None:
    for camera, numbers in frames.items():
        write_openpose(tmp_path / "session" / "pose2d" / camera, dict.fromkeys(numbers, np.full((1, 17, 2), [300.0, 200.0])))
    (tmp_path / "session" / "rig.toml").write_bytes((demo_session / "rig.toml").read_bytes())
    main(["track", str(tmp_path / "session"), "--out", str(tmp_path / "out"), "--outputs", "", "--rate", "30"])
    assert words in capsys.readouterr().err
