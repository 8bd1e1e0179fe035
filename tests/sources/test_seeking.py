"""Jumping about in a recording gives the frames that reading it from the start gives."""

from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from remuxed import remuxed

from posefuse.core import SourceError
from posefuse.formats.video import VideoWriter
from posefuse.sources import ImagesConfig, VideoConfig
from posefuse.sources.seeking import ImagesSeeker, VideoSeeker, nearest

COUNT, SIZE_WH = 150, (64, 48)


def image_of(i: int) -> np.ndarray:
    image = np.full((SIZE_WH[1], SIZE_WH[0], 3), 30 + i, np.uint8)
    image[:, i % SIZE_WH[0]] = 255
    return image


@pytest.fixture(scope="module")
def video(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With times that are not even."""
    path = tmp_path_factory.mktemp("video") / "cam.mp4"
    with VideoWriter(path, SIZE_WH, 30.0) as writer:
        for i in range(COUNT):
            writer.write(image_of(i), i * 33_333_333 + (i % 3) * 4_000_000)
    return path


@pytest.fixture(scope="module")
def reordered(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """As phones write them: frames stored in another order than they are shown, few key frames, an arbitrary start."""
    path = tmp_path_factory.mktemp("video") / "phone.ts"
    with av.open(str(path), "w", format="mpegts") as container:
        stream = container.add_stream("libx264", rate=30, options={"bf": "3", "g": "50", "preset": "veryfast"})
        stream.width, stream.height, stream.pix_fmt = *SIZE_WH, "yuv420p"
        for i in range(COUNT):
            frame = av.VideoFrame.from_ndarray(image_of(i), format="rgb24")
            frame.pts, frame.time_base = i, Fraction(1, 30)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path


@pytest.mark.parametrize("name", ["video", "reordered"])
def test_any_order_gives_the_frames_of_reading_on(name: str, request: pytest.FixtureRequest) -> None:
    config = VideoConfig(request.getfixturevalue(name), "cam", offset_s=0.25, drift_ppm=40.0)
    source, seeker = config.build(), VideoSeeker(config)
    frames = list(source.frames())
    np.testing.assert_array_equal(seeker.times_ns, source.times_ns())
    assert seeker.times_ns.tolist() == [frame.t_ns for frame in frames]
    order = [0, 149, 3, 4, 5, 120, 61, 60, 59, 60, *np.random.default_rng(0).integers(0, COUNT, 15).tolist()]
    for i in order:
        got = seeker.at(i)
        assert (got.t_ns, got.camera) == (frames[i].t_ns, "cam")
        np.testing.assert_array_equal(got.image, frames[i].image)
    seeker.close()


def test_reading_on_decodes_each_frame_once(video: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seeker = VideoSeeker(VideoConfig(video, "cam"))
    starts, begin = [], seeker._decoded

    def counted():
        starts.append(1)
        return begin()

    monkeypatch.setattr(seeker, "_decoded", counted)
    for i in range(60):
        seeker.at(i)
    assert len(starts) == 1
    seeker.at(10)
    assert len(starts) == 2


def test_images_are_found_by_their_times(tmp_path: Path) -> None:
    for i in range(5):
        cv2.imwrite(str(tmp_path / f"{i}.png"), image_of(i))
    seeker = ImagesSeeker(ImagesConfig(tmp_path, "cam", rate_hz=10.0, offset_s=1.0).build())
    np.testing.assert_array_equal(seeker.at(3).image, image_of(3))
    assert seeker.at(3).t_ns == 1_300_000_000
    (tmp_path / "2.png").write_bytes(b"no image")
    with pytest.raises(SourceError, match=r"2\.png"):
        seeker.at(2)


@pytest.mark.parametrize(("t_ns", "place"), [(-5, 0), (0, 0), (14, 1), (15, 1), (16, 2), (99, 2)])
def test_the_nearest_frame(t_ns: int, place: int) -> None:
    assert nearest(np.array([0, 10, 20]), t_ns) == place


def test_a_file_that_ends_early_gives_what_there_is(video: Path, tmp_path: Path) -> None:
    cut = remuxed(video, tmp_path / "cut.ts", format="mpegts")
    cut.write_bytes(cut.read_bytes()[:-2000])
    seeker = VideoSeeker(VideoConfig(cut, "cam"))
    assert 0 < len(seeker.times_ns) <= COUNT
    seeker.at(0)
    with pytest.raises(SourceError, match="no such video"):
        VideoSeeker(VideoConfig(tmp_path / "none.mp4", "cam"))
