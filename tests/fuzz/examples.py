"""One small valid file or folder of every kind, and the function that reads it. The fuzz stage damages these."""

from __future__ import annotations

import shutil
import sys
import tarfile
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from posefuse.core.skeleton import BODY_25
from posefuse.formats.bvh import BvhData, write_bvh
from posefuse.formats.c3d import C3dData, write_c3d
from posefuse.formats.mot import MotTable, write_mot
from posefuse.formats.recording import read_recording, write_recording
from posefuse.formats.rig import read_rig, write_rig
from posefuse.formats.trc import TrcData, write_trc
from posefuse.formats.video import VideoWriter
from posefuse.tracking.stand_in import made_up_person

ROOT = Path(__file__).resolve().parents[2]
# the writers of other tools' formats that their own tests use
sys.path += [str(ROOT / "tests" / "formats" / "pose2d"), str(ROOT / "tests" / "support"), str(ROOT / "tools")]
import built  # noqa: E402
from studies import write_openpose  # noqa: E402
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


# points that move: (T,) seconds and (T, K, 3) metres
T_S = np.arange(40) / 30
_START = np.array([[0, 0.2, 1.4], [0, -0.2, 1.4], [0, 0.15, 0.9], [0, -0.15, 0.9], [0, 0.15, 0.5]])
XYZ = _START + np.sin(3 * T_S[:, None, None] + np.arange(15).reshape(5, 3)) * 0.2 + T_S[:, None, None] * [1.0, 0, 0]


def _copied(source: Path) -> Callable[[Path], object]:
    return lambda folder: shutil.copyfile(source, folder / source.name)


def _trc(folder: Path, name: str = "a.trc") -> None:
    write_trc(folder / name, TrcData(names=NAMES, t_s=T_S, xyz_world=XYZ, rate_hz=30.0))


def _compared(make: Callable[[Path], object]) -> Callable[[Path], object]:
    """With a file of the same points that is not damaged."""
    return lambda folder: (make(folder), _trc(folder, "sound.trc"))


def _c3d(folder: Path) -> None:
    points = {"names": NAMES, "xyz_world": XYZ, "sigma_m": np.full(XYZ.shape[:2], 0.01), "rate_hz": 30.0}
    angles = {"angle_names": ("knee",), "angle_rad": np.zeros((len(XYZ), 1, 3))}
    write_c3d(folder / "a.c3d", C3dData(**points, **angles, about={"VERSION": "1"}))


def _bvh(folder: Path) -> None:
    offset = np.array([[0, 0, 0], [0, 0.5, 0], [0, 0.5, 0.0]])
    bones = {"names": ("hips", "knee", "knee_end"), "parent": np.array([-1, 0, 1]), "offset": offset}
    motion = {"rotation": [np.tile(np.eye(3), (5, 1, 1))] * 3, "position": [np.tile(one, (5, 1)) for one in offset]}
    write_bvh(folder / "a.bvh", BvhData(**bones, **motion, frame_s=0.02))


def _mot(folder: Path) -> None:
    angles = MotTable(name="angles", t_s=np.arange(5) / 10, columns=("hip", "knee"), values=np.ones((5, 2)), in_degrees=True)
    write_mot(folder / "a.mot", angles)


def _wide_csv(folder: Path) -> None:
    lines = ["t_s," + ",".join(f"{name}_{axis}" for name in NAMES for axis in "xyz")]
    lines += [f"{t:.4f}," + ",".join(f"{v:.4f}" for v in row.ravel()) for t, row in zip(T_S, XYZ, strict=True)]
    (folder / "a.csv").write_text("\n".join(lines) + "\n")


def _long_csv(folder: Path) -> None:
    lines = ["t_s,person,keypoint,x_m,y_m,z_m"]
    for t, row in zip(T_S, XYZ, strict=True):
        points = [f"{name},{x:.4f},{y:.4f},{z:.4f}" for name, (x, y, z) in zip(NAMES, row, strict=True)]
        lines += [f"{t:.4f},{person},{point}" for person in (0, 3) for point in points]
    (folder / "a.csv").write_text("\n".join(lines) + "\n")


def _mvnx(folder: Path) -> None:
    labels = ("Pelvis", "RightUpperLeg", "RightLowerLeg", "T8")
    segments = "".join(f'<segment label="{label}" id="{i + 1}"/>' for i, label in enumerate(labels))
    frames = "".join(
        f'<frame time="{i * 10}" type="normal"><position>{" ".join(str(i + j) for j in range(12))}</position></frame>'
        for i in range(12)
    )
    (folder / "a.mvnx").write_text(f"<mvnx><subject><segments>{segments}</segments><frames>{frames}</frames></subject></mvnx>")


def _recording(folder: Path) -> None:
    poses = built.poses(np.resize(XYZ[:8, None], (8, 1, 17, 3)), rate_hz=30.0)
    write_recording(folder, built.recording(read_rig(DEMO / "rig.toml"), poses, made="by the fuzz stage"))


