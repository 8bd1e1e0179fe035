"""Videos and image folders as sources: times, order, faults."""

import itertools
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from posefuse.core import Frame, Source, SourceError
from posefuse.sources import FramesAhead, ImagesConfig, VideoConfig, frame_sets

SIZE_WH = (64, 48)


def write_video(path: Path, times_s: list[float], size_wh: tuple[int, int] = SIZE_WH) -> Path:
    """A clip whose frame i has brightness 10 * i % 250, at exactly these times."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=30)
        stream.width, stream.height = size_wh
        stream.pix_fmt = "yuv420p"
        stream.time_base = stream.codec_context.time_base = Fraction(1, 90_000)
        stream.codec_context.options = {"crf": "10"}
        for i, time_s in enumerate(times_s):
            frame = av.VideoFrame.from_ndarray(np.full((size_wh[1], size_wh[0], 3), 10 * i % 250, np.uint8), format="rgb24")
            frame.pts, frame.time_base = round(time_s * 90_000), stream.time_base
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def brightness(frame: Frame) -> float:
    return float(frame.image.mean())


def test_presentation_times_are_kept_with_variable_rate_and_offset(tmp_path: Path) -> None:
    times_s = [0.02, 0.05, 0.09, 0.10, 0.21]
    source = VideoConfig(write_video(tmp_path / "a.mp4", times_s), "cam", offset_s=0.5).build()
    assert isinstance(source, Source)
    frames = list(source.frames())
    assert source.size_wh == SIZE_WH
    assert [f.seq for f in frames] == [0, 1, 2, 3, 4]
    assert np.allclose([f.t_ns * 1e-9 for f in frames], np.array(times_s) + 0.5, atol=2e-5)
    assert np.array_equal(source.times_ns(), [f.t_ns for f in frames])
    assert np.allclose([brightness(f) for f in frames], [0, 10, 20, 30, 40], atol=3)
    assert [f.t_ns for f in source.frames()] == [f.t_ns for f in frames], "frames() starts again from the beginning"


def test_transport_stream_counts_from_its_first_frame(tmp_path: Path) -> None:
    source = VideoConfig(write_video(tmp_path / "a.ts", [i / 25 for i in range(40)]), "cam").build()
    times_ns = [f.t_ns for f in source.frames()]
    assert times_ns[0] == 0
    assert np.array_equal(source.times_ns()[: len(times_ns)], times_ns)


def test_broken_bytes_cost_only_some_frames(tmp_path: Path) -> None:
    path = write_video(tmp_path / "a.mp4", [i / 30 for i in range(25)])
    content = bytearray(path.read_bytes())
    middle = content.index(b"mdat") + 900
    content[middle : middle + 40] = bytes(40)
    path.write_bytes(content)
    source = VideoConfig(path, "cam").build()
    frames = list(source.frames())
    assert len(frames) >= 1
    assert all(later.t_ns > earlier.t_ns for earlier, later in itertools.pairwise(frames))
    assert source.broken_frames >= 1


@pytest.mark.parametrize("content", [b"", b"not a video at all" * 100])
def test_unreadable_video_is_one_line_with_file_and_camera(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "bad.mp4"
    path.write_bytes(content)
    with pytest.raises(SourceError, match=r"bad\.mp4: camera left:") as caught:
        VideoConfig(path, "left").build()
    assert "\n" not in str(caught.value)
    with pytest.raises(SourceError, match="no such video file"):
        VideoConfig(tmp_path / "none.mp4", "left").build()


def write_images(folder: Path, count: int) -> Path:
    folder.mkdir()
    for i in range(count):
        cv2.imwrite(str(folder / f"{i:03d}.png"), np.full((48, 64, 3), (0, 0, 10 * i), np.uint8))
    return folder


def test_images_are_rgb_in_order_with_rate_or_times_file(tmp_path: Path) -> None:
    folder = write_images(tmp_path / "cam", 4)
    source = ImagesConfig(folder, "cam", rate_hz=50.0).build()
    assert isinstance(source, Source)
    frames = list(source.frames())
    assert [f.t_ns for f in frames] == [0, 20_000_000, 40_000_000, 60_000_000]
    assert tuple(frames[3].image[0, 0]) == (30, 0, 0)
    (folder / "timestamps.csv").write_text("file,t_s\n002.png,0.1\n001.png,0.25\n")
    timed = ImagesConfig(folder, "cam").build()
    assert [(f.t_ns, f.image[0, 0, 0]) for f in timed.frames()] == [(100_000_000, 20), (250_000_000, 10)]
    (folder / "timestamps.csv").write_text("file,t_s\n002.png,0.3\n001.png,0.25\n")
    with pytest.raises(SourceError, match="strictly increasing"):
        ImagesConfig(folder, "cam").build()
    (folder / "timestamps.csv").write_text("name,seconds\n002.png,0.3\n")
    with pytest.raises(SourceError, match="expected columns file, t_s"):
        ImagesConfig(folder, "cam").build()
    (folder / "timestamps.csv").unlink()
    with pytest.raises(SourceError, match=r"do not state their frame rate; add `rate_hz=HZ`, .* or timestamps\.csv"):
        ImagesConfig(folder, "cam").build()


def test_a_broken_image_is_counted_and_an_empty_folder_named(tmp_path: Path) -> None:
    folder = write_images(tmp_path / "cam", 3)
    (folder / "001.png").write_bytes(b"oops")
    source = ImagesConfig(folder, "cam", rate_hz=30.0).build()
    assert [f.seq for f in source.frames()] == [0, 2]
    assert source.broken_frames == 1
    (tmp_path / "empty").mkdir()
    with pytest.raises(SourceError, match="no readable image"):
        ImagesConfig(tmp_path / "empty", "cam").build()


class Scripted:
    """A source of blank frames at given times that fails after the last on request."""

    def __init__(self, camera: str, times_ms: list[int], fails: bool = False) -> None:
        self.camera, self.size_wh, self.closed = camera, SIZE_WH, False
        self._times_ms, self._fails = times_ms, fails

    def frames(self):
        for seq, time_ms in enumerate(self._times_ms):
            yield Frame(
                camera=self.camera, seq=seq, t_ns=time_ms * 1_000_000, received_ns=0, image=np.zeros((48, 64, 3), np.uint8)
            )
        if self._fails:
            raise SourceError(f"camera {self.camera}: unplugged")

    def close(self) -> None:
        self.closed = True


def grouped_ms(sets) -> list[tuple[int | None, ...]]:
    return [tuple(None if f is None else f.t_ns // 1_000_000 for f in s.frames) for s in sets]


def test_frames_go_to_the_nearest_time_step_and_none_is_used_twice() -> None:
    streams = {"a": Scripted("a", [0, 10, 20, 30]).frames(), "b": Scripted("b", [4, 13, 33, 41]).frames()}
    sets = list(frame_sets(streams, start_ns=0, period_ns=10_000_000))
    assert grouped_ms(sets) == [(0, 4), (10, 13), (20, None), (30, 33), (None, 41)]
    assert [s.t_ns // 1_000_000 for s in sets] == [0, 10, 20, 30, 40]


def test_a_failing_camera_is_reported_and_the_rest_continues() -> None:
    lost: list[str] = []
    streams = {"a": Scripted("a", [0, 10], fails=True).frames(), "b": Scripted("b", [0, 10, 20, 30]).frames()}
    sets = list(frame_sets(streams, 0, 10_000_000, on_lost=lambda name, error: lost.append(f"{name}: {error}")))
    assert grouped_ms(sets) == [(0, 0), (10, 10), (None, 20), (None, 30)]
    assert lost == ["a: camera a: unplugged"]
    with pytest.raises(SourceError, match="unplugged"):
        list(frame_sets({"a": Scripted("a", [0], fails=True).frames()}, 0, 10_000_000))


def test_reading_ahead_keeps_order_hands_on_errors_and_stops() -> None:
    assert [f.seq for f in FramesAhead(Scripted("a", list(range(50))), depth=3)] == list(range(50))
    with pytest.raises(SourceError, match="unplugged"):
        list(FramesAhead(Scripted("a", [0, 1], fails=True)))
    endless = Scripted("a", list(range(10_000)))
    ahead = FramesAhead(endless, depth=2)
    assert next(iter(ahead)).seq == 0
    ahead.close()
    assert endless.closed
