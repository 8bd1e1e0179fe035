"""What --resume decodes: from the key frame before the first time step that is missing, where all before it is known."""

import weakref
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from videos import write_video

from posefuse.core import DetectionBatch, Detections2D, LookKind, Observations, Rig
from posefuse.core.skeleton import COCO17
from posefuse.pipeline.time_steps import ImageStep, ImageTimeSteps, common_timeline
from posefuse.sources.video import VideoConfig, VideoSource

COUNT, GOP, DONE = 96, 12, 70


def log_of(steps: list[ImageStep], rig: Rig) -> Observations:
    """Of steps in which no person was found."""
    found = [tuple(Detections2D.empty(one.camera, one.t_ns, COCO17) for one in step.frames if one) for step in steps]
    batches = [
        DetectionBatch(step=i, t_ns=step.t_ns, kind=LookKind.SEARCH, detections=some)
        for i, (step, some) in enumerate(zip(steps, found, strict=True))
    ]
    return Observations.from_batches(COCO17, rig.names, batches)


class Detector:
    """Looks at nothing."""


def time_steps(rig: Rig, path: Path, detector: Any) -> ImageTimeSteps:
    """Of a video that all cameras share."""
    write_video(path, [np.full((48, 64, 3), 2 * i, np.uint8) for i in range(COUNT)], "mpeg4", options={"g": str(GOP)})
    sources = [VideoConfig(path, name).build() for name in rig.names]
    line = common_timeline({one.camera: one.times_ns() for one in sources}, None, None, None)
    return ImageTimeSteps(rig, sources, detector, line, None)


def test_the_detector_is_let_go_before_the_solve(ring_rig: Callable[..., Rig], tmp_path: Path) -> None:
    """Its network would take memory that an hour needs."""
    detector = Detector()
    images, held = time_steps(ring_rig(2), tmp_path / "a.mp4", detector), weakref.ref(detector)
    del detector
    assert len(list(images.steps())) == COUNT and held() is not None
    images.close()
    assert held() is None


@pytest.mark.parametrize("missing", [False, True])
def test_few_frames_before_the_first_missing_one_are_decoded(
    ring_rig: Callable[..., Rig], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, missing: bool
) -> None:
    rig, decoded, real = ring_rig(2), [0], VideoSource._decoded_frames

    def counting(*arguments: Any) -> Iterator[Any]:
        for one in real(*arguments):
            decoded[0] += 1
            yield one

    images = time_steps(rig, tmp_path / "a.mp4", Detector())
    whole = list(images.steps())
    log = log_of(whole[:DONE], rig)
    if missing:  # one frame whose detections are not known, as where it could not be read
        log = log.only(np.arange(len(log.frame_t_ns)) != 9)
    monkeypatch.setattr(VideoSource, "_decoded_frames", counting)
    rest = list(images.steps(log))
    assert [step.t_ns for step in rest] == [step.t_ns for step in whole[DONE:]] and len(rest) == COUNT - DONE
    for one, other in zip(rest, whole[DONE:], strict=True):
        for mine, theirs in zip(one.frames, other.frames, strict=True):
            np.testing.assert_array_equal(mine.image, theirs.image)
    least = COUNT if missing else COUNT - DONE
    assert least + COUNT - DONE <= decoded[0] <= least + COUNT - DONE + 2 * (GOP + 2)
