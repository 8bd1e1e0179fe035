"""Guidance while waving: counts, words, and when it is enough; and at cameras that are videos in memory."""

import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from posefuse.calibration.targets.detection import Corners
from posefuse.calibration.targets.guidance import new_guidance, seen
from posefuse.calibration.targets.kinds import Markers
from posefuse.core import Frame, SourceError
from posefuse.realtime.camera_feed import CameraFeed
from posefuse.realtime.capture import LiveInput
from posefuse.realtime.guide import guide
from posefuse.realtime.guide_frame import GuideFrame

SIZE = (160, 120)


def everywhere() -> np.ndarray:
    return np.stack(np.meshgrid(np.arange(5, 160, 10.0), np.arange(5, 120, 10.0)), axis=-1).reshape(-1, 2)


def test_it_is_enough_when_all_images_are_covered_and_all_cameras_hang_together() -> None:
    state = new_guidance(("a", "b", "c"))
    assert state.words == "show the target to a, b, c"
    for k in range(40):
        for camera in (0, 1):
            state = seen(state, camera, k * 10**9 + camera * 10**7, everywhere(), SIZE)
    assert state.coverage.together[0, 1] == state.coverage.together[1, 0] == 40
    assert not state.enough
    # seen by c alone, half a second next to the others: still not linked
    for k in range(40):
        state = seen(state, 2, k * 10**9 + 5 * 10**8, everywhere(), SIZE)
    assert not state.enough
    assert state.words == "show the target to one of a, b and to c at the same time"
    for k in range(40, 80):
        state = seen(seen(state, 0, k * 10**9, everywhere(), SIZE), 2, k * 10**9, everywhere(), SIZE)
    assert state.enough
    corner = everywhere()[:4]
    poor = new_guidance(("a", "b"))
    for k in range(80):
        poor = seen(seen(poor, 0, k, everywhere(), SIZE), 1, k, corner, SIZE)
    assert not poor.enough
    assert "b: " in poor.words
    assert seen(poor, 0, 99, np.zeros((0, 2)), SIZE) is poor


@dataclass(frozen=True)
class Film:
    """Frames from memory, as a live source; None fails."""

    images: tuple[Any, ...] | None
    camera: str

    def build(self) -> "Film":
        return self

    def close(self) -> None:
        pass

    def frames(self) -> Any:
        if self.images is None:
            raise SourceError(f"camera {self.camera}: unplugged")
        for i, image in enumerate(self.images):
            yield Frame(camera=self.camera, seq=i, t_ns=i, received_ns=i, image=image)


def test_at_the_cameras_frames_are_counted_and_a_dead_one_is_named() -> None:
    marker = cv2.aruco.generateImageMarker(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50), 3, 60)
    page = np.full((120, 160, 3), 255, np.uint8)
    page[30:90, 50:110] = marker[..., None]
    shown: list[str] = []
    looks: list[GuideFrame] = []
    inputs = [LiveInput(name, "film", Film((page,), name), reopen=False) for name in ("a", "b")]
    with CameraFeed(inputs) as feed:
        found = guide(feed, Markers(0.1), lambda state: shown.append(state.words), looks.append, 5.0)
    assert found.coverage.together.tolist() == [[1, 1], [1, 1]]
    assert sorted(look.camera for look in looks) == [0, 1]
    assert looks[-1].state is found
    assert looks[0].corners.patch.tolist() == [3, 3, 3, 3]
    assert shown == ["show the target to a and to b at the same time"]
    broken = LiveInput("b", "film", Film(None, "b"), reopen=False)
    with CameraFeed([inputs[0], broken]) as feed, pytest.raises(SourceError, match="camera b: unplugged"):
        guide(feed, Markers(0.1), lambda state: None, lambda look: None, 5.0)


def test_the_picture_shows_what_was_found_and_covered_and_what_is_next(tmp_path: Path) -> None:
    pytest.importorskip("rerun", reason="the extra `viewer` is not installed")
    from posefuse.realtime.guide_view import GuideView, next_page

    state = new_guidance(("a", "b", "c"))
    for k in range(40):
        state = seen(seen(state, 0, k * 10**9, everywhere(), SIZE), 1, k * 10**9, everywhere()[:4], SIZE)
    page = next_page(state)
    assert page.startswith("# show the target to c\n")
    assert "| a | 100% | 40 | b 40 |" in page
    assert "| c | 0% | 0 | **no camera** |" in page
    frame = Frame(camera="a", seq=0, t_ns=0, received_ns=0, image=np.full((120, 160, 3), 90, np.uint8))
    corners = Corners(np.repeat([3, 7], 4), np.tile(np.arange(4), 2), everywhere()[:8])
    view = GuideView(("a", "b", "c"), str(tmp_path / "guide.rrd"))
    for t_ns in (0, 10, 10**9):
        view.look(GuideFrame(camera=0, t_ns=t_ns, frame=frame, corners=corners, state=state))
    view.close()
    listing = printed(tmp_path / "guide.rrd")
    for entity in ("cameras/a/image", "cameras/a/markers", "together/links", "together/cameras", "next"):
        assert f"/{entity}" in listing
    # the second look came too soon after the first; how the rows are grouped into chunks is the writer's affair
    assert rows_of(listing, "/cameras/a/image") == 2


def rows_of(listing: str, entity: str) -> int:
    """How often something was logged there, however many chunks the rows were put into."""
    return sum(int(rows) for rows in re.findall(rf"with (\d+) rows? [^-\n]*- {entity} ", listing))


def printed(path: Path) -> str:
    command = [sys.executable, "-m", "rerun", "rrd", "print", "-vv", str(path)]
    return subprocess.run(command, capture_output=True, text=True, check=True, timeout=120).stdout
