"""Guidance at the cameras: what the waving has covered so far, told in the terminal until it is enough."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from posefuse.core import Frame, PosefuseError

if TYPE_CHECKING:
    from posefuse.app.live.capture import LiveInput
    from posefuse.calibrate.guidance import Guidance
    from posefuse.calibrate.targets import Target

_TELL_EVERY_S, _REST_S = 1.0, 0.005


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


def guide(inputs: Sequence[LiveInput], target: Target, tell: Callable[[Guidance], None], most_s: float | None = None) -> Guidance:
    """Watch the cameras until enough is covered, the sources end, or `most_s` is over; `tell` is called once a second.

    Raises:
        PosefuseError: what a source raises.
    """
    import cv2

    from posefuse.calibrate.detection import TargetDetector
    from posefuse.calibrate.guidance import seen, start

    detector, state = TargetDetector(target), start(tuple(one.camera for one in inputs))
    newest, stop = [_Newest() for _ in inputs], threading.Event()
    threads = [threading.Thread(target=_read, args=(one, slot, stop), daemon=True)
               for one, slot in zip(inputs, newest, strict=True)]  # fmt: skip
    for thread in threads:
        thread.start()
    begin = told = time.monotonic()
    try:
        while not state.enough:
            # asked before the frames are taken, so that the last ones are not lost
            over = all(slot.ended for slot in newest)
            for camera, slot in enumerate(newest):
                if slot.error is not None:
                    raise slot.error
                frame, received_ns = slot.take()
                if frame is not None:
                    corners = detector.detect(cv2.cvtColor(frame.image, cv2.COLOR_RGB2GRAY))
                    state = seen(state, camera, received_ns, corners.xy_img, frame.size_wh)
            now = time.monotonic()
            if over or (most_s is not None and now - begin > most_s):
                break
            if now - told >= _TELL_EVERY_S:
                tell(state)
                told = now
            time.sleep(_REST_S)
    finally:
        stop.set()
    tell(state)
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
