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
from posefuse.detection.card import read_card
from posefuse.detection.download import member_of
from posefuse.evaluation.tracks import read_tracks
from posefuse.formats.c3d import C3dData, read_c3d, write_c3d
from posefuse.formats.pose2d import read_openpose_folder, read_pose2d
from posefuse.formats.recording import read_recording, write_recording
from posefuse.formats.rig import read_rig, write_rig
from posefuse.formats.trc import TrcData, read_trc, write_trc
from posefuse.formats.truth import read_truth
from posefuse.formats.video import VideoWriter
from posefuse.pipeline.config import read_config
from posefuse.sources import ImagesConfig, VideoConfig
from posefuse.tracking.warm_up import made_up_person
from posefuse_sim.scene import read_scene

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
    """A valid folder and the file in it that is damaged: `make` fills the folder, `read` reads the file; None: a command does."""

    file: str
    make: Callable[[Path], object]
    read: Callable[[Path], object] | None = None


# points that move: (T,) seconds and (T, K, 3) metres
T_S = np.arange(40) / 30
_START = np.array([[0, 0.2, 1.4], [0, -0.2, 1.4], [0, 0.15, 0.9], [0, -0.15, 0.9], [0, 0.15, 0.5]])
XYZ = _START + np.sin(3 * T_S[:, None, None] + np.arange(15).reshape(5, 3)) * 0.2 + T_S[:, None, None] * [1.0, 0, 0]


def _copied(source: Path, read: Callable[[Path], object]) -> Example:
    return Example(source.name, lambda folder: shutil.copyfile(source, folder / source.name), read)


def _trc(folder: Path, name: str = "a.trc") -> None:
    write_trc(folder / name, TrcData(names=NAMES, t_s=T_S, xyz_world=XYZ, rate_hz=30.0))


def _compared(make: Callable[[Path], object]) -> Callable[[Path], object]:
    """With a file of the same points that is not damaged."""
    return lambda folder: (make(folder), _trc(folder, "sound.trc"))


def _c3d(folder: Path) -> None:
    points = {"names": NAMES, "xyz_world": XYZ, "sigma_m": np.full(XYZ.shape[:2], 0.01), "rate_hz": 30.0}
    angles = {"angle_names": ("knee",), "angle_rad": np.zeros((len(XYZ), 1, 3))}
    write_c3d(folder / "a.c3d", C3dData(**points, **angles))


def _csv(folder: Path) -> None:
    lines = ["t_s," + ",".join(f"{name}_{axis}" for name in NAMES for axis in "xyz")]
    lines += [f"{t:.4f}," + ",".join(f"{v:.4f}" for v in row.ravel()) for t, row in zip(T_S, XYZ, strict=True)]
    (folder / "a.csv").write_text("\n".join(lines) + "\n")


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


def _mcap(folder: Path) -> None:
    from posefuse_ros.mcap_output import McapSink

    inside = folder / "result"
    inside.mkdir()
    _recording(inside)
    [path] = McapSink().build().write(read_recording(inside), folder)
    path.rename(folder / "a.mcap")
    shutil.rmtree(inside)


def _read_frames(source: VideoConfig | ImagesConfig) -> None:
    opened = source.build()
    opened.times_ns()
    list(opened.frames())


def _read_images(path: Path) -> None:
    _read_frames(ImagesConfig(path.parent, "cam", rate_hz=30.0))


def _read_result(path: Path) -> None:
    read_recording(path.parent)


def _read_pose2d(path: Path) -> None:
    read_pose2d(path, "cam").frame(0, 0)


def _read_openpose(path: Path) -> None:
    list(read_openpose_folder(path.parent, "cam00").frames(30.0))


def _unpacked(card: str) -> Callable[[Path], object]:
    return lambda archive: member_of(archive, read_card(card).source, len(NETWORK))


def _read_mcap(path: Path) -> None:
    from posefuse_ros import bags

    bags.read_rig(path)
    list(bags.read_mcap(path))


EXAMPLES: dict[str, Example] = {
    "rig TOML": _copied(GOLDEN / "rig.toml", read_rig),
    "rig caliscope": _copied(GOLDEN / "camera_array.toml", read_rig),
    "rig Qualisys": _copied(GOLDEN / "rig.qca.txt", read_rig),
    "scene YAML": _copied(DEMO / "scene.yaml", read_scene),
    "posefuse.toml": Example("posefuse.toml", openpose_session, read_config),
    "model card TOML": _copied(ROOT / "src" / "posefuse" / "detection" / "cards" / "blazepose_full.toml", read_card),
    "TRC": Example("a.trc", _trc, read_trc),
    "C3D": Example("a.c3d", _c3d, read_c3d),
    "CSV": Example("a.csv", _csv, read_tracks),
    "recording.npz": Example("recording.npz", _recording, _read_result),
    "recording.json": Example("recording.json", _recording, _read_result),
    "truth.npz": _copied(DEMO / "truth" / "truth.npz", read_truth),
    "MP4": Example("a.mp4", _video, lambda path: _read_frames(VideoConfig(path, "cam"))),
    "image": Example("002.jpg", _images, _read_images),
    "timestamps.csv": Example("timestamps.csv", _images, _read_images),
    "OpenPose JSON": Example("pose2d/cam00_json/cam_000000000002_keypoints.json", openpose_session, _read_openpose),
    "AlphaPose JSON": Example("alphapose-results.json", WRITERS["coco of alphapose"][0], _read_pose2d),
    "COCO JSON": Example("results.json", WRITERS["coco"][0], _read_pose2d),
    "MMPose JSON": Example("cam.json", WRITERS["mmpose"][0], _read_pose2d),
    "DeepLabCut CSV": Example("camDLC.csv", WRITERS["deeplabcut"][0], _read_pose2d),
    "wheel": Example("mediapipe-0.10.21-x.whl", _wheel, _unpacked("blazepose_full")),
    "npm package": Example("mediapipe-pose-0.5.1675469404.tgz", _npm, _unpacked("blazepose_heavy")),
    "MCAP": Example("a.mcap", _mcap, _read_mcap),
    "compare TRC": Example("a.trc", _compared(_trc)),
    "compare C3D": Example("a.c3d", _compared(_c3d)),
    "compare CSV": Example("a.csv", _compared(_csv)),
    "report, recording": Example("recording.npz", _recording),
    "report, rig": Example("rig.toml", _recording),
    "export, observations": Example("observations.npz", _recording),
    "solve, result": Example("observations.npz", _recording),
    "track, OpenPose": Example("pose2d/cam01_json/cam_000000000003_keypoints.json", openpose_session),
    "track, rig": Example("rig.toml", openpose_session),
    "track, settings": Example("posefuse.toml", openpose_session),
    "track, MP4": Example("videos/cam01.mp4", _demo_session),
}
