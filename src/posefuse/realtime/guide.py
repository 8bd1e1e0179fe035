"""Live feedback while a calibration target is moved: what of each image is covered so far, until it is enough."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path

import cv2

from posefuse.calibration.targets.coverage import Guidance, new_guidance, seen
from posefuse.calibration.targets.detection import TargetDetector
from posefuse.calibration.targets.kinds import Target

from .camera_feed import CameraFeed

_REPORT_EVERY_S, _REST_S = 1.0, 0.005


def guide(
    feed: CameraFeed,
    target: Target,
    report: Callable[[Guidance], None],
    duration_s: float | None = None,
    *,
    videos: Path | None = None,
    stopped: Sequence[str] = (),
) -> Guidance:
    """Watch until enough is covered, the sources end, `stopped` has an entry, or `duration_s` with all cameras; close the feed.

    `report` is called once a second and at the end. With `videos`, a folder, every frame of every camera is kept there.

    Raises:
        SourceError: a source that fails and is not opened again. InputError: a video that cannot be made.
    """
    detector, state = TargetDetector(target), new_guidance(feed.cameras)
    feed.begin(videos)
    reported = time.monotonic()
    while not state.enough and not stopped:
        # asked before the frames are taken, so that the last ones are not lost
        over = feed.over
        feed.check()
        for fed in feed.newest():
            corners = detector.detect(cv2.cvtColor(fed.frame.image, cv2.COLOR_RGB2GRAY))
            state = seen(state, fed.camera, fed.t_ns, corners.xy_img, fed.frame.size_wh)
        now = time.monotonic()
        if over or (duration_s is not None and feed.seconds() > duration_s):
            break
        if now - reported >= _REPORT_EVERY_S:
            report(state)
            reported = now
        time.sleep(_REST_S)
    feed.close()
    report(state)
    return state
