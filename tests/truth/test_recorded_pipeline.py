"""The whole recorded pipeline through its one seam, the command line, against the truth of the bundled clip."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import as_options, figures, oracle
from videos import remuxed

from posefuse.cli.main import main
from posefuse.core import Kind, PoseSequence, Truth
from posefuse.evaluation.metrics import joint_errors, typical_nees
from posefuse.formats.recording import read_recording
from posefuse.formats.truth import read_truth
from posefuse.foundation.output_folder import MARK_FILE

pytestmark = pytest.mark.usefixtures("models")
LIMBS = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")


def test_the_clip_is_tracked_to_its_truth_and_every_file_is_there(demo_session: Path, tmp_path: Path, capsys) -> None:
    out = tmp_path / "result"
    got = figures(capsys, "track", demo_session, "--out", out, "--end", 2.0)
    assert (got["cameras"], got["time_steps"], got["people"]) == (4, 61, 1)
    assert min(one["seen"] for one in got["camera_fits"].values()) > 0.98
    assert got["mpjpe_mm"] < 1.1 * 12.1  # `make demo` prints 12.1 or 12.2, by the processor
    assert sorted(path.name for path in out.iterdir()) == sorted([*got["files"], MARK_FILE])
    assert {"pose.trc", "pose.c3d", "pose.csv", "overlay.mp4", "overview.png"} <= set(got["files"])
    recording = read_recording(out)
    assert recording.provenance["rig_id"] == recording.rig.id
    assert recording.provenance["config"]["fuse"]["weights"] == "robust"
    assert (recording.poses.kind == Kind.SMOOTHED).mean() > 0.95
    truth = read_truth(demo_session / "truth" / "truth.npz")
    assert joint_errors(recording.poses, truth).mpjpe_mm == pytest.approx(got["mpjpe_mm"])
    stated = [stated_against(truth, replace(recording.poses, cov_world=k * recording.poses.cov_world)) for k in (1, 4, 1 / 4)]
    assert stated[1] < 0.9 < stated[0] < 3.6 < stated[2]  # 3 is right; a covariance four times as large, or as small, is noticed


def stated_against(truth: Truth, poses: PoseSequence) -> float:
    return typical_nees(poses, truth, [f"{side}_{joint}" for side in ("left", "right") for joint in LIMBS])


def test_a_part_of_the_recording_at_another_rate_without_smoothing(demo_session: Path, tmp_path: Path, capsys) -> None:
    out = tmp_path / "result"
    options = ("--start", 1.0, "--end", 1.5, "--raw", "--set", "rate_hz=15", "--weights", "score", "--outputs", "")
    got = figures(capsys, "track", demo_session, "--out", out, *options)
    poses = read_recording(out).poses
    assert got["time_steps"] == len(poses) == 8
    assert np.allclose(np.diff(poses.t_ns) * 1e-9, 1 / 15, atol=1e-6)
    assert poses.t_ns[0] == pytest.approx(1e9, abs=1e8)
    assert set(np.unique(poses.kind)) <= {Kind.FUSED, Kind.MISSING}


@pytest.fixture
def broken_session(demo_session: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(demo_session, tmp_path / "session"))


def first_frames(session: Path, out: Path, capsys) -> tuple[int, str]:
    code = main(["track", str(session), "--out", str(out), "--end", "0.4", "--outputs", ""])
    return code, capsys.readouterr().err


def test_a_camera_that_cannot_be_read_is_left_out_and_named(broken_session: Path, tmp_path: Path, capsys) -> None:
    (broken_session / "videos" / "cam01.mp4").write_bytes(b"not a video")
    code, said = first_frames(broken_session, tmp_path / "result", capsys)
    assert code == 0
    assert "cam01.mp4: camera cam01" in said and "continues without camera cam01" in said
    assert read_recording(tmp_path / "result").rig.names == ("cam00", "cam02", "cam03")


@pytest.mark.parametrize("left", [0, 1])
def test_too_few_readable_cameras_are_an_error_and_leave_nothing(broken_session: Path, tmp_path: Path, capsys, left: int) -> None:
    for i in range(left, 4):
        (broken_session / "videos" / f"cam0{i}.mp4").write_bytes(b"not a video")
    code, said = first_frames(broken_session, tmp_path / "result", capsys)
    assert code == 1
    assert f"at least 2 cameras that can be read, got {left}" in said.splitlines()[-1]
    assert [said.count(f"cam0{i}.mp4") for i in range(4)] == [int(i >= left) for i in range(4)]
    assert not list(tmp_path.glob("result*"))


def test_videos_of_another_size_are_an_error_with_both_sizes(broken_session: Path, tmp_path: Path, capsys) -> None:
    rig = broken_session / "rig.toml"
    text = rig.read_text()
    assert "640" in text
    rig.write_text(text.replace("640", "700"))
    code, said = first_frames(broken_session, tmp_path / "result", capsys)
    assert code == 1
    assert "640x480" in said and "700x480" in said and "crop" in said
    assert not list(tmp_path.glob("result*"))


# --- a video is damaged: tracked as far as it goes, and the camera is named


CAMERA, OTHERS = "cam01", ("cam00", "cam02", "cam03")


@pytest.fixture
def session(demo_session: Path, tmp_path: Path) -> Path:
    """The first second of the bundled clip, the index of every video at its start, as cameras for the web write it."""
    folder = tmp_path / "session"
    (folder / "videos").mkdir(parents=True)
    shutil.copyfile(demo_session / "rig.toml", folder / "rig.toml")
    for camera in (CAMERA, *OTHERS):
        source, target = (place / "videos" / f"{camera}.mp4" for place in (demo_session, folder))
        remuxed(source, target, frames=30, options={"movflags": "faststart"})
    return folder


def frames_start(video: bytes) -> int:
    return video.index(b"mdat") + 4


def cut(video: bytes) -> bytes:
    """Copied to a disk that was full: the index lists every frame, the bytes of the later half are missing."""
    return video[: (frames_start(video) + len(video)) // 2]


def corrupt(video: bytes) -> bytes:
    """A stretch of zeros where the disk lost blocks, from the middle to the end."""
    middle = (frames_start(video) + len(video)) // 2
    return video[:middle] + bytes(len(video) - middle)


@pytest.mark.parametrize("damage", [cut, corrupt])
def test_a_camera_with_a_damaged_video_is_named_with_its_missing_share(session, demo_session, capsys, damage) -> None:
    video = session / "videos" / f"{CAMERA}.mp4"
    video.write_bytes(damage(video.read_bytes()))
    words = ["track", str(session), "--out", str(session.with_name("result")), *as_options(oracle()), "--outputs", "", "--json"]
    assert main(words) == 0
    shown = capsys.readouterr()
    figures, said = json.loads(shown.out), shown.err
    [line] = [line for line in said.splitlines() if line.startswith("warning: ") and "cannot be read" in line]
    assert line.startswith(f"warning: camera {CAMERA}: ") and "% of its frames cannot be read (" in line
    assert "it stops at " in line
    assert figures["time_steps"] == 30, "the other cameras are tracked to their end"
    assert not any(f"camera {camera}" in said for camera in OTHERS)
