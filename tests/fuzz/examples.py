"""One small valid file or folder of every kind, and the function that reads it. The fuzz stage damages these."""

from __future__ import annotations

import json
import shutil
import sys
import tarfile
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from posefuse.core import Camera, Rig
from posefuse.core.skeleton import BODY_25
from posefuse.formats.bvh import BvhData, write_bvh
from posefuse.formats.c3d import C3dData, write_c3d
from posefuse.formats.mot import MotTable, write_mot
from posefuse.formats.recording import write_recording
from posefuse.formats.rig import read_rig, write_rig
from posefuse.formats.trc import TrcData, write_trc
from posefuse.formats.video import VideoWriter
from posefuse.tracking.stand_in import made_up_person

ROOT = Path(__file__).resolve().parents[2]
# the writers of other tools' formats that their own tests use
sys.path += [str(ROOT / "tests" / "formats" / "pose2d"), str(ROOT / "tests" / "support"), str(ROOT / "tools")]
import built  # noqa: E402
from test_formats import WRITERS  # noqa: E402

GOLDEN = ROOT / "tests" / "golden" / "files"
DEMO = ROOT / "examples" / "demo"
NETWORK = b"a network" * 100
NAMES = ("left_shoulder", "right_shoulder", "left_hip", "right_hip", "left_knee")


@dataclass(frozen=True)
class Example:
    """A valid folder and the file in it that is damaged. `make` fills a folder."""

    file: str
    make: Callable[[Path], object]


def walking(times: int = 40) -> tuple[np.ndarray, np.ndarray]:
    """(T,) seconds and (T, K, 3) metres of points that move."""
    t_s = np.arange(times) / 30
    start = np.array([[0, 0.2, 1.4], [0, -0.2, 1.4], [0, 0.15, 0.9], [0, -0.15, 0.9], [0, 0.15, 0.5]])
    return t_s, start + np.sin(3 * t_s[:, None, None] + np.arange(15).reshape(5, 3)) * 0.2 + t_s[:, None, None] * [1.0, 0, 0]


def _copied(source: Path, name: str) -> Callable[[Path], None]:
    return lambda folder: (folder / name).parent.mkdir(parents=True, exist_ok=True) or shutil.copyfile(source, folder / name)


def _trc(folder: Path) -> None:
    write_trc(folder / "a.trc", _trc_data())
    write_trc(folder / "sound.trc", _trc_data())


def _trc_data() -> TrcData:
    t_s, xyz = walking()
    return TrcData(names=NAMES, t_s=t_s, xyz_world=xyz, rate_hz=30.0)


def _c3d(folder: Path) -> None:
    xyz = walking()[1]
    about = {
        "names": NAMES,
        "xyz_world": xyz,
        "sigma_m": np.full(xyz.shape[:2], 0.01),
        "rate_hz": 30.0,
        "about": {"VERSION": "1"},
    }
    write_c3d(folder / "a.c3d", C3dData(**about, angle_names=("knee",), angle_rad=np.zeros((len(xyz), 1, 3))))
    write_trc(folder / "sound.trc", _trc_data())


def _bvh(folder: Path) -> None:
    rotation = [np.tile(np.eye(3), (5, 1, 1))] * 3
    offset = np.array([[0, 0, 0], [0, 0.5, 0], [0, 0.5, 0.0]])
    data = BvhData(
        names=("hips", "knee", "knee_end"),
        parent=np.array([-1, 0, 1]),
        offset=offset,
        frame_s=0.02,
        rotation=rotation,
        position=[np.tile(one, (5, 1)) for one in offset],
    )
    write_bvh(folder / "a.bvh", data)


def _mot(folder: Path) -> None:
    write_mot(
        folder / "a.mot",
        MotTable(name="angles", t_s=np.arange(5) / 10, columns=("hip", "knee"), values=np.ones((5, 2)), in_degrees=True),
    )


def _wide_csv(folder: Path) -> None:
    t_s, xyz = walking()
    lines = ["t_s," + ",".join(f"{name}_{axis}" for name in NAMES for axis in "xyz")]
    lines += [f"{t:.4f}," + ",".join(f"{v:.4f}" for v in row.ravel()) for t, row in zip(t_s, xyz, strict=True)]
    (folder / "a.csv").write_text("\n".join(lines) + "\n")
    write_trc(folder / "sound.trc", TrcData(names=NAMES, t_s=t_s, xyz_world=xyz, rate_hz=30.0))


