"""`posefuse live --videos`: nothing waits for the disk, what is dropped is counted, and the folder is a session."""

import json
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from live_session import until

import posefuse as pf
from posefuse.api.record import kept_videos
from posefuse.cli.main import main
from posefuse.core import InputError
from posefuse.formats.pixels import Pixels, RgbPixels
from posefuse.foundation.output_folder import MARK_FILE
from posefuse.pipeline.config import TrackConfig
from posefuse.pipeline.playback import session_with_videos
from posefuse.pipeline.session import find_session
from posefuse.realtime import video_keeping
from posefuse.realtime.capture import Capture, LiveInput
from posefuse.realtime.video_keeping import VideoKeeper, read_counts, wait_for_videos
from posefuse.sources.arriving import Arrived, with_earlier
from posefuse.sources.video import VideoConfig


def frame(i: int) -> Pixels:
    return RgbPixels(np.full((32, 48, 3), i % 250, np.uint8))


def finished(keeper: VideoKeeper) -> None:
    keeper.finish()
    wait_for_videos([keeper])


def test_all_frames_after_the_session_began_are_kept(tmp_path: Path) -> None:
    keeper = VideoKeeper(tmp_path, "cam")
    for i in range(-3, 20):
        keeper.offer(frame(i), i * 10_000_000)
    finished(keeper)
    [counts] = read_counts(tmp_path, ["cam"]).values()
    assert (counts.written, counts.dropped, counts.fault, counts.finished) == (20, 0, "", True)
    np.testing.assert_allclose(VideoConfig(tmp_path / "cam.mp4", "cam").build().times_ns(), np.arange(20) * 10_000_000, atol=1000)


def test_packets_of_frames_that_were_left_out_are_kept_too(demo_session: Path, tmp_path: Path) -> None:
    source = VideoConfig(demo_session / "videos" / "cam00.mp4", "cam00", keep_encoded=True, threads=False).build()
    made = list(source.frames())
    late = with_earlier(Arrived.of(made[5]), [(one.t_ns, one.encoded) for one in made[3:5]])
    keeper = VideoKeeper(tmp_path, "cam")
    for one, encoded in [*((one, one.encoded) for one in made[:3]), (made[5], late), *((one, one.encoded) for one in made[6:])]:
        assert encoded is not None
        keeper.offer(encoded, one.t_ns)
    finished(keeper)
    [counts] = read_counts(tmp_path, ["cam"]).values()
    assert (counts.written, counts.lost) == (len(made), {})
    np.testing.assert_allclose(VideoConfig(tmp_path / "cam.mp4", "cam").build().times_ns(), source.times_ns(), atol=1_000)


def test_a_slow_disk_is_not_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    free, write = threading.Event(), video_keeping.KeptVideo.write

    def slow(self: video_keeping.KeptVideo, one: Pixels, t_ns: int) -> str:
        assert free.wait(30)
        return write(self, one, t_ns)

    monkeypatch.setattr(video_keeping.KeptVideo, "write", slow)
    monkeypatch.setattr(video_keeping, "_ROOM_BYTES", 32 * 32 * 48 * 3)
    keeper = VideoKeeper(tmp_path, "cam")
    for i in range(100):
        keeper.offer(frame(i), i * 10_000_000)
    assert keeper.counts().dropped >= 100 - 34
    free.set()
    finished(keeper)
    [counts] = read_counts(tmp_path, ["cam"]).values()
    assert counts.written + counts.dropped == 100
    assert counts.written >= 32
    assert set(counts.lost) == {"the disk or the processor is too slow for this rate"}


