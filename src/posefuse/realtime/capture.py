"""One thread per camera that takes frames as they come and keeps the newest only, which bounds the latency.

All of them go to its video, if wanted.
"""

from __future__ import annotations

import dataclasses
import threading
import time
from dataclasses import dataclass
from typing import Any

from posefuse.core import Camera, Frame, PosefuseError, Source, SourceError
from posefuse.foundation.parsing import one_line
from posefuse.health.camera_monitor import CameraState

from .video_keeping import VideoKeeper

_RETRY_S = 1.0
# between two showings of a looped source: the rig watch compares nothing across a gap this long, so the jump is no motion to it
LOOP_PAUSE_S = 0.5
# every so many pixels in both directions are compared, to see whether anything changes
SAMPLE_STEP = 12


@dataclass(frozen=True)
class LiveInput:
    """One camera's source.

    Attributes:
        camera: name in the rig. kind: how the user called it, e.g. ``rtsp``.
        config: source config with `build()`; one with a field `zero_ns` counts time from there (monotonic clock).
        reopen: a source that ends or fails is opened again until the session ends.
        loop_s: so much of a video or simulated session is shown again and again, half a second apart; None plays it once.
    """

    camera: str
    kind: str
    config: Any
    reopen: bool
    loop_s: float | None = None

    @property
    def from_zero(self) -> bool:
        """Its times count from a zero that the session sets."""
        return any(field.name == "zero_ns" for field in dataclasses.fields(self.config))

    def open(self, camera: Camera | None, zero_ns: int | None = None) -> Source:
        """Build the source; raises SourceError when it cannot be opened or its frames are not of the calibrated size, if any."""
        config = dataclasses.replace(self.config, zero_ns=zero_ns) if self.from_zero and zero_ns is not None else self.config
        source: Source = config.build()
        if camera is not None and source.size_wh != camera.size_wh:
            source.close()
            got, want = source.size_wh, camera.size_wh
            raise SourceError(
                f"camera {self.camera}: frames are {got[0]}x{got[1]} px, it was calibrated at {want[0]}x{want[1]}; "
                "set the camera to that size"
            )
        return source


@dataclass(frozen=True, eq=False, slots=True)
class Caught:
    """A frame in the source's own time.

    Attributes:
        still: for how many frames in a row the image has not changed.
        shift_ns: what is added to the frame's times for those of the session.
    """

    frame: Frame
    still: int
    shift_ns: int = 0

    @property
    def t_ns(self) -> int:
        """Session time of its exposure."""
        return self.frame.t_ns + self.shift_ns