def _long_csv(folder: Path) -> None:
    t_s, xyz = walking()
    lines = ["t_s,person,keypoint,x_m,y_m,z_m"]
    lines += [
        f"{t:.4f},{person},{name},{x:.4f},{y:.4f},{z:.4f}"
        for t, row in zip(t_s, xyz, strict=True)
        for person in (0, 3)
        for name, (x, y, z) in zip(NAMES, row, strict=True)
    ]
    (folder / "a.csv").write_text("\n".join(lines) + "\n")
    write_trc(folder / "sound.trc", TrcData(names=NAMES, t_s=t_s, xyz_world=xyz, rate_hz=30.0))


def _mvnx(folder: Path) -> None:
    labels = ("Pelvis", "RightUpperLeg", "RightLowerLeg", "T8")
    segments = "".join(f'<segment label="{label}" id="{i + 1}"/>' for i, label in enumerate(labels))
    frames = "".join(
        f'<frame time="{i * 10}" type="normal"><position>{" ".join(str(i + j) for j in range(12))}</position></frame>'
        for i in range(12)
    )
    (folder / "a.mvnx").write_text(f"<mvnx><subject><segments>{segments}</segments><frames>{frames}</frames></subject></mvnx>")


def _recording(folder: Path) -> None:
    rig, (t_s, xyz) = read_rig(DEMO / "rig.toml"), walking(8)
    poses = built.poses(np.resize(xyz[:, None], (8, 1, 17, 3)), t_ns=(t_s * 1e9).astype(np.int64))
    write_recording(folder, built.recording(rig, poses, made="by the fuzz stage"))


def _video(folder: Path) -> None:
    camera: Camera = read_rig(DEMO / "rig.toml").cameras[0]
    with VideoWriter(folder / "a.mp4", (64, 48), 30.0, 23) as writer:
        for i in range(30):
            writer.write(np.full((48, 64, 3), 5 * i, np.uint8), i * 33_333_333)
    assert camera.name


def _images(folder: Path) -> None:
    for i in range(4):
        cv2.imwrite(str(folder / f"{i:03d}.jpg"), np.full((48, 64, 3), 40 * i, np.uint8))
    (folder / "timestamps.csv").write_text("file,t_s\n" + "".join(f"{i:03d}.jpg,{i / 30}\n" for i in range(4)))


def openpose_session(folder: Path) -> None:
    """Two cameras of the bundled clip as OpenPose JSON of a walking person, with a settings file."""
    rig: Rig = read_rig(DEMO / "rig.toml").only(("cam00", "cam01"))
    write_rig(folder / "rig.toml", rig)
    (folder / "posefuse.toml").write_text('rate_hz = 30.0\nraw = true\noutputs = ["csv"]\n[cameras.cam00]\noffset_s = 0.0\n')
    person = made_up_person(BODY_25)
    for camera in rig:
        place = folder / "pose2d" / f"{camera.name}_json"
        place.mkdir(parents=True)
        for i in range(6):
            xy = camera.project(person + [0.02 * i, 0, 0])
            keypoints = np.concatenate([np.nan_to_num(xy), np.full((25, 1), 0.9)], axis=1).ravel().tolist()
            content = {"version": 1.3, "people": [{"pose_keypoints_2d": keypoints}]}
            (place / f"frame_{i:012d}_keypoints.json").write_text(json.dumps(content))


def _demo_session(folder: Path) -> None:
    shutil.copyfile(DEMO / "rig.toml", folder / "rig.toml")
    (folder / "videos").mkdir()
    for camera in ("cam00", "cam01"):
        shutil.copyfile(DEMO / "videos" / f"{camera}.mp4", folder / "videos" / f"{camera}.mp4")


def _wheel(folder: Path) -> None:
    with zipfile.ZipFile(folder / "mediapipe-0.10.21-x.whl", "w", zipfile.ZIP_DEFLATED) as wheel:
        wheel.writestr("mediapipe/modules/pose_landmark/pose_landmark_full.tflite", NETWORK)


