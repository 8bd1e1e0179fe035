"""Videos kept while a camera delivers them: true times, no transcoding where packets come, readable when cut off."""

import socket
import threading
import time
from collections.abc import Iterable, Iterator
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest
from checks import refusal
from videos import write_video

from posefuse.core import Frame, InputError, SourceError
from posefuse.core.frames import EncodedFrame, Pixels
from posefuse.formats.kept_video import COPIED, ENCODED, KeptVideo
from posefuse.sources.arriving import decoded_with_packets
from posefuse.sources.live.stream import StreamConfig
from posefuse.sources.video import VideoConfig

# a camera that runs freely, its first frame well after the session's zero
T_NS = 1_234_567_891 + np.cumsum(33_000_000 + np.random.default_rng(0).integers(0, 900_000, 90))


def frames(demo: Path, encoded: bool) -> Iterator[Frame]:
    """With times that no frame rate gives."""
    source = VideoConfig(demo / "videos" / "cam00.mp4", "cam00", keep_encoded=encoded, threads=False).build()
    for frame, t_ns in zip(source.frames(), T_NS.tolist(), strict=False):
        yield replace(frame, t_ns=t_ns)


def kept(frame: Frame) -> Pixels | EncodedFrame:
    """What is given to a video."""
    return frame.encoded or frame.pixels


def write_all(video: KeptVideo, made: Iterable[Frame]) -> int:
    """How many were taken."""
    return sum(not video.write(kept(frame), frame.t_ns) for frame in made)


def read_all(path: Path) -> list[Frame]:
    return list(VideoConfig(path, "cam00").build().frames())


def same_images(some: Iterable[Frame], others: Iterable[Frame]) -> None:
    for one, other in zip(some, others, strict=True):
        np.testing.assert_array_equal(one.image, other.image)


B_FRAMES = {"bf": "3", "b-adapt": "0", "g": "12"}
# encoder, its options, container, its ticks per second, first tick, whether the packets are copied
STREAMS = {
    "x264 as it is": ("libx264", {}, "mp4", 15360, 0, True),
    "x264 B-frames": ("libx264", B_FRAMES, "mp4", 90_000, 0, True),
    "x264 B-frames, pyramid, a long GOP": ("libx264", {"bf": "8", "b-pyramid": "normal", "g": "250"}, "matroska", 1000, 0, True),
    "x264 open GOP": ("libx264", {**B_FRAMES, "x264-params": "open-gop=1:scenecut=0"}, "mpegts", 90_000, 0, True),
    "x264 without B-frames": ("libx264", {"tune": "zerolatency", "g": "12"}, "mp4", 90_000, 0, True),
    "x264 intra refresh": ("libx264", {"intra-refresh": "1", "g": "12", "bf": "0"}, "mpegts", 90_000, 0, True),
    "network camera, a clock that runs since 2 days": ("libx264", B_FRAMES, "matroska", 1000, 172_800_000, True),
    "decoding times below zero": ("libx264", B_FRAMES, "mov", 600, 0, True),
    "x265 open GOP": ("libx265", {"x265-params": "log-level=none:open-gop=1:keyint=12:bframes=4"}, "mp4", 90_000, 0, True),
    "motion JPEG": ("mjpeg", {}, "matroska", 1000, 5_000, True),
    "MPEG-4 with B-frames": ("mpeg4", {"bf": "2", "g": "12"}, "mp4", 30_000, 0, False),
    "VP8": ("libvpx", {"deadline": "realtime"}, "webm", 1000, 0, False),
}
COUNT = 50


def made_stream(path: Path, name: str) -> VideoConfig:
    """A recording of a variable frame rate; each image has a grey value of its own."""
    codec, options, container, rate, first, _ = STREAMS[name]
    if codec not in av.codecs_available:
        pytest.skip(f"this PyAV has no {codec}")
    pts = [first + round((i / 30 + 0.4 * (i > 20)) * rate) for i in range(COUNT)]
    pix_fmt = "yuvj420p" if codec == "mjpeg" else "yuv420p"
    write_video(path, GREYS, codec, Fraction(1, rate), pts, pix_fmt=pix_fmt, options=options, format=container)
    return VideoConfig(path, "cam00", keep_encoded=True)


def grey(i: int) -> int:
    return 20 + 67 * i % 200


GREYS = [np.full((120, 160, 3), grey(i), np.uint8) for i in range(COUNT)]