def test_a_video_that_still_makes_progress_is_finished_and_one_that_does_not_is_given_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The disk takes a frame every 50 ms, and the one of the other camera nothing more."""
    monkeypatch.setattr(video_keeping, "FINISH_S", 0.5)
    free, write = threading.Event(), video_keeping.KeptVideo.write

    def slow(self: video_keeping.KeptVideo, one: Pixels, t_ns: int) -> str:
        if self.path.stem == "stuck":
            assert free.wait(30)
        time.sleep(0.05)
        return write(self, one, t_ns)

    monkeypatch.setattr(video_keeping.KeptVideo, "write", slow)
    keepers = [VideoKeeper(tmp_path, name) for name in ("cam", "stuck")]
    for keeper in keepers:
        for i in range(40):
            keeper.offer(frame(i), i * 10_000_000)
        keeper.finish()
    wait_for_videos(keepers)
    counts = read_counts(tmp_path, ["cam", "stuck"])
    free.set()
    wait_for_videos(keepers)
    assert (counts["cam"].written, counts["cam"].finished) == (40, True)
    assert "was not finished" in counts["stuck"].fault


def test_of_two_videos_of_a_camera_both_are_finished_at_the_end(tmp_path: Path) -> None:
    """Stop, then End at once: the one that was switched off is not finished yet."""
    capture = Capture(LiveInput("cam", "film", None, reopen=False), None, threading.Condition())
    for name in ("first", "second"):
        (tmp_path / name).mkdir()
        capture.exchange_keeper(VideoKeeper(tmp_path / name, "cam"))
        for i in range(200):
            capture._keeper.offer(frame(i), i * 10_000_000)
    wait_for_videos(capture.close())
    for name in ("first", "second"):
        [counts] = read_counts(tmp_path / name, ["cam"]).values()
        assert (counts.written, counts.finished) == (200, True)


def test_a_full_disk_ends_the_video_and_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(self: video_keeping.KeptVideo, one: Pixels, t_ns: int) -> str:
        raise InputError("cam.mp4: cannot be written (No space left on device)")

    monkeypatch.setattr(video_keeping.KeptVideo, "write", full)
    keeper = VideoKeeper(tmp_path, "cam")
    for i in range(5):
        keeper.offer(frame(i), i * 10_000_000)
    finished(keeper)
    [counts] = read_counts(tmp_path, ["cam"]).values()
    assert (counts.written, counts.dropped, counts.finished) == (0, 5, False)
    assert "No space left" in counts.fault
    assert "was not finished" in read_counts(tmp_path, ["other"])["other"].fault


def test_a_folder_of_videos_that_a_full_disk_leaves_incomplete_is_one_line_that_names_it(
    tmp_path: Path, small_disk: Callable[[int], Path]
) -> None:
    disk = small_disk(1)
    reason = r"the results are complete in .*unfinished but cannot be moved there \(No space left on device\)"
    with pytest.raises(InputError, match=reason), kept_videos(disk / "videos", None, []) as folder:
        assert folder is not None
        (folder / "cam00.mp4").write_bytes(b"a video")
        with pytest.raises(OSError, match="No space left"):
            (disk / "filler").write_bytes(bytes(2**20))
    [left] = disk.glob(".videos.*.unfinished")
    assert (left / "videos" / "cam00.mp4").read_bytes() == b"a video"


@pytest.mark.realtime
def test_a_session_kept_with_its_videos_can_be_tracked(
    tmp_path: Path, demo_session: Path, models: None, capsys: pytest.CaptureFixture
) -> None:
    sources = [part for i in range(4) for part in ("--source", f"cam0{i}=video:{demo_session}/videos/cam0{i}.mp4")]
    kept = tmp_path / "kept"
    command = ["live", str(demo_session / "rig.toml"), *sources, "--videos", str(kept), "--duration", "3", "--json"]
    assert main(command) == 0
    figures = json.loads(capsys.readouterr().out)
    session = find_session(kept, TrackConfig())
    assert session.rig.names == ("cam00", "cam01", "cam02", "cam03")
    assert (kept / MARK_FILE).is_file()
    for name, counts in figures["videos"].items():
        found = VideoConfig(kept / "videos" / f"{name}.mp4", name).build().times_ns()
        original = VideoConfig(demo_session / "videos" / f"{name}.mp4", name).build().times_ns()
        assert counts["how"] == "copied"
        assert len(found) >= counts["written"] > 0
        nearest = np.abs(original[None] - found[:, None]).min(axis=1)
        assert nearest.max() <= 1_000


@pytest.mark.realtime
def test_a_live_recording_has_its_videos_on_its_own_time_and_the_names_that_were_given(
    tmp_path: Path, demo_session: Path
) -> None:
    """Every detection was made in a frame, so that the video has a frame at its time."""
    pytest.importorskip("rosbags")
    oracle = {"detector.name": "oracle", "detector.options.truth": str(demo_session / "truth" / "truth.npz")}
    videos, path = tmp_path / "videos", tmp_path / "recording.mcap"
    videos.mkdir()
    (tmp_path / "rig.toml").write_bytes((demo_session / "rig.toml").read_bytes())
    with pf.live(demo_session / "rig.toml", [f"sim:{demo_session}"], record=path, settings=oracle) as session:
        [person] = next(pose for pose in session if len(pose.person_id)).person_id.tolist()
        session.keep_videos(videos)
        session.name_person(person, "Ada")
        time.sleep(2.0)
        session.keep_videos(None)
        until(lambda: len(list(videos.glob("*.json"))) == 4)
        # the rest of a recording is written with the next messages
        time.sleep(0.5)
    recording = pf.read(path)
    assert "Ada" in recording.person_names
    shown = session_with_videos(recording, path)
    assert shown is not None and len(shown.inputs) == 4
    seen = recording.observations
    for entry in shown.inputs:
        times = VideoConfig(entry.path, entry.camera, entry.settings.offset_s).build().times_ns()
        own = seen.frame_t_ns[seen.frame_camera == recording.rig.names.index(entry.camera)]
        inside = own[(own >= times[0]) & (own <= times[-1])]
        assert len(inside) > 3
        assert np.abs(inside[:, None] - times[None]).min(axis=1).max() <= 1_000
