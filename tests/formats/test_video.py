"""Videos: every frame keeps its time, parts join without a seam, and images are converted when they are used."""

from __future__ import annotations

import itertools
from fractions import Fraction
from pathlib import Path

import av
import built
import numpy as np
import pytest
from checks import assert_same, refusal
from hypothesis import given
from hypothesis import strategies as st

from posefuse.core import InputError
from posefuse.core.depth import DepthImage
from posefuse.core.frames import Pixels
from posefuse.formats.video import DecodedPixels, PixelConverter, VideoWriter
from posefuse.sources import FramesAhead, VideoConfig
from posefuse.sources.live import PacedVideoConfig
from posefuse.sources.video import ticks_ns


def _image(i: int, size_wh=(96, 64)) -> np.ndarray:
    columns, rows = np.meshgrid(np.arange(size_wh[0]), np.arange(size_wh[1]))
    return np.stack([columns * 2, rows * 3, np.full_like(rows, (20 + 23 * i) % 256)], axis=-1).astype(np.uint8)


def _write(path: Path, t_ns, first: int = 0, size_wh=(96, 64), crf: int = 8) -> None:
    with VideoWriter(path, size_wh, 30.0, crf) as writer:
        for i, t in enumerate(t_ns):
            writer.write(_image(first + i, size_wh), int(t))


def _same(path: Path, t_ns) -> None:
    """The video has these frames at these times."""
    frames = list(VideoConfig(path, "cam").build().frames())
    np.testing.assert_allclose([frame.t_ns for frame in frames], t_ns, atol=501)
    for i, frame in enumerate(frames):
        assert np.abs(frame.image.astype(int) - _image(i)).mean() < 6


def test_uneven_times_and_a_late_start_come_back_to_the_microsecond(tmp_path: Path):
    t_ns = np.array([1_300_207_319, 1_333_000_000, 1_333_001_000, 1_900_000_499, 60_000_000_000])
    _write(tmp_path / "a.mp4", t_ns)
    _same(tmp_path / "a.mp4", t_ns)


@pytest.mark.parametrize("size_wh", [(96, 64), (97, 64), (96, 63), (33, 35)])
def test_any_size_keeps_its_size(tmp_path: Path, size_wh):
    _write(tmp_path / "a.mp4", [0, 33_000_000], size_wh=size_wh)
    frames = VideoConfig(tmp_path / "a.mp4", "cam").build().frames()
    assert [frame.image.shape for frame in frames] == [(size_wh[1], size_wh[0], 3)] * 2


def test_same_frames_same_bytes(tmp_path: Path):
    for name in ("a.mp4", "b.mp4"):
        _write(tmp_path / name, np.arange(70) * 33_000_000)
    assert (tmp_path / "a.mp4").read_bytes() == (tmp_path / "b.mp4").read_bytes()


def test_wrong_frames_and_times_are_refused(tmp_path: Path):
    with VideoWriter(tmp_path / "a.mp4", (96, 64), 30.0) as writer:
        with pytest.raises(InputError, match=r"expected RGB uint8 frames of \(96, 64\) px, got uint8 \(10, 10, 3\)"):
            writer.write(np.zeros((10, 10, 3), np.uint8), 0)
        writer.write(_image(0), 5_000_000)
        refusal(InputError, "each later than 5000 us, got 5000 us", lambda: writer.write(_image(1), 5_000_400))


def test_files_that_cannot_be_are_named(tmp_path: Path):
    refusal(InputError, "nowhere", VideoWriter, tmp_path / "nowhere" / "a.mp4", (96, 64), 30.0)
    (tmp_path / "text.mp4").write_text("no video")


STEP = 12


