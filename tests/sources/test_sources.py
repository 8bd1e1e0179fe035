"""Videos and image folders as sources: times, order, faults, and how much of a camera can be read."""

import itertools
import threading
from contextlib import closing
from fractions import Fraction
from pathlib import Path
from unittest.mock import Mock

import cv2
import numpy as np
import pytest
from checks import refusal
from videos import ScriptedSource, remuxed, write_video

from posefuse.core import Frame, Source, SourceError
from posefuse.formats.video import VideoWriter
from posefuse.pipeline.time_steps import decoded
from posefuse.sources import CountedSource, Coverage, FramesAhead, ImagesConfig, VideoConfig, frame_sets, incomplete_cameras
from posefuse.sources.seeking import Seeker, nearest
from posefuse.sources.video import recorded_at

SIZE_WH = (64, 48)


def write_clip(path: Path, times_s: list[float]) -> Path:
    """A clip whose frame i has brightness 10 * i % 250, at exactly these times."""
    images = [np.full((SIZE_WH[1], SIZE_WH[0], 3), 10 * i % 250, np.uint8) for i in range(len(times_s))]
    pts = [round(time_s * 90_000) for time_s in times_s]
    return write_video(path, images, base=Fraction(1, 90_000), pts=pts, options={"crf": "10"})


def brightness(frame: Frame) -> float:
    return float(frame.image.mean())


def test_presentation_times_are_kept_with_variable_rate_and_offset(tmp_path: Path) -> None:
    times_s = [0.02, 0.05, 0.09, 0.10, 0.21]
    source = VideoConfig(write_clip(tmp_path / "a.mp4", times_s), "cam", offset_s=0.5).build()
    assert isinstance(source, Source)
    frames = list(source.frames())
    assert (source.size_wh, [f.seq for f in frames]) == (SIZE_WH, [0, 1, 2, 3, 4])
    assert np.allclose([f.t_ns * 1e-9 for f in frames], np.array(times_s) + 0.5, atol=2e-5)
    assert np.array_equal(source.times_ns(), [f.t_ns for f in frames])
    assert np.allclose([brightness(f) for f in frames], [0, 10, 20, 30, 40], atol=3)
    assert [f.t_ns for f in source.frames()] == [f.t_ns for f in frames], "frames() starts again from the beginning"


def test_transport_stream_counts_from_its_first_frame(tmp_path: Path) -> None:
    source = VideoConfig(write_clip(tmp_path / "a.ts", [i / 25 for i in range(40)]), "cam").build()
    times_ns = [f.t_ns for f in source.frames()]
    assert times_ns[0] == 0
    assert np.array_equal(source.times_ns()[: len(times_ns)], times_ns)


def test_broken_bytes_cost_only_some_frames(tmp_path: Path) -> None:
    path = write_clip(tmp_path / "a.mp4", [i / 30 for i in range(25)])
    content = bytearray(path.read_bytes())
    middle = content.index(b"mdat") + 900
    content[middle : middle + 40] = bytes(40)
    path.write_bytes(content)
    source = VideoConfig(path, "cam").build()
    frames = list(source.frames())
    assert 1 <= len(frames) < 25
    assert all(later.t_ns > earlier.t_ns for earlier, later in itertools.pairwise(frames))