def _video(folder: Path) -> None:
    with VideoWriter(folder / "a.mp4", (64, 48), 30.0, 23) as writer:
        for i in range(30):
            writer.write(np.full((48, 64, 3), 5 * i, np.uint8), i * 33_333_333)


def _images(folder: Path) -> None:
    for i in range(4):
        cv2.imwrite(str(folder / f"{i:03d}.jpg"), np.full((48, 64, 3), 40 * i, np.uint8))
    (folder / "timestamps.csv").write_text("file,t_s\n" + "".join(f"{i:03d}.jpg,{i / 30}\n" for i in range(4)))


def openpose_session(folder: Path) -> None:
    """Two cameras of the bundled clip as OpenPose JSON of a walking person, with a settings file."""
    rig = read_rig(DEMO / "rig.toml").only(("cam00", "cam01"))
    write_rig(folder / "rig.toml", rig)
    (folder / "posefuse.toml").write_text('rate_hz = 30.0\nraw = true\noutputs = ["csv"]\n[cameras.cam00]\noffset_s = 0.0\n')
    person = made_up_person(BODY_25)
    for camera in rig:
        frames = {i: np.nan_to_num(camera.project(person + [0.02 * i, 0, 0]))[None] for i in range(6)}
        write_openpose(folder / "pose2d" / f"{camera.name}_json", frames)


def _demo_session(folder: Path) -> None:
    (folder / "videos").mkdir()
    for file in ("rig.toml", "videos/cam00.mp4", "videos/cam01.mp4"):
        shutil.copyfile(DEMO / file, folder / file)


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
    [path] = McapSink().build().write(read_recording(inside), folder)
    path.rename(folder / "a.mcap")
    shutil.rmtree(inside)


CARDS = ROOT / "src" / "posefuse" / "detection" / "cards"
EXAMPLES: dict[str, Example] = {
    "rig TOML": Example("rig.toml", _copied(GOLDEN / "rig.toml")),
    "rig caliscope": Example("camera_array.toml", _copied(GOLDEN / "camera_array.toml")),
    "rig Qualisys": Example("rig.qca.txt", _copied(GOLDEN / "rig.qca.txt")),
    "rig OpenCV YAML": Example("rig.yaml", _copied(GOLDEN / "rig.yaml")),
    "rig OpenCV JSON": Example("rig.json", _copied(GOLDEN / "rig.json")),
    "rig ROS": Example("cam_0.yaml", _copied(GOLDEN / "rig_ros" / "cam_0.yaml")),
    "scene YAML": Example("scene.yaml", _copied(DEMO / "scene.yaml")),
    "posefuse.toml": Example("posefuse.toml", openpose_session),
    "floor points TOML": Example("a.toml", _floor),
    "model card TOML": Example("blazepose_full.toml", _copied(CARDS / "blazepose_full.toml")),
    "TRC": Example("a.trc", _trc),
    "C3D": Example("a.c3d", _c3d),
    "BVH": Example("a.bvh", _bvh),
    "MOT": Example("a.mot", _mot),
    "CSV wide": Example("a.csv", _wide_csv),
    "CSV long": Example("a.csv", _long_csv),
    "MVNX": Example("a.mvnx", _mvnx),
    "recording.npz": Example("recording.npz", _recording),
    "recording.json": Example("recording.json", _recording),
    "truth.npz": Example("truth.npz", _copied(DEMO / "truth" / "truth.npz")),
    "MP4": Example("a.mp4", _video),
    "image": Example("002.jpg", _images),
    "timestamps.csv": Example("timestamps.csv", _images),
    "OpenPose JSON": Example("pose2d/cam00_json/cam_000000000002_keypoints.json", openpose_session),
    "AlphaPose JSON": Example("alphapose-results.json", WRITERS["alphapose"][0]),
    "COCO JSON": Example("results.json", WRITERS["coco"][0]),
    "MMPose JSON": Example("cam.json", WRITERS["mmpose"][0]),
    "DeepLabCut CSV": Example("camDLC.csv", WRITERS["deeplabcut"][0]),
    "wheel": Example("mediapipe-0.10.21-x.whl", _wheel),
    "npm package": Example("mediapipe-pose-0.5.1675469404.tgz", _npm),
    "MCAP": Example("a.mcap", _mcap),
    "compare TRC": Example("a.trc", _compared(_trc)),
    "compare C3D": Example("a.c3d", _compared(_c3d)),
    "compare CSV": Example("a.csv", _compared(_wide_csv)),
    "report, recording": Example("recording.npz", _recording),
    "report, rig": Example("rig.toml", _recording),
    "export, observations": Example("observations.npz", _recording),
    "solve, result": Example("observations.npz", _recording),
    "track, OpenPose": Example("pose2d/cam01_json/cam_000000000003_keypoints.json", openpose_session),
    "track, rig": Example("rig.toml", openpose_session),
    "track, settings": Example("posefuse.toml", openpose_session),
    "track, MP4": Example("videos/cam01.mp4", _demo_session),
}
