"""A session of which one video is damaged: tracked as far as it goes, and `posefuse track` names the camera."""

import json
import shutil
from pathlib import Path

import pytest
from commands import as_options, oracle
from videos import remuxed

from posefuse.cli.main import main

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
def test_a_camera_with_a_damaged_video_is_named_with_its_missing_share(
    session: Path, demo_session: Path, capsys: pytest.CaptureFixture[str], damage
) -> None:
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
