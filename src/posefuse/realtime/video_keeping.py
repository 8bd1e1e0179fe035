"""Videos of a live session's cameras: a thread and a bounded queue per camera, so that tracking never waits for the disk."""

from __future__ import annotations

import contextlib
import json
import queue
import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

from posefuse.core import InputError, PosefuseError, SourceError
from posefuse.core.frames import EncodedFrame, Pixels
from posefuse.formats.kept_video import KeptVideo
from posefuse.foundation.output_file import write_text
from posefuse.foundation.parsing import parse_json, read_text
from posefuse.foundation.platform import lower_thread_priority
from posefuse.foundation.requests_to_end import wait_while_working
from posefuse.foundation.settings import settings_from_mapping
from posefuse.sources.video import VideoConfig

# of frames that wait for the disk: half a second of images of 1920 x 1080 px, a minute of packets
_ROOM_BYTES = 1 << 27
# threads that encode give way to those that track, by so many steps
_NICENESS = 5
# at the end a video that has made no progress for so long is given up
FINISH_S = 5.0
_SLOW = "the disk or the processor is too slow for this rate"
_MISSING = "the source did not deliver them: the computer is too busy, or the connection too slow"
_NO_PACKET = "the stream has no packets of theirs"
_NOTHING = "no frame came, or none that a video can begin with"


@dataclass(frozen=True)
class KeptCounts:
    """The result of one camera's video.

    Attributes:
        written: frames. lost: those that are not in it, by cause. how: ``copied`` (the camera's own packets) or ``encoded``.
        fault: why it ended early, or holds nothing. finished: the file was closed.
        first_s, last_s: times of the first and the last frame written, from the session's zero.
        longest_gap_s: longest time between two frames written in a row. zero_ns: the session's zero on its clock.
    """

    written: int = 0
    lost: Mapping[str, int] = field(default_factory=dict)
    how: str = ""
    fault: str = ""
    finished: bool = False
    first_s: float = 0.0
    last_s: float = 0.0
    longest_gap_s: float = 0.0
    zero_ns: int = 0

    @property
    def dropped(self) -> int:
        """Frames that are not in the video."""
        return sum(self.lost.values())

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

    def with_lost(self, frames: int, cause: str) -> KeptCounts:
        """With so many more that are not in the video."""
        return replace(self, lost={**self.lost, cause: self.lost.get(cause, 0) + frames}) if frames else self

    def complete(self, frames: int) -> KeptCounts:
        """At the end, when the video holds so many frames."""
        known = self.with_lost(max(0, self.written - frames), _NO_PACKET)
        return replace(known, written=frames, fault=known.fault or ("" if frames else _NOTHING))


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
        self._queue: queue.Queue[tuple[Pixels | EncodedFrame, int] | None] = queue.Queue()
        self._room_bytes, self._room = _ROOM_BYTES, threading.Lock()
        self._missing = self._no_room = 0
        self._counts = KeptCounts()
        self.zero_ns = 0
        self._thread = threading.Thread(target=self._run, name=f"video {camera}", daemon=True)
        self._thread.start()

    @property
    def at_work(self) -> bool:
        """Whether the file is not finished yet."""
        return self._thread.is_alive()

    def miss(self, frames: int) -> None:
        """Count frames that the source did not deliver."""
        self._missing += frames

    def offer(self, image: Pixels | EncodedFrame, t_ns: int) -> None:
        """A frame of time `t_ns` since the session's zero; dropped and counted where there is no room, or when it is not new."""
        if self._take_room(-_bytes_of(image)):
            self._queue.put((image, t_ns))
        else:
            self._no_room += 1

    def counts(self) -> KeptCounts:
        """As of now."""
        counts = self._counts.with_lost(self._no_room, _SLOW).with_lost(self._missing, _MISSING)
        return replace(counts, how=self._video.how, zero_ns=self.zero_ns)

    def finish(self) -> None:
        """Write what is queued, then finish the file; does not wait for that."""
        self._queue.put(None)

    def _take_room(self, change_bytes: int) -> bool:
        """Whether there is room; one image always fits."""
        with self._room:
            if change_bytes < 0 and self._room_bytes + change_bytes < 0 and not self._queue.empty():
                return False
            self._room_bytes += change_bytes
            return True

    def _run(self) -> None:
        lower_thread_priority(_NICENESS)
        while (item := self._queue.get()) is not None:
            self._write(*item)
            self._take_room(_bytes_of(item[0]))
        try:
            self._video.close()
            self._counts = replace(self._counts, finished=not self._counts.fault)
        except InputError as error:
            self._counts = replace(self._counts, fault=self._counts.fault or str(error))
        self._counts = self._counts.complete(self._video.frames)
        with contextlib.suppress(OSError):
            self._about.write_text(json.dumps(asdict(self.counts())) + "\n", encoding="utf-8")

    def _write(self, image: Pixels | EncodedFrame, t_ns: int) -> None:
        counts = self._counts
        if counts.fault:
            self._counts = counts.with_lost(1, counts.fault)
            return
        try:
            problem = self._video.write(image, t_ns)
        except Exception as error:  # noqa: BLE001 - a thread that ended would lose what comes unseen
            self._counts = replace(counts.with_lost(1, str(error)), fault=str(error))
            return
        if not problem:
            self._counts = counts.with_frame(t_ns / 1e9)
        elif counts.written:
            self._counts = counts.with_lost(1, problem)


def _bytes_of(image: Pixels | EncodedFrame) -> int:
    if isinstance(image, EncodedFrame):
        return sum(len(packet.data) for packet in image.packets)
    return 3 * image.size_wh[0] * image.size_wh[1]


def wait_for_videos(keepers: Sequence[VideoKeeper], tell: Callable[[], None] = lambda: None) -> None:
    """Wait until these are finished, as long as any of them makes progress; `tell` is called several times a second."""
    wait_while_working(lambda: [keeper.counts() for keeper in keepers if keeper.at_work], FINISH_S, tell)


def read_counts(folder: Path, cameras: Iterable[str]) -> dict[str, KeptCounts]:
    """What the keepers of these cameras counted, by name; where none was written, that the video was not finished."""
    return {camera: _counts_of(folder / f"{camera}.json") for camera in cameras}


def _counts_of(about: Path) -> KeptCounts:
    try:
        return settings_from_mapping(parse_json(str(about), read_text(about)), KeptCounts, where=str(about))
    except PosefuseError:
        return _found_counts(about.with_suffix(".mp4"), "was not finished: its process ended, or the disk was full")


def write_found_counts(video: Path) -> None:
    """Count what a video holds whose keeper was killed, and note it as the keeper would have; raises InputError."""
    about = video.with_suffix(".json")
    if not about.is_file():
        write_text(about, json.dumps(asdict(_found_counts(video, "its program ended early"))) + "\n")


def _found_counts(video: Path, fault: str) -> KeptCounts:
    """Of what the file holds; none where there is no file, or one that cannot be read."""
    counts = KeptCounts(fault=fault)
    with contextlib.suppress(SourceError):
        for t_ns in VideoConfig(video, video.stem).build().times_ns().tolist():
            counts = counts.with_frame(t_ns / 1e9)
    return counts
