"""Cameras watched without tracking: the newest frame of each, every frame to a video, warnings of what can be mended now."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from posefuse.calibration.targets.coverage import Guidance, new_guidance, seen
from posefuse.calibration.targets.detection import Corners, TargetDetector
from posefuse.calibration.targets.kinds import Target
from posefuse.core import Closing, Frame, Rig, SourceError
from posefuse.core.arrays import Array
from posefuse.health.camera_monitor import CameraState

from .capture import Capture, LiveInput, keeping_packets
from .messages import SessionClock
from .video_keeping import KeptCounts, VideoKeeper, read_counts, wait_for_videos

_FIRST_S = 30.0
_REPORT_EVERY_S, _REST_S = 1.0, 0.005
# a grey value that a sensor cannot exceed; of so many pixels it hides what they show
_WHITE_DN, _MOST_WHITE_SHARE = 250, 0.1
# where even the brightest parts are this dark, noise and exposure time are large
_DARK_DN, _BRIGHT_QUANTILE = 60, 0.98
# a camera that exposes longer than its frame period delivers fewer frames than the others
_LEAST_RATE_SHARE = 0.8
_SAMPLE_STEP = 8
# blurring by one pixel takes most of the fine detail of a sharp image, and little of one that is blurred already
_BLUR_PX = 1.0
# share of the Laplacian's energy that such a blur leaves; docs/studio.md has it for known blurs
_MOST_LEFT = 0.35
# parts of an image without edges carry no information
_LEAST_EDGE_DN = 12.0


@dataclass(frozen=True, eq=False)
class FedFrame:
    """The newest frame of one camera.

    Attributes:
        camera: its number. t_ns: time of exposure since the session's zero. frame: the image.
        corners: of the target in it; None where none is looked for.
    """

    camera: int
    t_ns: int
    frame: Frame
    corners: Corners | None = None


@dataclass(frozen=True, kw_only=True)
class CameraNews:
    """One camera during the last second.

    Attributes:
        camera: its name. state: see `CameraState`. rate_hz: frames that came. missing: frames that it counted and never
            delivered, since the beginning.
        warning: what is wrong, and what to do; empty where nothing is.
    """

    camera: str
    state: str
    rate_hz: float
    missing: int
    warning: str


Watched = Iterator[tuple[list[FedFrame], tuple[CameraNews, ...]]]


class CameraFeed(Closing):
    """Cameras that are open inside the block and deliver from `begin` on; a context manager.

    Args:
        inputs: one per camera. rig: whose image sizes they must have; None takes any.
        packets: give frames in the camera's own encoding too, for videos.
        target: what is moved in front of them, and looked for in what `watched` gives; None: nothing.

    Attributes:
        cameras: names. guidance: what of the target was covered so far.

    Raises:
        SourceError: at the start of the block: a source that cannot be opened.
    """

    def __init__(
        self, inputs: Sequence[LiveInput], *, rig: Rig | None = None, packets: bool = False, target: Target | None = None
    ) -> None:
        self.cameras = tuple(entry.camera for entry in inputs)
        self.guidance, self._detector = new_guidance(self.cameras), None if target is None else TargetDetector(target)
        self._videos: Path | None = None
        self._news = threading.Condition()
        # when the first frames were asked for, and when each camera had delivered one
        self._begun_s, self._zero_ns = 0.0, 0
        self._all_s: float | None = None
        self._captures = [
            Capture(keeping_packets(entry) if packets else entry, None if rig is None else rig[entry.camera], self._news)
            for entry in inputs
        ]

    def __enter__(self) -> CameraFeed:
        try:
            for capture in self._captures:
                capture.open()
        except BaseException:
            self.close()
            raise
        return self

    def begin(self, videos: Path | None = None) -> None:
        """Let frames come. With `videos`, an existing folder, all go to ``CAMERA.mp4`` there, each at its own time.

        Raises:
            InputError: a video that cannot be made.
        """
        self._videos = videos
        for capture in self._captures:
            if videos is not None:
                capture.replace_keeper(VideoKeeper(videos, capture.entry.camera))
        self._begun_s = time.monotonic()
        zero_ns = time.monotonic_ns()
        self._zero_ns = zero_ns + SessionClock.begin().offset_ns
        for capture in self._captures:
            capture.begin(zero_ns, self._zero_ns)

    def close(self) -> None:
        """Close the sources and finish the videos; safe to call twice."""
        captures, self._captures = self._captures, []
        wait_for_videos([keeper for capture in captures for keeper in capture.close()])

    def watched(
        self, videos: Path | None = None, duration_s: float | None = None, stopped: Sequence[str] = (), *, judged: bool
    ) -> Watched:
        """The newest frames, and once a second news of each camera, else none.

        It ends when the sources do, `stopped` has an entry, or `duration_s` with all cameras is over; then it closes the cameras.

        Args:
            videos: an existing folder that keeps every frame; None: none are kept.
            judged: an image of each camera is judged for its news; in large images that takes tens of milliseconds.

        Raises:
            SourceError: a source that fails and is not opened again. InputError: a video that cannot be made.
        """
        self.begin(videos)
        found: dict[str, str] = {}
        judged_s = dict.fromkeys(self.cameras, -_REPORT_EVERY_S)
        counts, reported = [0] * len(self.cameras), time.monotonic()
        while not stopped:
            # asked before the frames are taken, so that the last ones are not lost
            over = self.over
            self.check()
            frames = [self._with_corners(fed) for fed in self.newest()]
            for fed in frames if judged else ():
                camera, now_s = self.cameras[fed.camera], time.monotonic()
                if now_s - judged_s[camera] >= _REPORT_EVERY_S:
                    image = fed.frame.image
                    judged_s[camera], found[camera] = now_s, exposure_warning(image) or focus_warning(image)
            since_s = time.monotonic() - reported
            over = over or (duration_s is not None and self.seconds() >= duration_s)
            news: tuple[CameraNews, ...] = ()
            if since_s >= _REPORT_EVERY_S and not over:
                before, counts, reported = counts, [state.captured for state in self.states()], reported + since_s
                rates = [(now - then) / since_s for now, then in zip(counts, before, strict=True)]
                news = _news(self.states(), rates, found)
            yield frames, news
            if over:
                break
            time.sleep(_REST_S)
        self.close()

    def _with_corners(self, fed: FedFrame) -> FedFrame:
        if self._detector is None:
            return fed
        corners = self._detector.detect(cv2.cvtColor(fed.frame.image, cv2.COLOR_RGB2GRAY))
        self.guidance = seen(self.guidance, fed.camera, fed.t_ns, corners.xy_img, fed.frame.size_wh)
        return replace(fed, corners=corners)

    def newest(self) -> list[FedFrame]:
        """What came since the last call, the newest frame of each camera.

        All at once, before any is looked at: frames of one moment show which cameras see a target together.
        """
        with self._news:
            taken = [capture.take() for capture in self._captures]
        return [
            FedFrame(number, caught.t_ns - self._zero_ns, caught.frame)
            for number, caught in enumerate(taken)
            if caught is not None
        ]

    def states(self) -> tuple[CameraState, ...]:
        """Status of each camera."""
        return tuple(capture.state() for capture in self._captures)

    def counts(self) -> dict[str, KeptCounts]:
        """What the videos hold by camera, when they are finished; empty where none were kept."""
        return {} if self._videos is None else read_counts(self._videos, self.cameras)

    def seconds(self) -> float:
        """Since the first frame of the last camera; one that has sent none for half a minute is not waited for."""
        now_s = time.monotonic()
        if self._all_s is None and (now_s - self._begun_s > _FIRST_S or all(state.captured for state in self.states())):
            self._all_s = now_s
        return 0.0 if self._all_s is None else now_s - self._all_s

    @property
    def over(self) -> bool:
        """No camera will deliver any more."""
        return all(state.state == "ended" and not capture.entry.reopen
                   for capture, state in zip(self._captures, self.states(), strict=True))  # fmt: skip

    def check(self) -> None:
        """Raise SourceError for a source that failed and is not opened again."""
        for capture, state in zip(self._captures, self.states(), strict=True):
            if state.state == "lost" and not capture.entry.reopen:
                raise SourceError(state.text)


def _news(states: Sequence[CameraState], rates: Sequence[float], found: Mapping[str, str]) -> tuple[CameraNews, ...]:
    usual_hz = float(np.median(rates))
    return tuple(
        CameraNews(
            camera=state.camera,
            state=state.state,
            rate_hz=rate_hz,
            missing=state.missing,
            warning=_state_warning(state, rate_hz, usual_hz) or found.get(state.camera, ""),
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


def detail_left(image: Array) -> float:
    """Share of the fine detail of an RGB image (H, W, 3) that a blur of a pixel leaves at its strongest edges; else NaN."""
    raw = cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_RGB2GRAY).astype(np.float32)
    # noise of single pixels is no detail
    grey: Array = cv2.GaussianBlur(raw, (0, 0), 0.5)
    slope = cv2.magnitude(cv2.Sobel(grey, cv2.CV_32F, 1, 0, scale=0.25), cv2.Sobel(grey, cv2.CV_32F, 0, 1, scale=0.25))
    limit = max(float(np.quantile(slope[::2, ::2], 0.99)), _LEAST_EDGE_DN)
    edges = slope >= limit
    if edges.sum() < 50:
        return float("nan")
    fine = cv2.Laplacian(grey, cv2.CV_32F)
    coarse = cv2.Laplacian(cv2.GaussianBlur(grey, (0, 0), _BLUR_PX), cv2.CV_32F)
    return float((coarse[edges] ** 2).sum() / max((fine[edges] ** 2).sum(), 1e-9))


def focus_warning(image: Array) -> str:
    """Advice where an image seems out of focus; empty where it does not, or has too little texture to judge."""
    left = detail_left(image)
    if left > _MOST_LEFT:
        return f"perhaps out of focus: its edges are {left:.0%} as sharp after a blur of {_BLUR_PX:g} px; turn the focus ring"
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


def guide(
    feed: CameraFeed,
    report: Callable[[Guidance], None],
    duration_s: float | None = None,
    *,
    videos: Path | None = None,
    stopped: Sequence[str] = (),
) -> Guidance:
    """Watch until enough of the target is covered, or `CameraFeed.watched` ends; close the feed.

    `report` is called once a second and at the end. With `videos`, a folder, every frame of every camera is kept there.

    Raises:
        SourceError: a source that fails and is not opened again. InputError: a video that cannot be made.
    """
    for _, news in feed.watched(videos, duration_s, stopped, judged=False):
        if feed.guidance.coverage.enough:
            break
        if news:
            report(feed.guidance)
    feed.close()
    report(feed.guidance)
    return feed.guidance