@pytest.mark.parametrize("content", [b"", b"not a video at all" * 100])
def test_unreadable_video_is_one_line_with_file_and_camera(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "bad.mp4"
    path.write_bytes(content)
    refusal(SourceError, r"bad\.mp4: camera left:", lambda: VideoConfig(path, "left").build())
    refusal(SourceError, "no such video file", lambda: VideoConfig(tmp_path / "none.mp4", "left").build())


def write_images(folder: Path, count: int) -> Path:
    folder.mkdir()
    for i in range(count):
        cv2.imwrite(str(folder / f"{i:03d}.png"), np.full((48, 64, 3), (0, 0, 10 * i), np.uint8))
    return folder


def test_images_are_rgb_in_order_with_rate_or_times_file(tmp_path: Path) -> None:
    folder = write_images(tmp_path / "cam", 4)
    build = ImagesConfig(folder, "cam").build
    source = ImagesConfig(folder, "cam", rate_hz=50.0).build()
    assert isinstance(source, Source)
    frames = list(source.frames())
    assert [f.t_ns for f in frames] == [0, 20_000_000, 40_000_000, 60_000_000]
    assert tuple(frames[3].image[0, 0]) == (30, 0, 0)
    (folder / "timestamps.csv").write_text("file,t_s\n002.png,0.1\n001.png,0.25\n")
    assert [(f.t_ns, f.image[0, 0, 0]) for f in build().frames()] == [(100_000_000, 20), (250_000_000, 10)]
    (folder / "timestamps.csv").write_text("file,t_s\n002.png,0.3\n001.png,0.25\n")
    refusal(SourceError, "strictly increasing", build)
    (folder / "timestamps.csv").write_text("name,seconds\n002.png,0.3\n")
    refusal(SourceError, "expected columns file, t_s", build)
    (folder / "timestamps.csv").unlink()
    refusal(SourceError, r"do not state their frame rate; add `rate_hz=HZ`, .* or timestamps\.csv", build)


def test_images_are_in_the_order_of_the_numbers_in_their_names(tmp_path: Path) -> None:
    """Many programs number without zeros in front: by letters, frame 10 came before frame 2."""
    names = ["take 1 frame 2.png", "take 1 frame 9.PNG", "take 1 frame 10.png", "take 1 frame 100.png", "take 2 frame 1.png"]
    for i, name in enumerate(names):
        cv2.imwrite(str(tmp_path / name), np.full((48, 64, 3), (0, 0, 10 * i), np.uint8))
    frames = ImagesConfig(tmp_path, "cam", rate_hz=50.0).build().frames()
    assert [int(frame.image[0, 0, 0]) for frame in frames] == [0, 10, 20, 30, 40]


def test_a_broken_image_is_left_out_and_an_empty_folder_named(tmp_path: Path) -> None:
    folder = write_images(tmp_path / "cam", 3)
    (folder / "001.png").write_bytes(b"oops")
    source = ImagesConfig(folder, "cam", rate_hz=30.0).build()
    assert [f.seq for f in source.frames()] == [0, 2]
    (tmp_path / "empty").mkdir()
    refusal(SourceError, "no readable image", lambda: ImagesConfig(tmp_path / "empty", "cam").build())


def ms(*times_ms: int) -> list[int]:
    return [1_000_000 * one for one in times_ms]


def grouped_ms(sets) -> list[tuple[int | None, ...]]:
    return [tuple(None if f is None else f.t_ns // 1_000_000 for f in s.frames) for s in sets]


def test_frames_go_to_the_nearest_time_step_and_none_is_used_twice() -> None:
    streams = {"a": ScriptedSource("a", ms(0, 10, 20, 30)).frames(), "b": ScriptedSource("b", ms(4, 13, 33, 41)).frames()}
    sets = list(frame_sets(streams, start_ns=0, period_ns=10_000_000))
    assert grouped_ms(sets) == [(0, 4), (10, 13), (20, None), (30, 33), (None, 41)]
    assert [s.t_ns // 1_000_000 for s in sets] == [0, 10, 20, 30, 40]


def test_a_failing_camera_is_reported_and_the_rest_continues() -> None:
    lost: list[str] = []
    streams = {"a": ScriptedSource("a", ms(0, 10), fails=True).frames(), "b": ScriptedSource("b", ms(0, 10, 20, 30)).frames()}
    sets = list(frame_sets(streams, 0, 10_000_000, on_lost=lambda name, error: lost.append(f"{name}: {error}")))
    assert grouped_ms(sets) == [(0, 0), (10, 10), (None, 20), (None, 30)]
    assert lost == ["a: camera a: unplugged"]
    alone = {"a": ScriptedSource("a", ms(0), fails=True).frames()}
    refusal(SourceError, "unplugged", list, frame_sets(alone, 0, 10_000_000))


def test_reading_ahead_keeps_order_hands_on_errors_and_stops() -> None:
    assert [f.seq for f in FramesAhead(ScriptedSource("a", range(50)), depth=3)] == list(range(50))
    refusal(SourceError, "unplugged", lambda: list(FramesAhead(ScriptedSource("a", ms(0, 1), fails=True))))
    endless = ScriptedSource("a", range(10_000))
    ahead = FramesAhead(endless, depth=2)
    assert next(iter(ahead)).seq == 0
    ahead.close()
    assert endless.closed


def test_ctrl_c_while_decoding_begins_leaves_no_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    """Threads of the cameras before stayed, each with its video open, for as long as the program ran."""
    before, start = set(threading.enumerate()), threading.Thread.start

    def interrupted(thread: threading.Thread) -> None:
        start(thread)
        if thread.name == "decode c":
            raise KeyboardInterrupt

    monkeypatch.setattr(threading.Thread, "start", interrupted)
    sources = [ScriptedSource(name, range(10_000)) for name in "abcd"]
    with pytest.raises(KeyboardInterrupt), closing(decoded(sources, 0, 10_000_000, 10**12)) as sets:
        next(sets)
    for thread in set(threading.enumerate()) - before:
        thread.join(5)
    assert set(threading.enumerate()) <= before


# --- jumping about in a recording gives the frames that reading it from the start gives


COUNT, HIDDEN = 150, 20


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
    options = {"bf": "3", "g": "50", "preset": "veryfast"}
    path = tmp_path_factory.mktemp("video") / "phone.ts"
    return write_video(path, [image_of(i) for i in range(COUNT)], options=options, format="mpegts")


@pytest.fixture(scope="module")
def trimmed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Its start is cut off without encoding again: the file holds it from a key frame on, and an edit list hides it."""
    folder, options = tmp_path_factory.mktemp("video"), {"bf": "3", "g": "50", "sc_threshold": "0", "preset": "veryfast"}
    whole = write_video(folder / "whole.mp4", [image_of(i) for i in range(COUNT)], options=options)
    return remuxed(whole, folder / "trimmed.mp4", hidden_s=Fraction(HIDDEN, 30))


@pytest.mark.parametrize("name", ["video", "reordered", "trimmed"])
def test_any_order_gives_the_frames_of_reading_on(name: str, request: pytest.FixtureRequest) -> None:
    config = VideoConfig(request.getfixturevalue(name), "cam", offset_s=0.25, drift_ppm=40.0)
    source, seeker = config.build(), Seeker(config.build())
    frames = list(source.frames())
    np.testing.assert_array_equal(seeker.times_ns, source.times_ns())
    assert seeker.times_ns.tolist() == [frame.t_ns for frame in frames]
    order = [0, len(frames) - 1, 3, 4, 5, 120, 61, 60, 59, 60, *np.random.default_rng(0).integers(0, len(frames), 15).tolist()]
    for i in order:
        got = seeker.at(i)
        assert (got.t_ns, got.camera) == (frames[i].t_ns, "cam")
        np.testing.assert_array_equal(got.image, frames[i].image)
    seeker.close()


def test_reading_on_decodes_each_frame_once(video: Path) -> None:
    source = VideoConfig(video, "cam").build()
    starts = source.frames_from = Mock(side_effect=source.frames_from)
    seeker = Seeker(source)
    for i in [*range(60), 59]:
        seeker.at(i)
    assert starts.call_count == 1
    seeker.at(10)
    assert starts.call_count == 2


def test_images_are_found_by_their_times_and_one_that_cannot_be_read_is_the_next(tmp_path: Path) -> None:
    for i in range(5):
        cv2.imwrite(str(tmp_path / f"{i}.png"), image_of(i))
    seeker = Seeker(ImagesConfig(tmp_path, "cam", rate_hz=10.0, offset_s=1.0).build())
    np.testing.assert_array_equal(seeker.at(3).image, image_of(3))
    assert seeker.at(3).t_ns == 1_300_000_000
    for broken in (1, 4):
        (tmp_path / f"{broken}.png").write_bytes(b"no image")
    assert [seeker.at(i).seq for i in (0, 1, 2, 3, 1)] == [0, 2, 2, 3, 2]
    refusal(SourceError, "camera cam: no frame from 1.400 s on", seeker.at, 4)


@pytest.mark.parametrize(("t_ns", "place"), [(-5, 0), (0, 0), (14, 1), (15, 1), (16, 2), (99, 2)])
def test_the_nearest_frame(t_ns: int, place: int) -> None:
    assert nearest(np.array([0, 10, 20]), t_ns) == place


def test_times_that_no_recording_has_are_one_line(tmp_path: Path) -> None:
    path = write_video(tmp_path / "a.mkv", BLACK * 2, base=Fraction(1, 1000), pts=[0, 10**13], format="matroska")
    refusal(SourceError, r"camera cam: times up to 1e\+10 s; the file is damaged", VideoConfig(path, "cam").build().times_ns)


def test_a_file_that_ends_early_gives_what_there_is(video: Path, tmp_path: Path) -> None:
    cut = remuxed(video, tmp_path / "cut.ts", format="mpegts")
    cut.write_bytes(cut.read_bytes()[:-2000])
    seeker = Seeker(VideoConfig(cut, "cam").build())
    assert 0 < len(seeker.times_ns) <= COUNT
    seeker.at(0)
    refusal(SourceError, "no such video", VideoConfig(tmp_path / "none.mp4", "cam").build)


# --- the date of a recording is what its camera wrote, and nothing else


BLACK = [np.zeros((32, 32, 3), np.uint8)]


@pytest.mark.parametrize(
    ("stated", "when"),
    [
        ("2026-03-01T09:30:00.000000Z", "2026-03-01T09:30:00Z"),
        ("2026-03-01T10:30:00+01:00", "2026-03-01T09:30:00Z"),
        ("", None),
        ("1970-01-01T00:00:00.000000Z", None),
    ],
    ids=["in UTC", "elsewhere", "nothing", "a clock that was never set"],
)
def test_the_stated_time_in_utc(tmp_path: Path, stated: str, when: str | None) -> None:
    assert recorded_at(write_video(tmp_path / "a.mp4", BLACK, "mpeg4", stated=stated)) == when


def test_a_damaged_file_states_no_time(tmp_path: Path) -> None:
    (tmp_path / "b.mp4").write_bytes(b"not a video")
    assert recorded_at(tmp_path / "b.mp4") is None


# --- a camera of which part cannot be read is named, with its share and where it stops


PERIOD_NS, WHOLE = 40_000_000, 50


def covered(source: Source) -> Coverage:
    """Of a source that is read to its end."""
    counted = CountedSource(source, 0)
    list(counted.frames())
    return counted.coverage(0, (WHOLE - 1) * PERIOD_NS)


def whole(camera: str, frames: int = WHOLE) -> Coverage:
    return Coverage(camera, frames, frames, (frames - 1) * PERIOD_NS, PERIOD_NS)


@pytest.mark.parametrize(
    ("frames", "coverage", "said"),
    [
        (WHOLE, whole("b"), []),
        (3000, whole("b", 2998), []),
        (WHOLE, whole("b", 25), ["camera b: it stops at 0.96 s, the recording at 1.96 s"]),
        (WHOLE, Coverage("b", 50, 0, None, PERIOD_NS), ["camera b: none of its 50 frames can be read"]),
        (WHOLE, Coverage("b", 50, 40, 49 * PERIOD_NS, PERIOD_NS), ["camera b: 20% of its frames cannot be read (10 of 50)"]),
        (
            WHOLE,
            Coverage("b", 50, 20, 19 * PERIOD_NS, PERIOD_NS),
            ["camera b: 60% of its frames cannot be read (30 of 50); it stops at 0.76 s, the recording at 1.96 s"],
        ),
    ],
    ids=["whole", "a few missing at the end", "shorter", "without any frame", "gaps", "gaps and shorter"],
)
def test_what_is_missing_of_a_camera_is_stated(frames: int, coverage: Coverage, said: list[str]) -> None:
    assert incomplete_cameras([whole("a", frames), coverage]) == said


def test_a_video_is_read_whole_also_with_metadata_that_is_not_utf8(tmp_path: Path) -> None:
    path, rng = tmp_path / "cam.mp4", np.random.default_rng(0)
    with VideoWriter(path, SIZE_WH, 25.0, 18) as writer:
        for i in range(WHOLE):
            writer.write(rng.integers(0, 255, (48, 64, 3), np.uint8), i * PERIOD_NS)
    assert covered(VideoConfig(path, "b").build()) == whole("b")
    content = path.read_bytes()
    assert b"Lavf" in content
    path.write_bytes(content.replace(b"Lavf", b"L\xe4vf"))
    assert covered(VideoConfig(path, "b").build()) == whole("b")


def test_what_an_edit_list_hides_is_neither_listed_nor_missing(trimmed: Path) -> None:
    source = VideoConfig(trimmed, "b").build()
    shown_ns = [frame.t_ns for frame in source.frames()]
    assert shown_ns == source.times_ns().tolist() and (shown_ns[0], len(shown_ns)) == (0, COUNT - HIDDEN)
    counted = CountedSource(source, 0)
    assert len(list(counted.frames())) == counted.coverage(0, 2 * shown_ns[-1]).expected == len(shown_ns)


def test_frames_that_a_video_states_and_no_longer_holds_are_missing_at_its_end() -> None:
    source = ScriptedSource("b", [i * PERIOD_NS for i in range(20)])
    source.stated_frames = WHOLE
    assert covered(source) == Coverage("b", WHOLE, 20, 19 * PERIOD_NS, PERIOD_NS)
