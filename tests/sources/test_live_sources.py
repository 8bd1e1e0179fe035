"""Live sources against a network camera of our own: MJPEG over HTTP, as cheap cameras send it."""

import errno
import itertools
import os
import socket
import threading
import time
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from unittest.mock import MagicMock, Mock

import av
import cv2
import numpy as np
import pytest
from checks import refusal
from running import PATIENCE_S

from posefuse.core import SourceError
from posefuse.sources.live import PacedVideoConfig, StreamConfig, stream

PERIOD_S = 0.04


class Camera(BaseHTTPRequestHandler):
    def do_GET(self) -> None:
        self.send_response(200)
        self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
        self.end_headers()
        for i in range(40):
            image = np.full((48, 64, 3), 5 * i, np.uint8)
            data = cv2.imencode(".jpg", image)[1].tobytes()
            try:
                self.wfile.write(b"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: %d\r\n\r\n%b\r\n" % (len(data), data))
            except OSError:
                return
            time.sleep(PERIOD_S)

    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture(scope="module")
def network_camera() -> Iterator[str]:
    server = ThreadingHTTPServer(("127.0.0.1", 0), Camera)
    server.daemon_threads = True
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}/stream.mjpg"
    server.shutdown()
    server.server_close()


def test_a_network_camera_delivers_until_it_ends(network_camera: str) -> None:
    source = StreamConfig(where=network_camera, camera="cam").build()
    assert source.size_wh == (64, 48)
    frames = []
    with pytest.raises(SourceError, match=r"ended|no image"):
        for frame in source.frames():
            frames.append(frame)
    source.close()
    source.close()
    assert len(frames) > 20
    assert [frame.seq for frame in frames] == list(range(len(frames)))
    assert (np.diff([frame.t_ns for frame in frames]) > 0).all()
    assert all(frame.t_ns <= frame.received_ns for frame in frames[1:])
    assert (np.diff([frame.image.mean() for frame in frames]) > 3).all()


def test_a_camera_is_not_disconnected_while_a_thread_reads_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """FFmpeg freed under a thread that reads is a segmentation fault: `record` ended with it, and left its videos unfinished."""
    container, waits, comes, image = MagicMock(), threading.Event(), threading.Event(), av.VideoFrame(64, 48, "rgb24")

    def decoded(*_: object) -> Iterator[tuple[av.VideoFrame, None]]:
        yield image, None
        waits.set()
        assert comes.wait(PATIENCE_S)
        yield image, None

    monkeypatch.setattr(stream, "_connected", lambda config: container)
    monkeypatch.setattr(stream, "decoded_with_packets", decoded)
    source = StreamConfig(where="http://camera", camera="cam").build()
    reads = threading.Thread(target=lambda: list(source.frames()))
    reads.start()
    assert waits.wait(PATIENCE_S)
    source.close()
    assert not container.close.called
    comes.set()
    reads.join(PATIENCE_S)
    assert not reads.is_alive() and container.close.call_count == 1
    source.close()


@pytest.mark.parametrize("protocol", ["rtsp", "http"])
def test_a_server_that_never_answers_is_one_line(protocol: str) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"{protocol}://127.0.0.1:{server.getsockname()[1]}/stream"
        words = r"camera cam: no answer within 0.3 s; is it switched on, .*address"
        refusal(SourceError, words, StreamConfig(where=address, camera="cam", open_s=0.3).build)


@pytest.mark.parametrize("where", ["http://127.0.0.1:9/none", "rtsp://127.0.0.1:9/s"])
def test_a_camera_that_is_away_is_one_line(where: str) -> None:
    words = rf"{where}: camera cam: cannot be opened .* switched on"
    refusal(SourceError, words, StreamConfig(where=where, camera="cam").build)
    refusal(SourceError, "there are", lambda: StreamConfig(where="/dev/video77", camera="cam").build())


@pytest.fixture
def ordinary_user() -> Iterator[None]:
    """Root may read everything, so it is another person who tries."""
    if os.geteuid() != 0:
        yield
        return
    os.seteuid(65534)
    yield
    os.seteuid(0)


def let_others_in(folder: Path) -> None:
    for one in (folder, *folder.parents):
        if not one.stat().st_mode & 0o001:
            one.chmod(0o711)


@pytest.mark.parametrize("hidden", [False, True], ids=["no read permission", "in a folder that may not be entered"])
def test_a_device_that_may_not_be_read_is_one_line(tmp_path, request, hidden: bool) -> None:
    device = tmp_path / "video0"
    device.touch(mode=0o644 if hidden else 0o000)
    let_others_in(tmp_path)
    if hidden:
        tmp_path.chmod(0o700)
    request.getfixturevalue("ordinary_user")
    refusal(
        SourceError,
        rf"{device}: camera cam: no permission .* group",
        lambda: StreamConfig(where=str(device), camera="cam").build(),
    )


def test_a_file_that_is_no_camera_and_a_camera_that_another_program_uses_are_one_line(tmp_path, monkeypatch) -> None:
    device = tmp_path / "video0"
    device.touch()
    build = StreamConfig(where=str(device), camera="cam").build
    refusal(SourceError, r"cannot be opened .*; it is no camera", build)
    busy = OSError(errno.EBUSY, os.strerror(errno.EBUSY))
    monkeypatch.setattr("posefuse.sources.live.stream.av.open", Mock(side_effect=busy))
    refusal(SourceError, "another program uses it", build)


@pytest.mark.realtime
def test_a_video_comes_at_its_own_pace_and_from_the_zero_it_is_given(demo_session) -> None:
    film = demo_session / "videos" / "cam00.mp4"
    late_ns = 4_000_000_000
    zero_ns = time.monotonic_ns() - late_ns
    frames = list(itertools.islice(PacedVideoConfig(film, "cam00", zero_ns=zero_ns).build().frames(), 6))
    # what was over before it began is left out
    assert all(frame.t_ns >= late_ns - 100_000_000 for frame in frames)
    assert len(frames) == 6
    assert all(frame.received_ns >= frame.t_ns for frame in frames)
    assert frames[-1].received_ns <= time.monotonic_ns() - zero_ns