def _npm(folder: Path) -> None:
    (folder / "network").write_bytes(NETWORK)
    with tarfile.open(folder / "mediapipe-pose-0.5.1675469404.tgz", "w:gz") as package:
        package.add(folder / "network", "package/pose_landmark_heavy.tflite")


def _floor(folder: Path) -> None:
    text = "origin_to_x_m = 1.5\n[cameras.cam01]\norigin = [812, 640]\nx = [1033, 655]\ny = [790, 501]\n"
    text += "[cameras.cam02]\norigin = [402, 610]\nx = [377, 655]\ny = [640, 571]\n"
    (folder / "a.toml").write_text(text)


def _mcap(folder: Path) -> None:
    from posefuse_ros.mcap_output import McapSink

    inside = folder / "result"
    inside.mkdir()
    _recording(inside)
    from posefuse.formats.recording import read_recording

    [path] = McapSink().build().write(read_recording(inside), folder)
    path.rename(folder / "a.mcap")
    shutil.rmtree(inside)


CARDS = ROOT / "src" / "posefuse" / "detection" / "cards"
EXAMPLES: dict[str, Example] = {
    "rig TOML": Example("rig.toml", _copied(GOLDEN / "rig.toml", "rig.toml")),
    "rig caliscope": Example("camera_array.toml", _copied(GOLDEN / "camera_array.toml", "camera_array.toml")),
    "rig Qualisys": Example("rig.qca.txt", _copied(GOLDEN / "rig.qca.txt", "rig.qca.txt")),
    "rig OpenCV YAML": Example("rig.yaml", _copied(GOLDEN / "rig.yaml", "rig.yaml")),
    "rig OpenCV JSON": Example("rig.json", _copied(GOLDEN / "rig.json", "rig.json")),
    "rig ROS": Example("cam_0.yaml", _copied(GOLDEN / "rig_ros" / "cam_0.yaml", "cam_0.yaml")),
    "scene YAML": Example("scene.yaml", _copied(DEMO / "scene.yaml", "scene.yaml")),
    "posefuse.toml": Example("posefuse.toml", openpose_session),
    "floor points TOML": Example("a.toml", _floor),
    "model card TOML": Example("a.toml", _copied(CARDS / "blazepose_full.toml", "a.toml")),
    "TRC": Example("a.trc", _trc),
    "C3D": Example("a.c3d", _c3d),
    "BVH": Example("a.bvh", _bvh),
    "MOT": Example("a.mot", _mot),
    "CSV wide": Example("a.csv", _wide_csv),
    "CSV long": Example("a.csv", _long_csv),
    "MVNX": Example("a.mvnx", _mvnx),
    "recording.npz": Example("recording.npz", _recording),
    "recording.json": Example("recording.json", _recording),
    "truth.npz": Example("truth.npz", _copied(DEMO / "truth" / "truth.npz", "truth.npz")),
    "MP4": Example("a.mp4", _video),
    "image": Example("002.jpg", _images),
    "timestamps.csv": Example("timestamps.csv", _images),
    "OpenPose JSON": Example("pose2d/cam00_json/frame_000000000002_keypoints.json", openpose_session),
    "AlphaPose JSON": Example("alphapose-results.json", WRITERS["alphapose"][0]),
    "COCO JSON": Example("results.json", WRITERS["coco"][0]),
    "MMPose JSON": Example("cam.json", WRITERS["mmpose"][0]),
    "DeepLabCut CSV": Example("camDLC.csv", WRITERS["deeplabcut"][0]),
    "wheel": Example("mediapipe-0.10.21-x.whl", _wheel),
    "npm package": Example("mediapipe-pose-0.5.1675469404.tgz", _npm),
    "MCAP": Example("a.mcap", _mcap),
    "compare TRC": Example("a.trc", _trc),
    "compare C3D": Example("a.c3d", _c3d),
    "compare CSV": Example("a.csv", _wide_csv),
    "report, recording": Example("recording.npz", _recording),
    "report, rig": Example("rig.toml", _recording),
    "export, observations": Example("observations.npz", _recording),
    "solve, result": Example("observations.npz", _recording),
    "track, OpenPose": Example("pose2d/cam01_json/frame_000000000003_keypoints.json", openpose_session),
    "track, rig": Example("rig.toml", openpose_session),
    "track, settings": Example("posefuse.toml", openpose_session),
    "track, MP4": Example("videos/cam01.mp4", _demo_session),
}