@pytest.mark.parametrize("name", STREAMS)
@pytest.mark.parametrize("session_ns", [0, 1_234_567_891])
def test_no_frame_of_any_encoder_is_lost_and_each_keeps_its_own_time(tmp_path: Path, name: str, session_ns: int) -> None:
    source = made_stream(tmp_path / "made", name).build()
    # times of exposure that the stream does not know
    own_ns = session_ns + np.cumsum(np.random.default_rng(0).integers(20_000_000, 50_000_000, COUNT)) - 20_000_000
    given = [replace(frame, t_ns=t_ns) for frame, t_ns in zip(source.frames(), own_ns.tolist(), strict=True)]
    with KeptVideo(tmp_path / "kept.mp4") as video:
        assert write_all(video, given) == COUNT
        assert video.how == (COPIED if STREAMS[name][-1] else ENCODED)
    assert video.frames == COUNT
    kept_source = VideoConfig(tmp_path / "kept.mp4", "cam00").build()
    np.testing.assert_allclose(kept_source.times_ns(), own_ns, atol=1_000)
    found = list(kept_source.frames())
    np.testing.assert_allclose([frame.t_ns for frame in found], own_ns, atol=1_000)
    np.testing.assert_allclose([np.median(one.image) for one in found], [grey(i) for i in range(COUNT)], atol=20)
    if video.how == COPIED:
        same_images(found, given)
    check_lengths(tmp_path / "kept.mp4")


@pytest.mark.parametrize("name", STREAMS)
def test_frames_from_a_time_on_are_those_of_the_whole_and_little_before_is_decoded(tmp_path: Path, name: str) -> None:
    source = replace(made_stream(tmp_path / "made", name), keep_encoded=False, offset_s=0.25, drift_ppm=40.0).build()
    whole = list(source.frames())
    for begin_ns in [0, *(frame.t_ns + 1 for frame in whole[::7]), whole[-1].t_ns]:
        found = list(source.frames_from(begin_ns))
        expected = [frame for frame in whole if frame.t_ns >= begin_ns]
        assert [(one.seq, one.t_ns) for one in found] == [(one.seq, one.t_ns) for one in expected]
        same_images(found, expected)
    if "a long GOP" not in name and "as it is" not in name and name not in ("VP8", "MPEG-4 with B-frames"):
        first = next(source._frames(source._key_before(whole[-1].t_ns)))
        assert first.seq >= COUNT - 2 * 12, "the last key frame or the one before"


def test_intra_refresh_marks_frames_that_do_not_show_all_and_is_decoded_from_the_start(tmp_path: Path) -> None:
    texture = np.random.default_rng(0).integers(0, 255, (120, 160, 3), np.uint8)
    rolled = [np.roll(texture, i, axis=1) for i in range(100)]
    write_video(tmp_path / "made.ts", rolled, options={"intra-refresh": "1", "g": "30", "bf": "0"}, format="mpegts")
    source = VideoConfig(tmp_path / "made.ts", "cam00").build()
    # frames 60 to 67 are not decoded from the mark at 60
    whole = list(source.frames())[62:]
    same_images(source.frames_from(whole[0].t_ns), whole)


def check_lengths(path: Path) -> None:
    """Units of H.264 and HEVC begin with their lengths, as other players want it; the reader here takes others, too."""
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        for packet in container.demux(stream) if stream.codec_context.name in ("h264", "hevc") else ():
            data, at = bytes(packet), 0
            while at < len(data):
                at += 4 + int.from_bytes(data[at : at + 4], "big")
            assert at == len(data)


@pytest.mark.parametrize("name", ["x264 B-frames", "x264 open GOP", "x265 open GOP"])
def test_a_video_begins_with_the_first_keyframe_and_loses_nothing_after_it(tmp_path: Path, name: str) -> None:
    """A camera whose recording is switched on while it runs."""
    given = list(made_stream(tmp_path / "made", name).build().frames())
    with KeptVideo(tmp_path / "kept.mp4") as video:
        taken = [not video.write(kept(frame), frame.t_ns) for frame in given[5:]]
    begin = taken.index(True)
    assert 0 < begin < 12 and all(taken[begin:])
    same_images(read_all(tmp_path / "kept.mp4"), given[5 + begin :])


@pytest.mark.parametrize("name", ["x264 B-frames", "x264 open GOP"])
def test_a_video_that_ends_anywhere_holds_all_that_was_shown(tmp_path: Path, name: str) -> None:
    given = list(made_stream(tmp_path / "made", name).build().frames())
    for count in (1, 2, 3, 4, 17, 18):
        with KeptVideo(tmp_path / f"{count}.mp4") as video:
            assert write_all(video, given[:count]) == count
        shown = {round(frame.t_ns / 1000) for frame in read_all(tmp_path / f"{count}.mp4")}
        assert {round(frame.t_ns / 1000) for frame in given[:count]} <= shown


def test_a_camera_that_sets_its_clock_back_loses_no_frame(tmp_path: Path) -> None:
    source = replace(made_stream(tmp_path / "made", "x264 without B-frames"), threads=False).build()
    with KeptVideo(tmp_path / "kept.mp4") as video:
        for i, frame in enumerate(source.frames()):
            [packet], back_ns = frame.encoded.packets, (i > 20) * 60_000_000_000
            packet = replace(packet, stamp_ns=packet.stamp_ns - back_ns)
            encoded = replace(frame.encoded, packets=(packet,), stamp_ns=packet.stamp_ns)
            assert not video.write(encoded, frame.t_ns)
    assert video.frames == len(read_all(tmp_path / "kept.mp4")) == COUNT


