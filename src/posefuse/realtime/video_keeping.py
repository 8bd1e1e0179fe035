"""Videos of a live session's cameras: a thread and a bounded queue per camera, so that tracking never waits for the disk."""

from __future__ import annotations

import contextlib
import json
import queue
import threading
from collections.abc import Iterable
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path

from posefuse.core import Frame, InputError, PosefuseError
from posefuse.formats.kept_video import KeptVideo
from posefuse.foundation.platform import lower_thread_priority

# about a third of a second of a fast camera; images of 640 x 480 px take 30 MB
_QUEUE = 32
# threads that encode give way to those that track, by so many steps
_NICENESS = 5
# what is queued at the end is written within this time
FINISH_S = 5.0


@dataclass(frozen=True)
class KeptCounts:
    """The result of one camera's video.

    Attributes:
        written, dropped: frames. how: ``copied`` (the camera's own packets) or ``encoded``. fault: why it ended early.
        finished: the file was closed. first_s, last_s: times of the first and the last frame written, from the session's zero.
        longest_gap_s: longest time between two frames written in a row. zero_ns: the session's zero on its clock.
    """

    written: int = 0
    dropped: int = 0
    how: str = ""
    fault: str = ""
    finished: bool = False
    first_s: float = 0.0
    last_s: float = 0.0
    longest_gap_s: float = 0.0
    zero_ns: int = 0

    @property
    def rate_hz(self) -> float:
        """Frames per second written; 0 for fewer than two."""
        return (self.written - 1) / (self.last_s - self.first_s) if self.written > 1 and self.last_s > self.first_s else 0.0

    def with_frame(self, t_s: float) -> KeptCounts:
        """With one more frame, written at `t_s`."""
        gap_s = t_s - self.last_s if self.written else 0.0
        return replace(
            self,
            written=self.written + 1,
            first_s=self.first_s if self.written else t_s,
            last_s=t_s,
            longest_gap_s=max(self.longest_gap_s, gap_s),
        )


class VideoKeeper:
    """Writes one camera's frames in a thread of its own; `offer` never waits.

    Args:
        folder: for ``CAMERA.mp4`` and, at the end, ``CAMERA.json`` with the counts. camera: its name.

    Attributes:
        zero_ns: the session's zero on its clock, as far as it is known; set before the first frame.

    Raises:
        InputError: the video cannot be made, or already exists.
    """

    def __init__(self, folder: Path, camera: str) -> None:
        self._video = KeptVideo(folder / f"{camera}.mp4")
        self._about = folder / f"{camera}.json"
        self._queue: queue.Queue[tuple[Frame, int] | None] = queue.Queue(_QUEUE)
        self._dropped, self._counts = 0, KeptCounts()
        self.zero_ns = 0
        self._thread = threading.Thread(target=self._run, name=f"video {camera}", daemon=True)
        self._thread.start()

    def offer(self, frame: Frame, t_ns: int) -> None:
        """A frame of time `t_ns` since the session's zero; dropped and counted where there is no room."""
        if t_ns < 0:
            return
        try:
            self._queue.put_nowait((frame, t_ns))
        except queue.Full:
            self._dropped += 1

    def counts(self) -> KeptCounts:
        """As of now."""
        return replace(self._counts, dropped=self._counts.dropped + self._dropped, how=self._video.how, zero_ns=self.zero_ns)

    def close(self, wait_s: float = FINISH_S) -> None:
        """Write what is queued and finish the file, within `wait_s`."""
        with contextlib.suppress(queue.Full):
            self._queue.put(None, timeout=wait_s)
            self._thread.join(wait_s)

    def _run(self) -> None:
        lower_thread_priority(_NICENESS)
        while (item := self._queue.get()) is not None:
            self._write(*item)
        try:
            self._video.close()
            self._counts = replace(self._counts, finished=not self._counts.fault)
        except InputError as error:
            self._counts = replace(self._counts, fault=self._counts.fault or str(error))
        with contextlib.suppress(OSError):
            self._about.write_text(json.dumps(asdict(self.counts())) + "\n", encoding="utf-8")

    def _write(self, frame: Frame, t_ns: int) -> None:
        counts = self._counts
        if counts.fault:
            self._counts = replace(counts, dropped=counts.dropped + 1)
            return
        try:
            good = self._video.write(frame, t_ns)
        except (PosefuseError, ValueError) as error:
            self._counts = replace(counts, fault=str(error), dropped=counts.dropped + 1)
            return
        self._counts = counts.with_frame(t_ns / 1e9) if good else replace(counts, dropped=counts.dropped + 1)


def read_counts(folder: Path, cameras: Iterable[str]) -> dict[str, KeptCounts]:
    """What the keepers of these cameras counted, by name; where none was written, that the video was not finished."""
    found = {}
    known = {field.name for field in fields(KeptCounts)}
    for camera in cameras:
        try:
            content = json.loads((folder / f"{camera}.json").read_text(encoding="utf-8"))
            found[camera] = KeptCounts(**{name: value for name, value in content.items() if name in known})
        except (OSError, ValueError):
            found[camera] = KeptCounts(fault="was not finished: its process ended, or the disk was full")
    return found
