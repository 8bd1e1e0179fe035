"""Any time of a recording: the frame that was taken then, and the skeleton in its pixels."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from small_session import COUNT, PERIOD_NS, SIZE_WH, grey, walk

import posefuse as pf
from posefuse.api.playback import Playback, session_with_videos
from posefuse.api.recording import recording_of
from posefuse.core.frames import Pixels
from posefuse.core.observations import observations_from_frames
from posefuse.formats.rig import write_rig
from posefuse.outputs.overview import best_time_step
from posefuse.pipeline.writing import nearby_session, session_of_recording
from posefuse.realtime.video_keeping import VideoKeeper, wait_for_videos

Saved = tuple[Path, Path]


def image_of(jpeg: bytes) -> np.ndarray:
    return cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)


@pytest.fixture
def played(saved_walk: Saved) -> Iterator[tuple[pf.Recording, Playback]]:
    session, result = saved_walk
    recording = pf.read(result)
    with Playback(recording, session_of_recording(recording, session)) as playback:
        yield recording, playback


def test_every_time_shows_its_own_frame_in_any_order_and_none_beyond_the_video(played: tuple[pf.Recording, Playback]) -> None:
    _, playback = played
    for i in (0, 29, 7, 8, 3, 15):
        for c, camera in enumerate(playback.cameras):
            shown = playback.at(camera, i * PERIOD_NS + PERIOD_NS // 3, 480)
            assert shown.t_ns == pytest.approx(i * PERIOD_NS, abs=2000)
            assert abs(np.median(image_of(shown.jpeg)) - grey(c, i)) < 3
    assert playback.at("cam00", (COUNT + 3) * PERIOD_NS, 480) is None
    assert playback.step_at(10**12) == COUNT - 1


def test_keypoints_are_in_the_pixels_of_the_image(played: tuple[pf.Recording, Playback]) -> None:
    recording, playback = played
    shown = playback.at("cam01", 12 * PERIOD_NS, SIZE_WH[0] // 2)
    assert shown.size_wh == (SIZE_WH[0] // 2, SIZE_WH[1] // 2)
    exact = recording.rig["cam01"].scaled(shown.size_wh).project(recording.poses.xyz_world[12])
    np.testing.assert_allclose(shown.projected_px, exact, atol=1e-9)
    np.testing.assert_allclose(shown.detected_px, exact, atol=1e-3)


def test_without_videos_and_with_a_damaged_one_the_rest_is_shown(saved_walk: Saved) -> None:
    session, result = saved_walk
    recording = pf.read(result)
    with Playback(recording, None) as playback:
        assert playback.at("cam00", 0, 480) is None
    (session / "videos" / "cam01.mp4").write_bytes(b"damaged")
    with Playback(recording, nearby_session(recording, result)) as playback:
        assert list(playback.problems) == ["cam01"]
        assert playback.at("cam01", 0, 480) is None
        assert playback.at("cam02", 0, 480) is not None


def live_walk(folder: Path, ring_rig, *, zero_ns: int, finished: bool = True) -> tuple[pf.Recording, Path]:
    """A live recording with videos that were kept from five seconds after the session's zero on, and its file."""
    recorded = walk(ring_rig(3, size_wh=SIZE_WH))
    (folder / "videos").mkdir(parents=True)
    write_rig(folder / "rig.toml", recorded.rig)
    for c, camera in enumerate(recorded.rig.names):
        keeper = VideoKeeper(folder / "videos", camera)
        keeper.zero_ns = zero_ns
        for i in range(COUNT):
            image = np.full((SIZE_WH[1], SIZE_WH[0], 3), grey(c, i), np.uint8)
            t_ns = 5_000_000_000 + i * PERIOD_NS
            keeper.offer(Pixels(image), t_ns)
        keeper.finish()
        wait_for_videos([keeper])
        if not finished:
            (folder / "videos" / f"{camera}.json").unlink()
    frames = [recorded.observations.detections(i) for i in range(len(recorded.observations.frame_t_ns))]
    observations = observations_from_frames(recorded.poses.skeleton, recorded.rig.names, frames)
    # the recording began with the fourth frame
    start_ns = zero_ns + 5_000_000_000 + 3 * PERIOD_NS
    made = {**recorded.provenance, "start_ns": start_ns}
    return recording_of(replace(recorded, observations=observations, provenance=made)), folder / "recording.mcap"


def test_videos_of_a_live_session_are_on_the_time_of_its_recording(tmp_path: Path, ring_rig) -> None:
    recording, path = live_walk(tmp_path / "a", ring_rig, zero_ns=1_700_000_000_000_000_000)
    assert recording.is_live
    with Playback(recording, session_with_videos(recording, path, tmp_path)) as playback:
        assert playback.has_images
        for i in (0, 20, 7):
            for c, camera in enumerate(playback.cameras):
                step = playback.at(camera, i * PERIOD_NS, 480)
                assert step.t_ns == pytest.approx(i * PERIOD_NS, abs=2000)
                assert abs(np.median(image_of(step.jpeg)) - grey(c, i + 3)) < 4
    # kept in a folder next to the file
    assert session_with_videos(recording, tmp_path / "recording.mcap") is not None
    # a second solve shows the same images at the same times
    recording.solve().save(tmp_path / "a-edited")
    solved = pf.read(tmp_path / "a-edited")
    assert not solved.is_live and solved.provenance["start_ns"] == recording.provenance["start_ns"]
    with Playback(solved, session_with_videos(solved, tmp_path / "a-edited", tmp_path)) as playback:
        t_ns = int(solved.poses.t_ns[5])
        step = playback.at(playback.cameras[1], t_ns, 480)
        assert abs(step.t_ns - t_ns) < PERIOD_NS
        assert abs(np.median(image_of(step.jpeg)) - grey(1, round(t_ns / PERIOD_NS) + 3)) < 4
    assert session_with_videos(recording, path, tmp_path / "other") is None
    # files of other formats are drawn on them, too
    drawn = {}
    for place in (tmp_path, tmp_path / "other"):
        [file], _ = replace(recording, path=path).export(tmp_path / f"drawn{len(drawn)}", ["overview"], within=place)
        drawn[place] = np.median(image_of(file.read_bytes())[: SIZE_WH[1] // 2, : SIZE_WH[0] // 2])
    shown = grey(0, best_time_step(recording) + 3)
    assert abs(drawn[tmp_path] - shown) < 4 and abs(drawn[tmp_path / "other"] - shown) > 10


def test_videos_of_another_time_or_unfinished_ones_are_not_those_of_the_recording(tmp_path: Path, ring_rig) -> None:
    recording, path = live_walk(tmp_path / "a", ring_rig, zero_ns=1_700_000_000_000_000_000)
    later = replace(recording, provenance={**recording.provenance, "start_ns": recording.provenance["start_ns"] + 2 * 10**9})
    assert session_with_videos(later, path) is None
    cut, path = live_walk(tmp_path / "b", ring_rig, zero_ns=1_700_000_000_000_000_000, finished=False)
    assert session_with_videos(cut, path) is None
