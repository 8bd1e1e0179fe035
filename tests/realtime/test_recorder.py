"""`posefuse record` and `guide --record`: every frame at its own time, warnings, and nothing left of a failed start."""

import json
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import built
import cv2
import numpy as np
import pytest
from calibrating import marker_page
from checks import refusal
from commands import error, figures, oracle
from live_session import until
from memory_source import Clip
from running import Running

import posefuse as pf
from posefuse.api import record as recording
from posefuse.api.playback import session_with_videos
from posefuse.api.record import kept_videos
from posefuse.calibration.targets.kinds import Markers, write_target
from posefuse.cli.command_line import parse
from posefuse.cli.main import main
from posefuse.cli.terminal import Terminal
from posefuse.core import Frame, InputError, SourceError
from posefuse.core.frames import Pixels
from posefuse.formats.kept_video import KeptVideo
from posefuse.foundation.output_folder import MARK_FILE
from posefuse.pipeline.config import TrackConfig
from posefuse.pipeline.session import find_session
from posefuse.realtime import video_keeping
from posefuse.realtime.capture import Capture, LiveInput
from posefuse.realtime.inputs import inputs_from_arguments
from posefuse.realtime.video_keeping import KeptCounts, VideoKeeper, read_counts, wait_for_videos
from posefuse.realtime.watching import CameraFeed, detail_left, exposure_warning, focus_warning
from posefuse.sources.video import VideoConfig

GOOD = np.linspace(20, 230, 48 * 64, dtype=np.uint8).reshape(48, 64, 1).repeat(3, axis=2)
STAMPS_NS = (0, 33_000_000, 67_000_000, 180_000_000, 210_000_000)


def inputs_of(*clips: Clip) -> list[LiveInput]:
    return [LiveInput(clip.camera, "clip", clip, reopen=False) for clip in clips]


def times_of(folder: Path, name: str) -> np.ndarray:
    """Of the frames of a video."""
    return VideoConfig(folder / f"{name}.mp4", name).build().times_ns()


def test_every_frame_is_kept_at_its_own_time(tmp_path: Path) -> None:
    with CameraFeed(inputs_of(*(Clip(name, GOOD, STAMPS_NS) for name in ("a", "b")))) as feed:
        for _ in feed.watched(tmp_path, duration_s=20.0, judged=True):
            pass
    for name, counts in read_counts(tmp_path, ["a", "b"]).items():
        assert (counts.written, counts.dropped, counts.finished) == (5, 0, True)
        assert counts.longest_gap_s == pytest.approx(0.113)
        assert counts.rate_hz == pytest.approx(4 / 0.21)
        np.testing.assert_array_equal(times_of(tmp_path, name), STAMPS_NS)


def late(clip: Clip) -> Iterator[Frame]:
    """At 50 Hz, those of camera b from a second later on."""
    time.sleep(1.0 if clip.camera == "b" else 0.0)
    for i in range(100):
        yield built.frame(clip.camera, time.monotonic_ns() - (clip.zero_ns or 0), GOOD, seq=i)
        time.sleep(0.02)


@pytest.mark.realtime
def test_the_duration_counts_from_the_first_frame_of_the_last_camera(tmp_path: Path) -> None:
    with CameraFeed(inputs_of(Clip("a", plays=late), Clip("b", plays=late))) as feed:
        for _ in feed.watched(tmp_path, duration_s=0.5, judged=True):
            pass
    last = read_counts(tmp_path, ["a", "b"])["b"]
    assert last.last_s - last.first_s > 0.3


def waiting(clip: Clip) -> Iterator[Frame]:
    """Never a frame."""
    while True:
        time.sleep(0.01)
    yield


def incomplete(clip: Clip) -> Iterator[Frame]:
    """Counts seven more frames than it delivers."""
    for frame in clip.stamped():
        yield replace(frame, seq=frame.seq + 7 * (frame.seq > 2))


@pytest.fixture
def recorded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture):
    """Runs `posefuse record --out s` with sources, and gives its exit code and what it printed."""

    def run(*sources: Clip) -> tuple[int, str, str]:
        monkeypatch.setattr(recording, "inputs_from_arguments", lambda *ignored: inputs_of(*sources))
        return main(["record", "--out", str(tmp_path / "s"), "--json"]), *capsys.readouterr()

    return run