class Capture:
    """Frames of one camera from a thread of its own. `news` is notified of each new frame. `camera`: calibrated, or None."""

    def __init__(self, entry: LiveInput, camera: Camera | None, news: threading.Condition) -> None:
        self.entry, self._camera = entry, camera
        self._keeper: VideoKeeper | None = None
        self._finishing: list[VideoKeeper] = []
        self._session_zero_ns = self._session_ns = 0
        # the machine's clock minus its monotonic one, when the source was opened: sources count by it
        self._opened_ns = 0
        self._news = news
        self._newest: Caught | None = None
        self._source: Source | None = None
        self._stop = threading.Event()
        self._state, self._text = "opening", ""
        self._captured = self._used = self._replaced = self._missing = 0
        self._thread: threading.Thread | None = None

    def open(self) -> None:
        """Open the source now, so that what is wrong shows at the start; raises SourceError."""
        self._source = self._opened()

    def replace_keeper(self, keeper: VideoKeeper | None) -> None:
        """Give every frame to this video, too, from now on, or to none; a former one is finished meanwhile."""
        if keeper is not None:
            keeper.zero_ns = self._session_zero_ns
        before, self._keeper = self._keeper, keeper
        if before is not None:
            before.finish()
            self._finishing = [*(one for one in self._finishing if one.at_work), before]

    def begin(self, zero_ns: int, session_zero_ns: int = 0) -> None:
        """Let frames come; `session_zero_ns`: `zero_ns` on the session's clock: for videos, and sources on it."""
        self._session_zero_ns, self._session_ns = session_zero_ns, session_zero_ns - zero_ns
        if self._keeper is not None:
            self._keeper.zero_ns = session_zero_ns
        self._thread = threading.Thread(target=self._run, args=(zero_ns,), name=f"capture {self.entry.camera}", daemon=True)
        self._thread.start()

    def waiting(self) -> Caught | None:
        """The newest frame no one has taken yet; call with `news` held."""
        return self._newest

    def take(self) -> Caught | None:
        """Take it; call with `news` held."""
        caught, self._newest = self._newest, None
        self._used += caught is not None
        return caught

    def state(self) -> CameraState:
        """How it fares."""
        return CameraState(
            camera=self.entry.camera,
            state=self._state,
            text=self._text,
            captured=self._captured,
            used=self._used,
            replaced=self._replaced,
            missing=self._missing,
        )

    def video_fault(self) -> str:
        """Why its video ended early; empty while all is well, or none is kept."""
        return "" if self._keeper is None else self._keeper.counts().fault

    def close(self) -> list[VideoKeeper]:
        """Stop without waiting for a source that hangs; returns its videos, of which the last ones may not be finished yet."""
        self._stop.set()
        if self._source is not None:
            self._source.close()
        self.replace_keeper(None)
        return self._finishing

    def _run(self, zero_ns: int) -> None:
        turn = -1
        while not self._stop.is_set():
            turn = self._next_turn(turn, zero_ns)
            try:
                self._deliver(zero_ns, turn * self._period_ns)
                if self._period_ns:
                    continue
                self._state, self._text = "ended", "the source has ended"
            except Exception as error:  # noqa: BLE001 - others' sources may fail in any way; it is reported, not hidden
                known = isinstance(error, (PosefuseError, OSError))
                words = str(error) if known else f"{type(error).__name__}: {one_line(error)}"
                self._state, self._text = "lost", words
            if not self.entry.reopen:
                return
            self._stop.wait(_RETRY_S)

    def _opened(self, zero_ns: int | None = None) -> Source:
        self._opened_ns = time.time_ns() - time.monotonic_ns()
        return self.entry.open(self._camera, zero_ns)

    @property
    def _period_ns(self) -> int:
        """From one showing to the next; 0 for a source that is played once."""
        return round((self.entry.loop_s + LOOP_PAUSE_S) * 1e9) if self.entry.loop_s and self.entry.from_zero else 0

    def _next_turn(self, turn: int, zero_ns: int) -> int:
        """Number of the next showing; ones that are over already are left out, so that all cameras show the same."""
        return max(turn + 1, (time.monotonic_ns() - zero_ns) // self._period_ns, 0) if self._period_ns else 0

    def _deliver(self, zero_ns: int, later_ns: int) -> None:
        """Frames of one showing of the source, which begins `later_ns` after zero."""
        if self._source is None or self.entry.from_zero:
            self._source = self._opened(zero_ns + later_ns)
        still, before = 0, None
        # others may have counted before they were opened, and the machine's clock may have been set since the session began
        seq, shift_ns = (
            (-1, self._session_zero_ns + later_ns) if self.entry.from_zero else (None, self._session_ns - self._opened_ns)
        )
        try:
            for frame in self._source.frames():
                if self._stop.is_set() or (self._period_ns and frame.t_ns >= self._period_ns - round(LOOP_PAUSE_S * 1e9)):
                    return
                now = frame.pixels.brightness(SAMPLE_STEP).tobytes()
                still = still + 1 if now == before else 0
                before = now
                missing = max(0, frame.seq - seq - 1) if seq is not None else 0
                self._missing += missing
                seq = frame.seq
                self._state, self._text = "running", ""
                caught = Caught(frame, still, shift_ns)
                # another thread may replace it
                if (keeper := self._keeper) is not None:
                    keeper.miss(missing)
                    keeper.offer(frame.encoded or frame.pixels, caught.t_ns - self._session_zero_ns)
                self.put(caught)
        finally:
            self._source.close()
            self._source = None

    def put(self, caught: Caught) -> None:
        """A new frame; one that still waits gives way to it."""
        with self._news:
            self._captured += 1
            self._replaced += self._newest is not None
            self._newest = caught
            self._news.notify()


def keeping_packets(entry: LiveInput) -> LiveInput:
    """The input with its frames as the camera encoded them, where it can give them."""
    if not any(field.name == "keep_encoded" for field in dataclasses.fields(entry.config)):
        return entry
    return dataclasses.replace(entry, config=dataclasses.replace(entry.config, keep_encoded=True))


def take_all(captures: list[Capture]) -> list[tuple[Capture, Caught]]:
    """Take every waiting frame, of each camera its newest. Call with `news` held."""
    return [(capture, caught) for capture in captures if (caught := capture.take()) is not None]