def test_a_stream_without_presentation_times_is_encoded(tmp_path: Path) -> None:
    write_video(tmp_path / "a.h264", GREYS[:10], options=B_FRAMES, format="h264")
    with av.open(str(tmp_path / "a.h264")) as container:
        found = [encoded for _, encoded in decoded_with_packets(container, container.streams.video[0], True)]
    assert found == [None] * 10


def test_packets_left_out_cost_those_that_build_on_them_and_no_more(demo_session: Path, tmp_path: Path) -> None:
    made = list(frames(demo_session, True))
    keys = [i for i, frame in enumerate(made) if frame.encoded is not None and any(one.keyframe for one in frame.encoded.packets)]
    assert len(keys) > 1
    lost = keys[1] - 20
    with KeptVideo(tmp_path / "a.mp4") as video:
        written = [not video.write(kept(frame), frame.t_ns) for i, frame in enumerate(made) if i != lost]
    expected = [i < lost or i >= keys[1] for i in range(len(made)) if i != lost]
    assert written == expected
    good = [frame for i, frame in enumerate(made) if i < lost or i >= keys[1]]
    same_images(read_all(tmp_path / "a.mp4"), good)


@pytest.mark.parametrize("name", ["x264 B-frames, pyramid, a long GOP", "motion JPEG", "VP8"])
def test_of_a_video_that_was_killed_all_but_the_last_second_is_readable(tmp_path: Path, name: str) -> None:
    source = made_stream(tmp_path / "made", name).build()
    video = KeptVideo(tmp_path / "a.mp4")
    for frame in source.frames():
        assert not video.write(kept(frame), frame.t_ns)
        last_ns = frame.t_ns
    # as it is on the disk now
    (tmp_path / "cut.mp4").write_bytes((tmp_path / "a.mp4").read_bytes())
    video.close()
    times = [frame.t_ns for frame in read_all(tmp_path / "cut.mp4")]
    whole = [frame.t_ns for frame in read_all(tmp_path / "a.mp4")]
    assert times == whole[: len(times)]
    assert times[-1] >= last_ns - 1_000_000_000


def test_no_video_is_written_over_and_what_does_not_fit_is_named(demo_session: Path, tmp_path: Path) -> None:
    first, second, *_ = frames(demo_session, True)
    with KeptVideo(tmp_path / "a.mp4") as video:
        assert not video.write(kept(first), 5_000_000)
        assert "not later" in video.write(kept(second), 5_000_000)
        assert "another size or encoding" in video.write(Pixels(np.zeros((4, 4, 3), np.uint8)), 6_000_000)
    refusal(InputError, "no video is written over", KeptVideo, tmp_path / "a.mp4")
    refusal(InputError, "cannot be written", KeptVideo, tmp_path / "missing" / "a.mp4")


def served(path: Path, listener: socket.socket) -> None:
    """Send a file to the first that asks for it, over HTTP."""
    with listener, listener.accept()[0] as client:
        client.recv(4096)
        raw = path.read_bytes()
        client.sendall(f"HTTP/1.0 200 OK\r\nContent-Length: {len(raw)}\r\n\r\n".encode() + raw)


@pytest.mark.parametrize("name", ["x264 B-frames", "x264 open GOP", "x265 open GOP"])
def test_a_network_camera_with_reordered_frames_loses_none(tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its clock runs since a day, and it sends frames in bursts."""
    monkeypatch.setitem(STREAMS, name, (*STREAMS[name][:2], "mpegts", 90_000, 86_400 * 90_000, True))
    made_stream(tmp_path / "made", name)
    with socket.create_server(("127.0.0.1", 0)) as listener:
        threading.Thread(target=served, args=(tmp_path / "made", listener.dup()), daemon=True).start()
        source = StreamConfig(where=f"http://127.0.0.1:{listener.getsockname()[1]}", camera="cam00", keep_encoded=True).build()
    zero_ns, given = time.time_ns() - 1_000_000_000, []
    with KeptVideo(tmp_path / "kept.mp4") as video, pytest.raises(SourceError, match="has ended"):
        for frame in source.frames():
            given.append(frame)
            assert not video.write(kept(frame), frame.t_ns - zero_ns)
    source.close()
    # what was looked at to find out the format is gone
    assert video.how == COPIED and COUNT // 3 < len(given) == video.frames
    found = read_all(tmp_path / "kept.mp4")
    np.testing.assert_allclose([one.t_ns + zero_ns for one in found], [one.t_ns for one in given], rtol=0, atol=1_000)
    same_images(found, given)