def decoded_frame(size_wh: tuple[int, int], pixel_format: str) -> av.VideoFrame:
    """A colourful image without edges, in the camera's format."""
    x, y = np.meshgrid(np.linspace(0, 1, size_wh[0]), np.linspace(0, 1, size_wh[1]))
    image = np.stack([40 + 180 * x, 220 - 180 * y, 60 + 120 * (x * y)], axis=-1).astype(np.uint8)
    return av.VideoFrame.from_ndarray(image, format="rgb24").reformat(format=pixel_format)


@pytest.mark.parametrize("pixel_format", ["yuv420p", "yuv422p", "yuv444p", "yuvj420p", "yuvj422p", "yuyv422", "rgb24", "nv12"])
@pytest.mark.parametrize("size_wh", [(640, 480), (322, 242), (54, 40)])
def test_brightness_is_that_of_every_so_many_pixels_of_the_image(pixel_format: str, size_wh: tuple[int, int]) -> None:
    pixels = DecodedPixels(decoded_frame(size_wh, pixel_format), PixelConverter())
    found, image = pixels.brightness(STEP), pixels.rgb()[::STEP, ::STEP]
    assert found.shape == image.shape[:2]
    assert found.dtype == np.uint8
    # whatever the range of the format
    assert np.corrcoef(found.ravel(), (image @ [0.299, 0.587, 0.114]).ravel())[0, 1] > 0.99
    assert pixels.rgb() is pixels.rgb()


@pytest.mark.parametrize("pixel_format", ["yuv420p", "yuvj422p", "yuyv422", "rgb24"])
def test_different_images_differ_in_brightness(pixel_format: str) -> None:
    first, same, other = (decoded_frame(size_wh, pixel_format) for size_wh in ((322, 242), (322, 242), (322, 252)))
    found = [DecodedPixels(one, PixelConverter()).brightness(STEP).tobytes() for one in (first, same, other)]
    assert found[0] == found[1] != found[2]


def test_frames_that_are_not_used_are_not_converted(demo_session: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = PacedVideoConfig(demo_session / "videos" / "cam00.mp4", "cam00").build()
    converted: list[int] = []
    before = PixelConverter.rgb
    monkeypatch.setattr(PixelConverter, "rgb", lambda self, decoded: converted.append(1) or before(self, decoded))
    arrived = list(itertools.islice(source.frames(), 6))
    assert [one.pixels.brightness(STEP).shape for one in arrived] == [(40, 54)] * 6
    assert not converted
    assert arrived[2].image is arrived[2].image
    assert len(converted) == 1


def test_the_thread_that_decodes_ahead_converts(demo_session: Path) -> None:
    """And keeps no decoded frames: they take half as much memory again."""
    ahead = FramesAhead(VideoConfig(demo_session / "videos" / "cam00.mp4", "cam00").build())
    try:
        assert [type(frame.pixels) for frame in itertools.islice(ahead, 3)] == [Pixels] * 3
    finally:
        ahead.close()


def test_a_converted_frame_keeps_all_that_it_has() -> None:
    """The depth of a camera, too."""
    depth = DepthImage(values=np.ones((4, 6), np.uint16))
    frame = built.frame(t_ns=5, image=np.zeros((4, 6, 3), np.uint8), seq=3, received_ns=9, depth=depth)
    assert_same(frame.converted(), frame)


@given(
    ticks=st.integers(-(10**9), 10**12),
    base=st.fractions(Fraction(1, 10**6), 2, max_denominator=10**6),
    offset_s=st.floats(-1e4, 1e4),
    drift_ppm=st.sampled_from([0.0, 37.5, -120.0]),
)
def test_times_in_whole_numbers_are_exact_fractions(ticks: int, base: Fraction, offset_s: float, drift_ppm: float) -> None:
    config = VideoConfig(Path("a.mp4"), "a", offset_s=offset_s, drift_ppm=drift_ppm)
    time_s = ticks * base
    wanted = round(time_s * 1_000_000_000) + round(offset_s * 1e9 + float(time_s) * drift_ppm * 1e3)
    assert ticks_ns(config, ticks, base) == wanted