def test_a_recording_without_frames_is_an_error_that_leaves_nothing(recorded, tmp_path: Path) -> None:
    code, out, err = recorded(Clip("a", GOOD))
    assert code == 1 and "no frame came from a: nothing was recorded" in err and "next:" not in err + out
    assert not list(tmp_path.iterdir())


def test_a_recording_stopped_before_its_first_frame_leaves_nothing_and_claims_nothing(recorded, tmp_path: Path) -> None:
    threading.Timer(0.5, signal.raise_signal, [signal.SIGINT]).start()
    assert recorded(Clip("a", GOOD, plays=waiting))[:2] == (130, "")
    assert not list(tmp_path.iterdir())


def test_a_camera_without_frames_and_lost_frames_end_in_an_error_that_names_them(recorded, tmp_path: Path) -> None:
    code, out, err = recorded(Clip("a", GOOD, STAMPS_NS), Clip("b", GOOD), Clip("c", GOOD, STAMPS_NS, plays=incomplete))
    assert code == 1 and "b: no frame came" in err
    assert "c: 7 frames are missing: the source did not deliver them" in err
    assert json.loads(out)["videos"]["a"]["written"] == len(STAMPS_NS)
    assert json.loads((tmp_path / "s" / "videos" / "c.json").read_text())["lost"]


@pytest.mark.realtime
def test_a_recording_that_is_killed_is_named_and_completed_by_one_command(tmp_path: Path, demo_session: Path, capsys) -> None:
    session = tmp_path / "session"
    source = ["--source", f"cam00=video:{demo_session / 'videos' / 'cam00.mp4'}"]
    command = [sys.executable, "-m", "posefuse", "record", *source, "--out", str(session)]
    with Running(command):
        until(lambda: any(path.stat().st_size > 30_000 for path in tmp_path.glob(".session.*.unfinished/videos/cam00.mp4")))
    resume = ("record", "--resume", "--out", session)
    assert f"`posefuse record --resume --out {session}` completes it" in error(capsys, *command[3:])
    assert "is it still being recorded?" in error(capsys, *resume)
    for path in tmp_path.glob(".session.*/videos/*"):
        os.utime(path, (0, 0))
    written = figures(capsys, *resume)["videos"]["cam00"]["written"]
    assert len(times_of(session / "videos", "cam00")) == written > 10
    assert [path.name for path in tmp_path.iterdir()] == ["session"]
    assert "nothing to resume" in error(capsys, *resume)


