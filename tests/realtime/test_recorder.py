"""`posefuse record` and `guide --record`: every frame at its own time, warnings, and nothing left of a failed start."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest
from live_session import until

from posefuse.calibration.targets.kinds import Markers, write_target
from posefuse.cli import recording
from posefuse.cli.command_line import parse
from posefuse.cli.main import main
from posefuse.cli.terminal import Terminal
from posefuse.core import Frame, SourceError
from posefuse.formats.kept_video import KeptVideo
from posefuse.formats.pixels import RgbPixels
from posefuse.realtime.capture import LiveInput
from posefuse.realtime.inputs import inputs_from_arguments
from posefuse.realtime.video_keeping import read_counts
from posefuse.realtime.watching import CameraFeed, exposure_warning, record
from posefuse.sources.video import VideoConfig

GOOD = np.linspace(20, 230, 48 * 64, dtype=np.uint8).reshape(48, 64, 1).repeat(3, axis=2)
STAMPS_NS = np.array([0, 33, 67, 180, 210]) * 1_000_000


@dataclass(frozen=True)
class Clip:
    """Frames from memory at uneven times that count from the session's zero."""

    camera: str
    image: Any
    zero_ns: int | None = None
    size_wh: tuple[int, int] = (64, 48)

    def build(self) -> "Clip":
        return self

    def close(self) -> None:
        pass

    def frames(self) -> Any:
        for i, t_ns in enumerate(STAMPS_NS.tolist()):
            yield Frame(camera=self.camera, seq=i, t_ns=t_ns, received_ns=t_ns, image=self.image)


def test_every_frame_is_kept_at_its_own_time(tmp_path: Path) -> None:
    inputs = [LiveInput(name, "clip", Clip(name, GOOD), reopen=False) for name in ("a", "b")]
    with CameraFeed(inputs) as feed:
        record(feed, tmp_path, lambda seconds, news: None, duration_s=20.0)
    for name, counts in read_counts(tmp_path, ["a", "b"]).items():
        assert (counts.written, counts.dropped, counts.finished) == (5, 0, True)
        assert counts.longest_gap_s == pytest.approx(0.113)
        assert counts.rate_hz == pytest.approx(4 / 0.21)
        np.testing.assert_array_equal(VideoConfig(tmp_path / f"{name}.mp4", name).build().times_ns(), STAMPS_NS)


@dataclass(frozen=True)
class Late(Clip):
    """Delivers its first frame late, then four more at a tenth of a second each."""

    wait_s: float = 0.0

    def frames(self) -> Any:
        time.sleep(self.wait_s)
        for i in range(100):
            t_ns = time.monotonic_ns() - (self.zero_ns or 0)
            yield Frame(camera=self.camera, seq=i, t_ns=t_ns, received_ns=t_ns, image=self.image)
            time.sleep(0.02)


@pytest.mark.realtime
def test_the_duration_counts_from_the_first_frame_of_the_last_camera(tmp_path: Path) -> None:
    inputs = [LiveInput(name, "clip", Late(name, GOOD, wait_s=wait_s), reopen=False) for name, wait_s in (("a", 0.0), ("b", 1.0))]
    with CameraFeed(inputs) as feed:
        record(feed, tmp_path, lambda seconds, news: None, duration_s=0.5)
    last = read_counts(tmp_path, ["a", "b"])["b"]
    assert last.last_s - last.first_s > 0.3


@dataclass(frozen=True)
class Silent(Clip):
    """Ends, or waits, without a frame."""

    endless: bool = False

    def frames(self) -> Any:
        while self.endless:
            time.sleep(0.01)
        yield from ()


