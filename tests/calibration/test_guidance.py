"""Guidance while waving: counts, words, and when it is enough; and at cameras that are videos in memory."""

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from calibrating import marker_page
from memory_source import Clip

from posefuse.calibration.targets.coverage import Guidance, new_guidance, seen
from posefuse.calibration.targets.kinds import Markers
from posefuse.core import SourceError
from posefuse.realtime.capture import LiveInput
from posefuse.realtime.watching import CameraFeed, guide

SIZE = (160, 120)


EVERYWHERE = np.stack(np.meshgrid(np.arange(5, 160, 10.0), np.arange(5, 120, 10.0)), axis=-1).reshape(-1, 2)


def shown(state: Guidance, cameras: Sequence[int], times_s: Sequence[float]) -> Guidance:
    """After the target was everywhere in the images of these cameras."""
    for t_s, camera in itertools.product(times_s, cameras):
        state = seen(state, camera, round(t_s * 1e9) + camera * 10**7, EVERYWHERE, SIZE)
    return state


def test_it_is_enough_when_all_images_are_covered_and_all_cameras_hang_together() -> None:
    state = new_guidance(("a", "b", "c"))
    assert state.coverage.advice() == "show the target to a, b, c"
    state = shown(state, (0, 1), np.arange(40))
    assert state.coverage.together[0, 1] == state.coverage.together[1, 0] == 40
    assert not state.coverage.enough
    # seen by c alone, half a second next to the others: still not linked
    state = shown(state, (2,), np.arange(40) + 0.5)
    assert not state.coverage.enough
    assert state.coverage.advice() == "show the target to one of a, b and to c at the same time"
    assert shown(state, (0, 2), np.arange(40, 80)).coverage.enough
    poor = new_guidance(("a", "b"))
    for k in range(80):
        poor = seen(seen(poor, 0, k, EVERYWHERE, SIZE), 1, k, EVERYWHERE[:4], SIZE)
    assert not poor.coverage.enough
    assert "b: " in poor.coverage.advice()
    assert seen(poor, 0, 99, np.zeros((0, 2)), SIZE) is poor


class Unplugged(Clip):
    def frames(self) -> Any:
        raise SourceError(f"camera {self.camera}: unplugged")


def test_at_the_cameras_frames_are_counted_and_a_dead_one_is_named() -> None:
    shown: list[str] = []
    inputs = [LiveInput(name, "fake", Clip(name, marker_page(), (0,)), reopen=False) for name in ("a", "b")]
    with CameraFeed(inputs, target=Markers(0.1)) as feed:
        found = guide(feed, lambda state: shown.append(state.coverage.advice()), 5.0)
    assert found.coverage.together.tolist() == [[1, 1], [1, 1]]
    assert shown == ["show the target to a and to b at the same time"]
    broken = LiveInput("b", "fake", Unplugged("b"), reopen=False)
    with CameraFeed([inputs[0], broken], target=Markers(0.1)) as feed, pytest.raises(SourceError, match="camera b: unplugged"):
        guide(feed, lambda state: None, 5.0)
