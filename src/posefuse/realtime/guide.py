"""Live feedback while a calibration target is moved: what of each image is covered so far, until it is enough."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

import cv2

from posefuse.calibration.targets.detection import TargetDetector
from posefuse.calibration.targets.guidance import Guidance, seen, start
from posefuse.calibration.targets.kinds import Target
from posefuse.core import Frame, PosefuseError

from .capture import LiveInput
from .guide_frame import GuideFrame

_REPORT_EVERY_S, _REST_S = 1.0, 0.005


@dataclass
class _Newest:
    """The newest frame of one camera, which its thread sets and the loop takes."""

    frame: Frame | None = None
    received_ns: int = 0
    error: PosefuseError | None = None
    ended: bool = False
    lock: threading.Lock = field(default_factory=threading.Lock)

    def take(self) -> tuple[Frame | None, int]:
        with self.lock:
            frame, self.frame = self.frame, None
            return frame, self.received_ns


def guide(
    inputs: Sequence[LiveInput],
    target: Target,
    report: Callable[[Guidance], None],
    show: Callable[[GuideFrame], None],
    duration_s: float | None = None,
) -> Guidance:
    """Watch the cameras until enough is covered, the sources end, or `duration_s` is over.

    `report` is called once a second and at the end, `show` with every frame.

    Raises:
        PosefuseError: what a source raises.
    """
    detector, state = TargetDetector(target), start(tuple(one.camera for one in inputs))
    newest, stop = [_Newest() for _ in inputs], threading.Event()
    threads = [threading.Thread(target=_read, args=(one, slot, stop), daemon=True)
               for one, slot in zip(inputs, newest, strict=True)]  # fmt: skip
    for thread in threads:
        thread.start()
    begin = reported = time.monotonic()
    try:
        while not state.enough:
            # asked before the frames are taken, so that the last ones are not lost
            over = all(slot.ended for slot in newest)
            failed = next((slot.error for slot in newest if slot.error is not None), None)
            if failed is not None:
                raise failed
            # all at once, before any is looked at: frames of one moment show which cameras see the target together
            for camera, (frame, received_ns) in enumerate([slot.take() for slot in newest]):
                if frame is not None:
                    corners = detector.detect(cv2.cvtColor(frame.image, cv2.COLOR_RGB2GRAY))
                    state = seen(state, camera, received_ns, corners.xy_img, frame.size_wh)
                    show(GuideFrame(camera, received_ns, frame, corners, state))
            now = time.monotonic()
            if over or (duration_s is not None and now - begin > duration_s):
                break
            if now - reported >= _REPORT_EVERY_S:
                report(state)
                reported = now
            time.sleep(_REST_S)
    finally:
        stop.set()
    report(state)
    return state


def _read(one: LiveInput, slot: _Newest, stop: threading.Event) -> None:
    try:
        source = one.config.build()
        try:
            for frame in source.frames():
                with slot.lock:
                    slot.frame, slot.received_ns = frame, time.monotonic_ns()
                if stop.is_set():
                    break
        finally:
            source.close()
    except PosefuseError as error:
        slot.error = error
    finally:
        slot.ended = True


@contextmanager
def guide_view(cameras: Sequence[str], place: str | None) -> Iterator[Callable[[GuideFrame], None]]:
    """What to do with every frame: show it in Rerun (``spawn``), write it to a .rrd file, or nothing (None)."""
    if place is None:
        yield lambda look: None
        return
    from .guide_view import GuideView

    view = GuideView(cameras, place)
    try:
        yield view.look
    finally:
        view.close()