def run(arguments: list[str], sources: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> int:
    """`posefuse record` with these sources."""
    inputs = [LiveInput(name, "clip", source, reopen=False) for name, source in sources.items()]
    monkeypatch.setattr(recording, "inputs_from_arguments", lambda *ignored: inputs)
    return main(["record", *arguments, "--json"])


def test_a_recording_without_frames_is_an_error_that_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    assert run(["--out", str(tmp_path / "s")], {"a": Silent("a", GOOD)}, monkeypatch) == 1
    printed = capsys.readouterr()
    assert "no frame came from a: nothing was recorded" in printed.err
    assert "next:" not in printed.err + printed.out
    assert not list(tmp_path.iterdir())


def test_a_recording_stopped_before_its_first_frame_leaves_nothing_and_claims_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    threading.Timer(0.5, signal.raise_signal, [signal.SIGINT]).start()
    assert run(["--out", str(tmp_path / "s")], {"a": Silent("a", GOOD, endless=True)}, monkeypatch) == 130
    assert capsys.readouterr().out == ""
    assert not list(tmp_path.iterdir())


def test_a_camera_without_frames_and_lost_frames_end_in_an_error_that_names_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    sources = {"a": Clip("a", GOOD), "b": Silent("b", GOOD), "c": Gap("c", GOOD)}
    assert run(["--out", str(tmp_path / "s")], sources, monkeypatch) == 1
    printed = capsys.readouterr()
    assert "b: no frame came" in printed.err
    assert "c: 7 frames are missing: the source did not deliver them" in printed.err
    assert json.loads(printed.out)["videos"]["a"]["written"] == len(STAMPS_NS)
    assert json.loads((tmp_path / "s" / "videos" / "c.json").read_text())["lost"]


@dataclass(frozen=True)
class Gap(Clip):
    """Counts seven more frames than it delivers."""

    def frames(self) -> Any:
        for frame in super().frames():
            yield replace(frame, seq=frame.seq + 7 * (frame.seq > 2))


@pytest.mark.realtime
def test_a_recording_that_is_killed_is_named_and_completed_by_one_command(
    tmp_path: Path, demo_session: Path, capsys: pytest.CaptureFixture
) -> None:
    session = tmp_path / "session"
    source = ["--source", f"cam00=video:{demo_session / 'videos' / 'cam00.mp4'}"]
    command = [sys.executable, "-m", "posefuse", "record", *source, "--out", str(session)]
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as process:
        try:
            until(lambda: any(path.stat().st_size > 30_000 for path in tmp_path.glob(".session.*.unfinished/videos/cam00.mp4")))
        finally:
            process.kill()
    assert main(command[3:]) == 1
    assert f"`posefuse record --resume --out {session}` completes it" in capsys.readouterr().err
    assert main(["record", "--resume", "--out", str(session)]) == 1
    assert "is it still being recorded?" in capsys.readouterr().err
    for path in tmp_path.glob(".session.*/videos/*"):
        os.utime(path, (0, 0))
    assert main(["record", "--resume", "--out", str(session), "--json"]) == 0
    written = json.loads(capsys.readouterr().out)["videos"]["cam00"]["written"]
    times_ns = VideoConfig(session / "videos" / "cam00.mp4", "cam00").build().times_ns()
    assert len(times_ns) == written > 10
    assert [path.name for path in tmp_path.iterdir()] == ["session"]
    assert main(["record", "--resume", "--out", str(session)]) == 1
    assert "nothing to resume" in capsys.readouterr().err


def test_a_bad_exposure_is_named_and_a_good_one_is_not() -> None:
    white, dark = GOOD.copy(), GOOD // 5
    white[:20] = 255
    assert exposure_warning(GOOD) == ""
    assert exposure_warning(white).startswith("overexposed: ")
    assert exposure_warning(dark).startswith("dark: ")


def test_sources_need_no_rig_and_keep_their_order() -> None:
    found = inputs_from_arguments(["z=video:a.mp4", "a=usb:/dev/video1"], None)
    assert [(one.camera, one.kind) for one in found] == [("z", "video"), ("a", "usb")]
    with pytest.raises(SourceError, match=r"expected a size, e\.g\. c=oak:any@1280x720@30"):
        inputs_from_arguments(["c=oak:any"], None)
    with pytest.raises(SourceError, match="has a source already"):
        inputs_from_arguments(["z=video:a.mp4", "z=video:b.mp4"], None)


def test_a_source_that_cannot_be_opened_leaves_nothing(tmp_path: Path) -> None:
    found = parse(["record", "--source", f"a=video:{tmp_path / 'none.mp4'}", "--out", str(tmp_path / "session")])
    assert found is not None
    with pytest.raises(SourceError, match="camera a: no such video file"):
        found.run(Terminal(as_json=True))
    assert not list(tmp_path.iterdir())


@pytest.mark.realtime
def test_a_source_with_reordered_frames_is_recorded_completely(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    with av.open(str(tmp_path / "made.mp4"), "w") as made:
        stream = made.add_stream("libx264", rate=30, options={"bf": "3", "b-adapt": "0"})
        stream.width, stream.height = 64, 48
        for _ in range(50):
            made.mux(stream.encode(av.VideoFrame.from_ndarray(GOOD)))
        made.mux(stream.encode(None))
    sources = [word for name in "abcd" for word in ("--source", f"{name}=video:{tmp_path / 'made.mp4'}")]
    assert main(["record", *sources, "--out", str(tmp_path / "s"), "--json"]) == 0
    videos = json.loads(capsys.readouterr().out)["videos"]
    assert {name: (one["written"], one["dropped"], one["how"]) for name, one in videos.items()} == dict.fromkeys(
        "abcd", (50, 0, "copied")
    )


@pytest.mark.realtime
def test_what_guide_has_seen_is_a_session(tmp_path: Path) -> None:
    marker = cv2.aruco.generateImageMarker(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50), 3, 60)
    page = np.full((120, 160, 3), 255, np.uint8)
    page[30:90, 50:110] = marker[..., None]
    for name in ("a", "b"):
        with KeptVideo(tmp_path / f"{name}.mp4") as video:
            for i in range(12):
                video.write(RgbPixels(np.roll(page, 2 * i, axis=1)), i * 50_000_000)
    sources = [word for name in ("a", "b") for word in ("--source", f"{name}=video:{tmp_path / name}.mp4")]
    session, target = tmp_path / "session", write_target(tmp_path / "cube.toml", Markers(0.1))
    found = parse(["calibrate", "guide", "--target", str(target), *sources, "--record", str(session)])
    assert found is not None
    figures = found.run(Terminal(as_json=True))
    assert not figures["enough"] and figures["exit_code"] == 0
    # a busy machine leaves out frames that it could not decode before the next was due
    written = {name: one["written"] for name, one in figures["videos"].items()}
    assert set(written) == {"a", "b"} and all(3 <= count <= 12 for count in written.values())
    assert read_counts(session / "videos", ["b"])["b"].written == written["b"]
    times_ns = VideoConfig(session / "videos" / "b.mp4", "b").build().times_ns()
    assert len(times_ns) == written["b"]
    np.testing.assert_allclose(times_ns, np.rint(times_ns / 50_000_000) * 50_000_000, atol=1_000)