def test_a_bad_exposure_is_named_and_a_good_one_is_not() -> None:
    white = np.concatenate([np.full_like(GOOD[:20], 255), GOOD[20:]])
    assert [exposure_warning(one).partition(":")[0] for one in (GOOD, white, GOOD // 5)] == ["", "overexposed", "dark"]


def test_sources_need_no_rig_and_keep_their_order() -> None:
    found = inputs_from_arguments(["z=video:a.mp4", "a=usb:/dev/video1"], None)
    assert [(one.camera, one.kind) for one in found] == [("z", "video"), ("a", "usb")]
    refusal(SourceError, r"expected a size, e\.g\. c=realsense:any@1280x720@30", inputs_from_arguments, ["c=realsense:any"], None)


def test_a_source_that_cannot_be_opened_leaves_nothing(tmp_path: Path) -> None:
    found = parse(["record", "--source", f"a=video:{tmp_path / 'none.mp4'}", "--out", str(tmp_path / "session")])
    assert found is not None
    refusal(SourceError, "camera a: no such video file", lambda: found.run(Terminal(as_json=True)))
    assert not list(tmp_path.iterdir())


@pytest.mark.realtime
def test_what_guide_has_seen_is_a_session(tmp_path: Path) -> None:
    for name in ("a", "b"):
        with KeptVideo(tmp_path / f"{name}.mp4") as video:
            for i in range(12):
                video.write(Pixels(np.roll(marker_page(), 2 * i, axis=1)), i * 50_000_000)
    sources = [word for name in ("a", "b") for word in ("--source", f"{name}=video:{tmp_path / name}.mp4")]
    session, target = tmp_path / "session", write_target(tmp_path / "cube.toml", Markers(0.1))
    found = parse(["calibrate", "guide", "--target", str(target), *sources, "--record", str(session)])
    assert found is not None
    stated = found.run(Terminal(as_json=True))
    assert not stated["enough"] and stated["exit_code"] == 0
    # a busy machine leaves out frames that it could not decode before the next was due
    written = {name: one["written"] for name, one in stated["videos"].items()}
    assert set(written) == {"a", "b"} and all(3 <= count <= 12 for count in written.values())
    assert read_counts(session / "videos", ["b"])["b"].written == written["b"]
    times_ns = times_of(session / "videos", "b")
    assert len(times_ns) == written["b"]
    np.testing.assert_allclose(times_ns, np.rint(times_ns / 50_000_000) * 50_000_000, atol=1_000)


# --- `posefuse live --videos`: nothing waits for the disk, what is dropped is counted, and the folder is a session


def offered(keeper: VideoKeeper, numbers: range) -> VideoKeeper:
    """It, after frames of these numbers at 100 Hz."""
    for i in numbers:
        keeper.offer(Pixels(np.full((32, 48, 3), i % 250, np.uint8)), i * 10_000_000)
    return keeper


def finished(keeper: VideoKeeper, folder: Path) -> KeptCounts:
    keeper.finish()
    wait_for_videos([keeper])
    return read_counts(folder, ["cam"])["cam"]


def test_all_frames_after_the_session_began_are_kept(tmp_path: Path) -> None:
    counts = finished(offered(VideoKeeper(tmp_path, "cam"), range(-3, 20)), tmp_path)
    assert (counts.written, counts.dropped, counts.fault, counts.finished) == (20, 0, "", True)
    np.testing.assert_allclose(times_of(tmp_path, "cam"), np.arange(20) * 10_000_000, atol=1000)


def test_frames_of_a_clock_that_is_set_back_are_counted(tmp_path: Path) -> None:
    """To before the session began, too."""
    keeper = offered(offered(VideoKeeper(tmp_path, "cam"), range(20)), range(-15, 5))
    counts = finished(keeper, tmp_path)
    assert (counts.written, counts.lost) == (20, {"their times are not later than those before": 20})


def test_frames_of_a_video_whose_process_was_killed_are_counted(tmp_path: Path) -> None:
    """They are in the file; "0 frames written" stood in the summary."""
    assert finished(offered(VideoKeeper(tmp_path, "cam"), range(20)), tmp_path).written == 20
    (tmp_path / "cam.json").unlink()
    [counts] = read_counts(tmp_path, ["cam"]).values()
    assert (counts.written, counts.last_s) == (20, 0.19) and "was not finished" in counts.fault


def test_a_slow_disk_is_not_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    free, write = threading.Event(), video_keeping.KeptVideo.write

    def slow(self: video_keeping.KeptVideo, one: Pixels, t_ns: int) -> str:
        assert free.wait(30)
        return write(self, one, t_ns)

    monkeypatch.setattr(video_keeping.KeptVideo, "write", slow)
    monkeypatch.setattr(video_keeping, "_ROOM_BYTES", 32 * 32 * 48 * 3)
    keeper = offered(VideoKeeper(tmp_path, "cam"), range(100))
    assert keeper.counts().dropped >= 100 - 34
    free.set()
    counts = finished(keeper, tmp_path)
    assert counts.written + counts.dropped == 100 and counts.written >= 32
    assert set(counts.lost) == {"the disk or the processor is too slow for this rate"}


def test_a_video_that_still_makes_progress_is_finished_and_one_that_does_not_is_given_up(tmp_path: Path, monkeypatch) -> None:
    """The disk takes a frame every 50 ms, and the one of the other camera nothing more."""
    monkeypatch.setattr(video_keeping, "FINISH_S", 0.5)
    free, write = threading.Event(), video_keeping.KeptVideo.write

    def slow(self: video_keeping.KeptVideo, one: Pixels, t_ns: int) -> str:
        if self.path.stem == "stuck":
            assert free.wait(30)
        time.sleep(0.05)
        return write(self, one, t_ns)

    monkeypatch.setattr(video_keeping.KeptVideo, "write", slow)
    keepers = [offered(VideoKeeper(tmp_path, name), range(40)) for name in ("cam", "stuck")]
    for keeper in keepers:
        keeper.finish()
    wait_for_videos(keepers)
    counts = read_counts(tmp_path, ["cam", "stuck"])
    free.set()
    wait_for_videos(keepers)
    assert (counts["cam"].written, counts["cam"].finished) == (40, True)
    assert "was not finished" in counts["stuck"].fault


def test_of_two_videos_of_a_camera_both_are_finished_at_the_end(tmp_path: Path) -> None:
    """Stop, then End at once: the one that was switched off is not finished yet."""
    capture = Capture(LiveInput("cam", "fake", None, reopen=False), None, threading.Condition())
    for name in ("first", "second"):
        (tmp_path / name).mkdir()
        capture.replace_keeper(VideoKeeper(tmp_path / name, "cam"))
        offered(capture._keeper, range(200))
    wait_for_videos(capture.close())
    for name in ("first", "second"):
        [counts] = read_counts(tmp_path / name, ["cam"]).values()
        assert (counts.written, counts.finished) == (200, True)


def test_a_full_disk_ends_the_video_and_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(self: video_keeping.KeptVideo, one: Pixels, t_ns: int) -> str:
        raise InputError("cam.mp4: cannot be written (No space left on device)")

    monkeypatch.setattr(video_keeping.KeptVideo, "write", full)
    counts = finished(offered(VideoKeeper(tmp_path, "cam"), range(5)), tmp_path)
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
        refusal(OSError, "No space left", lambda: (disk / "filler").write_bytes(bytes(2**20)))
    [left] = disk.glob(".videos.*.unfinished")
    assert (left / "videos" / "cam00.mp4").read_bytes() == b"a video"


@pytest.mark.realtime
def test_a_session_kept_with_its_videos_can_be_tracked(tmp_path: Path, demo_session: Path, models: None, capsys) -> None:
    sources = [part for i in range(4) for part in ("--source", f"cam0{i}=video:{demo_session}/videos/cam0{i}.mp4")]
    kept = tmp_path / "kept"
    found = figures(capsys, "live", demo_session / "rig.toml", *sources, "--videos", kept, "--duration", "3")
    session = find_session(kept, TrackConfig())
    assert session.rig.names == ("cam00", "cam01", "cam02", "cam03")
    assert (kept / MARK_FILE).is_file()
    for name, counts in found["videos"].items():
        times, original = (times_of(one / "videos", name) for one in (kept, demo_session))
        assert counts["how"] == "copied"
        assert len(times) >= counts["written"] > 0
        assert np.abs(original[None] - times[:, None]).min(axis=1).max() <= 1_000


@pytest.mark.realtime
def test_a_live_recording_has_its_videos_on_its_own_time_and_the_names_given(tmp_path: Path, demo_session: Path) -> None:
    """Every detection was made in a frame, so that the video has a frame at its time."""
    pytest.importorskip("rosbags")
    videos, path = tmp_path / "videos", tmp_path / "recording.mcap"
    videos.mkdir()
    (tmp_path / "rig.toml").write_bytes((demo_session / "rig.toml").read_bytes())
    with pf.live(demo_session / "rig.toml", [f"sim:{demo_session}"], record=path, settings=oracle()) as session:
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


@pytest.mark.parametrize("content", ["{", "[]", '{"written": "many"}', '{"lost": 3, "finished": true}'])
def test_counts_that_are_damaged_are_those_of_a_video_that_was_not_finished(content: str, tmp_path: Path) -> None:
    (tmp_path / "cam00.json").write_text(content)
    [counts] = read_counts(tmp_path, ["cam00"]).values()
    assert counts.fault.startswith("was not finished") and not counts.finished


def test_blur_is_noticed_and_a_sharp_image_is_not_blamed() -> None:
    rng = np.random.default_rng(5)
    image = np.full((480, 640), 90, np.uint8)
    for _ in range(60):
        x, y = rng.integers(0, (560, 400))
        cv2.rectangle(image, (int(x), int(y)), (int(x) + 60, int(y) + 50), int(rng.integers(0, 255)), -1)
    image = cv2.GaussianBlur(image, (0, 0), 0.6)
    left = [detail_left(np.dstack([cv2.GaussianBlur(image, (0, 0), blur)] * 3)) for blur in (0.1, 1.0, 2.0, 4.0)]
    assert left == sorted(left)
    assert not focus_warning(np.dstack([image] * 3))
    assert "focus" in focus_warning(np.dstack([cv2.GaussianBlur(image, (0, 0), 3.0)] * 3))
    assert not focus_warning(np.full((480, 640, 3), 128, np.uint8))
