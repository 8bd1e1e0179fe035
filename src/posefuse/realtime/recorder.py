"""Videos of several cameras for calibration or tracking: each frame at its own time, and warnings of what can be mended now."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from posefuse.core.arrays import Array
from posefuse.health.cameras import CameraState

from .camera_feed import CameraFeed

_REPORT_EVERY_S, _REST_S = 1.0, 0.005
# a grey value that a sensor cannot exceed; of so many pixels it hides what they show
_WHITE_DN, _MOST_WHITE_SHARE = 250, 0.1
# where even the brightest parts are this dark, noise and exposure time are large
_DARK_DN, _BRIGHT_QUANTILE = 60, 0.98
# a camera that exposes longer than its frame period delivers fewer frames than the others
_LEAST_RATE_SHARE = 0.8
_SAMPLE_STEP = 8


@dataclass(frozen=True, kw_only=True)
class CameraNews:
    """One camera during the last second.

    Attributes:
        camera: its name. rate_hz: frames that came. missing: frames that it counted and never delivered, since the beginning.
        warning: what is wrong, and what to do; empty where nothing is.
    """

    camera: str
    rate_hz: float
    missing: int
    warning: str


def record(
    feed: CameraFeed,
    videos: Path,
    report: Callable[[float, tuple[CameraNews, ...]], None],
    *,
    duration_s: float | None = None,
    stopped: Sequence[str] = (),
) -> None:
    """Keep every frame until the sources end, `stopped` has an entry, or for `duration_s` with all cameras; closes the feed.

    Args:
        feed: open cameras that have not begun. videos: an existing folder.
        report: is called once a second with the seconds since the beginning.

    Raises:
        SourceError: a source that fails and is not opened again. InputError: a video that cannot be made.
    """
    exposures: dict[str, str] = {}
    feed.begin(videos)
    begin = before = time.monotonic()
    counts = [0] * len(feed.cameras)
    while not stopped:
        over = feed.over
        feed.check()
        for fed in feed.newest():
            exposures[feed.cameras[fed.camera]] = exposure_warning(fed.frame.image)
        now = time.monotonic()
        if over or (duration_s is not None and feed.seconds() >= duration_s):
            break
        if now - before >= _REPORT_EVERY_S:
            states = feed.states()
            report(now - begin, _news(states, counts, now - before, exposures))
            counts, before = [state.captured for state in states], now
        time.sleep(_REST_S)
    feed.close()


def _news(
    states: Sequence[CameraState], counts: Sequence[int], seconds: float, exposures: Mapping[str, str]
) -> tuple[CameraNews, ...]:
    rates = [(state.captured - count) / seconds for state, count in zip(states, counts, strict=True)]
    usual_hz = float(np.median(rates))
    return tuple(
        CameraNews(
            camera=state.camera,
            rate_hz=rate_hz,
            missing=state.missing,
            warning=_state_warning(state, rate_hz, usual_hz) or exposures.get(state.camera, ""),
        )
        for state, rate_hz in zip(states, rates, strict=True)
    )


def exposure_warning(image: Array) -> str:
    """What is wrong with the exposure of an RGB image (H, W, 3), and what to do; empty where nothing is."""
    small = image[::_SAMPLE_STEP, ::_SAMPLE_STEP]
    white = float((small.max(axis=-1) >= _WHITE_DN).mean())
    if white > _MOST_WHITE_SHARE:
        return f"overexposed: {white:.0%} of the image is white; shorten the exposure, or keep lamps and windows out of the image"
    bright = float(np.quantile(cv2.cvtColor(np.ascontiguousarray(small), cv2.COLOR_RGB2GRAY), _BRIGHT_QUANTILE))
    if bright < _DARK_DN:
        return f"dark: the brightest parts reach {bright:.0f} of 255; more light keeps exposures short and images sharp"
    return ""


def _state_warning(state: CameraState, rate_hz: float, usual_hz: float) -> str:
    if state.state == "lost":
        return state.text
    if state.state == "running" and rate_hz < _LEAST_RATE_SHARE * usual_hz:
        return (
            f"{rate_hz:.1f} frames/s, the others {usual_hz:.1f}: a long exposure in little light, or too many cameras on one"
            " USB hub; fix the exposure time"
        )
    return ""
