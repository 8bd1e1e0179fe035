"""Videos kept while a camera delivers them: true times, no transcoding where packets come, readable when cut off."""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import av
import numpy as np
import pytest

from posefuse.core import Frame, InputError
from posefuse.formats.kept_video import COPIED, ENCODED, KeptVideo
from posefuse.sources.video import VideoConfig

# a camera that runs freely, its first frame well after the session's zero
T_NS = 1_234_567_891 + np.cumsum(33_000_000 + np.random.default_rng(0).integers(0, 900_000, 90))


def frames(demo: Path, encoded: bool) -> Iterator[Frame]:
    """With times that no frame rate gives."""
    source = VideoConfig(demo / "videos" / "cam00.mp4", "cam00", keep_encoded=encoded).build()
    for frame, t_ns in zip(source.frames(), T_NS.tolist(), strict=False):
        yield replace(frame, t_ns=t_ns)


def write_all(video: KeptVideo, made: Iterable[Frame]) -> int:
    """How many were taken."""
    return sum(video.write(frame, frame.t_ns) for frame in made)


@pytest.mark.parametrize("copied", [True, False])
def test_every_frame_comes_back_at_its_time(demo_session: Path, tmp_path: Path, copied: bool) -> None:
    path = tmp_path / "cam00.mp4"
    with KeptVideo(path) as video:
        assert write_all(video, frames(demo_session, copied)) == len(T_NS)
        assert video.how == (COPIED if copied else ENCODED)
    source = VideoConfig(path, "cam00").build()
    found = list(source.frames())
    np.testing.assert_allclose(source.times_ns(), T_NS, atol=1_000)
    np.testing.assert_allclose([frame.t_ns for frame in found], T_NS, atol=1_000)
    for one, other in zip(found, frames(demo_session, False), strict=True):
        if copied:
            np.testing.assert_array_equal(one.image, other.image)
        else:
            assert np.abs(one.image.astype(int) - other.image).mean() < 4


def test_packets_are_copied_and_not_encoded_again(demo_session: Path, tmp_path: Path) -> None:
    with KeptVideo(tmp_path / "a.mp4") as video:
        for frame in frames(demo_session, True):
            # a black image that is not looked at
            video.write(replace(frame, image=np.zeros_like(frame.image)), frame.t_ns)
    first = next(VideoConfig(tmp_path / "a.mp4", "cam00").build().frames())
    assert first.image.mean() > 20


def test_a_packet_left_out_costs_those_that_build_on_it_and_no_more(demo_session: Path, tmp_path: Path) -> None:
    made = list(frames(demo_session, True))
    keys = [i for i, frame in enumerate(made) if frame.encoded is not None and frame.encoded.keyframe]
    assert len(keys) > 1
    lost = keys[1] - 20
    with KeptVideo(tmp_path / "a.mp4") as video:
        written = [video.write(frame, frame.t_ns) for i, frame in enumerate(made) if i != lost]
    expected = [i < lost or i >= keys[1] for i in range(len(made)) if i != lost]
    assert written == expected
    found = list(VideoConfig(tmp_path / "a.mp4", "cam00").build().frames())
    good = [frame for i, frame in enumerate(made) if i < lost or i >= keys[1]]
    for one, other in zip(found, good, strict=True):
        np.testing.assert_array_equal(one.image, other.image)


def test_packets_of_frames_that_were_left_out_are_kept_too(demo_session: Path, tmp_path: Path) -> None:
    made = list(frames(demo_session, True))
    assert made[5].encoded is not None
    earlier = tuple((made[5].t_ns - one.t_ns, one.encoded) for one in made[3:5] if one.encoded is not None)
    late = replace(made[5], encoded=replace(made[5].encoded, earlier=earlier))
    with KeptVideo(tmp_path / "a.mp4") as video:
        assert write_all(video, [*made[:3], late, *made[6:]]) == len(made) - 2
    np.testing.assert_allclose(VideoConfig(tmp_path / "a.mp4", "cam00").build().times_ns(), T_NS, atol=1_000)


def test_a_file_cut_off_is_readable_up_to_there(demo_session: Path, tmp_path: Path) -> None:
    with KeptVideo(tmp_path / "a.mp4") as video:
        for frame in frames(demo_session, True):
            video.write(frame, frame.t_ns)
    raw = (tmp_path / "a.mp4").read_bytes()
    (tmp_path / "cut.mp4").write_bytes(raw[: len(raw) * 2 // 3])
    times = [frame.t_ns for frame in VideoConfig(tmp_path / "cut.mp4", "cam00").build().frames()]
    assert 20 < len(times) < len(T_NS)
    np.testing.assert_allclose(times, T_NS[: len(times)], atol=1_000)


def test_a_stream_with_reordered_frames_has_no_packets_to_copy(demo_session: Path, tmp_path: Path) -> None:
    path = tmp_path / "b.mp4"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=30, options={"bf": "3", "b-adapt": "0"})
        stream.width, stream.height = 640, 480
        for frame, _ in zip(frames(demo_session, False), range(20), strict=False):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame.image)))
        container.mux(stream.encode(None))
    found = list(VideoConfig(path, "cam00", keep_encoded=True).build().frames())
    assert len(found) == 20
    with KeptVideo(tmp_path / "a.mp4") as video:
        written = [video.write(replace(frame, encoded=None), frame.t_ns + 1) for frame in found]
        assert video.how == ENCODED
    assert all(written)
    assert any(frame.encoded is None for frame in found)


def test_no_video_is_written_over_and_times_increase(demo_session: Path, tmp_path: Path) -> None:
    first, second, *_ = frames(demo_session, True)
    with KeptVideo(tmp_path / "a.mp4") as video:
        assert video.write(first, 5_000_000)
        assert not video.write(second, 5_000_000)
        assert not video.write(replace(second, image=np.zeros((4, 4, 3), np.uint8)), 6_000_000)
    with pytest.raises(InputError, match="no video is written over"):
        KeptVideo(tmp_path / "a.mp4")
    with pytest.raises(InputError, match="cannot be written"):
        KeptVideo(tmp_path / "missing" / "a.mp4")
