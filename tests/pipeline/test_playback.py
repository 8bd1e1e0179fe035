"""Any moment of a recording: the frame that was taken then, and the skeleton in its pixels."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from small_session import COUNT, PERIOD_NS, SIZE_WH, grey

import posefuse as pf
from posefuse.pipeline.playback import Playback
from posefuse.pipeline.session_images import nearby_session, session_of

Saved = tuple[Path, Path]


def image_of(jpeg: bytes) -> np.ndarray:
    return cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)


def test_every_moment_shows_its_own_frame_in_any_order(saved_walk: Saved) -> None:
    session, result = saved_walk
    recording = pf.read(result)
    with Playback(recording, session_of(recording, session)) as playback:
        for i in (0, 29, 7, 8, 3, 15):
            for c, camera in enumerate(playback.cameras):
                moment = playback.moment(camera, i * PERIOD_NS + PERIOD_NS // 3, 480)
                assert moment.t_ns == pytest.approx(i * PERIOD_NS, abs=2000)
                assert abs(np.median(image_of(moment.jpeg)) - grey(c, i)) < 3


def test_keypoints_are_in_the_pixels_of_the_image(saved_walk: Saved) -> None:
    session, result = saved_walk
    recording = pf.read(result)
    with Playback(recording, session_of(recording, session)) as playback:
        moment = playback.moment("cam01", 12 * PERIOD_NS, SIZE_WH[0] // 2)
    assert moment.size_wh == (SIZE_WH[0] // 2, SIZE_WH[1] // 2)
    exact = recording.rig["cam01"].scaled(moment.size_wh).project(recording.poses.xyz_world[12])
    np.testing.assert_allclose(moment.projected_px, exact, atol=1e-9)
    np.testing.assert_allclose(moment.detected_px, exact, atol=1e-3)


def test_beyond_the_video_there_is_no_frame(saved_walk: Saved) -> None:
    session, result = saved_walk
    recording = pf.read(result)
    with Playback(recording, session_of(recording, session)) as playback:
        assert playback.moment("cam00", (COUNT + 3) * PERIOD_NS, 480) is None
        assert playback.step_at(10**12) == COUNT - 1


def test_without_videos_and_with_a_damaged_one_the_rest_is_shown(saved_walk: Saved) -> None:
    session, result = saved_walk
    recording = pf.read(result)
    with Playback(recording, None) as playback:
        assert playback.moment("cam00", 0, 480) is None
        assert image_of(playback.tile_jpeg("cam00", 0, 480)).shape[:2] == (SIZE_WH[1], SIZE_WH[0])
    (session / "videos" / "cam01.mp4").write_bytes(b"damaged")
    with Playback(recording, nearby_session(recording, result)) as playback:
        assert list(playback.problems) == ["cam01"]
        assert playback.moment("cam01", 0, 480) is None
        assert playback.moment("cam02", 0, 480) is not None
