"""A camera of which part cannot be read is named, with its share and where it stops."""

from pathlib import Path

import numpy as np
import pytest
from videos import ScriptedSource

from posefuse.formats.video import VideoWriter
from posefuse.sources import CountedSource, Coverage, VideoConfig, incomplete_cameras

PERIOD_NS = 40_000_000
FRAMES = 50


@pytest.fixture
def video(tmp_path: Path) -> Path:
    rng = np.random.default_rng(0)
    with VideoWriter(tmp_path / "cam.mp4", (64, 48), 25.0, 18) as writer:
        for i in range(FRAMES):
            writer.write(rng.integers(0, 255, (48, 64, 3), np.uint8), i * PERIOD_NS)
    return tmp_path / "cam.mp4"


def read(path: Path) -> Coverage:
    source = CountedSource(VideoConfig(path, "cam01").build(), 0)
    list(source.frames())
    return source.coverage(0, (FRAMES - 1) * PERIOD_NS)


def whole(camera: str, frames: int = FRAMES) -> Coverage:
    return Coverage(camera, frames, frames, (frames - 1) * PERIOD_NS, PERIOD_NS)


def test_undamaged_videos_are_not_mentioned(video: Path) -> None:
    assert read(video) == whole("cam01")
    assert incomplete_cameras([whole("cam00"), read(video)]) == []


def test_a_few_missing_frames_at_the_end_are_not_mentioned() -> None:
    assert incomplete_cameras([whole("a", 3000), whole("b", 2998)]) == []


def test_a_camera_with_a_shorter_video_is_named_with_its_end() -> None:
    [line] = incomplete_cameras([whole("a"), whole("b", 25)])
    assert line == "camera b: it stops at 0.96 s, the recording at 1.96 s"


def test_frames_that_a_video_states_and_no_longer_holds_are_missing_at_its_end() -> None:
    source = ScriptedSource("b", [i * PERIOD_NS for i in range(20)])
    source.stated_frames = FRAMES
    counted = CountedSource(source, 0)
    list(counted.frames())
    assert counted.coverage(0, (FRAMES - 1) * PERIOD_NS) == Coverage("b", FRAMES, 20, 19 * PERIOD_NS, PERIOD_NS)


def test_metadata_of_a_video_that_is_not_utf8_is_ignored(video: Path) -> None:
    content = video.read_bytes()
    assert b"Lavf" in content
    video.write_bytes(content.replace(b"Lavf", b"L\xe4vf"))
    assert read(video) == whole("cam01")


def test_a_camera_without_any_frame_is_named() -> None:
    lines = incomplete_cameras([whole("a"), Coverage("b", 50, 0, None, PERIOD_NS)])
    assert lines == ["camera b: none of its 50 frames can be read"]


def test_gaps_between_start_and_end_are_counted() -> None:
    [line] = incomplete_cameras([whole("a"), Coverage("b", 50, 40, 49 * PERIOD_NS, PERIOD_NS)])
    assert line == "camera b: 20% of its frames cannot be read (10 of 50)"
    [line] = incomplete_cameras([whole("a"), Coverage("b", 50, 20, 19 * PERIOD_NS, PERIOD_NS)])
    assert line == "camera b: 60% of its frames cannot be read (30 of 50); it stops at 0.76 s, the recording at 1.96 s"
