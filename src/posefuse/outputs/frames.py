"""Outputs that show images, fed by one pass over the frames so that nothing is decoded twice or kept."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np

from posefuse.core import Frame, Recording, Sink

Frames = Sequence[Frame | None]
"""One instant's frames: axis C in the order of the rig, None where a camera has none."""
FrameSets = Iterable[tuple[int, Frames]]
"""(t_ns, frames) in time order; t_ns as in the recording, instants may be left out."""


@runtime_checkable
class FrameWriter(Protocol):
    """An output being written; a context manager that finishes its files on a good end and removes them on a bad one."""

    def __enter__(self) -> FrameWriter:
        """Begin."""
        ...

    def __exit__(self, *problem: object) -> None:
        """End."""
        ...

    def add(self, i: int, frames: Frames) -> None:
        """Show instant i of the recording; i only grows."""
        ...

    @property
    def files(self) -> list[Path]:
        """The files made, once it has ended."""
        ...


@runtime_checkable
class FrameSink(Sink, Protocol):
    """An output that can show images. Its `write` is the same without any."""

    def writer(self, recording: Recording, folder: Path) -> FrameWriter:
        """Begin writing into an existing folder."""
        ...


def write_outputs(sinks: Sequence[Sink], recording: Recording, folder: Path, frame_sets: FrameSets | None = None) -> list[Path]:
    """Write all outputs of a recording into an existing folder, reading the frames once and keeping one set at a time.

    Instants that `frame_sets` leaves out are shown without images; frame sets that are no instant are skipped.

    Returns:
        The files made, in the order of `sinks`.
    """
    made: dict[int, list[Path]] = {}
    with ExitStack() as stack:
        writers: dict[int, FrameWriter] = {}
        for place, sink in enumerate(sinks):
            if isinstance(sink, FrameSink):
                writers[place] = stack.enter_context(sink.writer(recording, folder))
            else:
                made[place] = sink.write(recording, folder)
        if writers:
            for i, frames in every_instant(recording, frame_sets or ()):
                for writer in writers.values():
                    writer.add(i, frames)
    made |= {place: writer.files for place, writer in writers.items()}
    return [path for place in range(len(sinks)) for path in made[place]]


def write_without_frames(sink: FrameSink, recording: Recording, folder: Path) -> list[Path]:
    """The `write` of every frame sink."""
    return write_outputs([sink], recording, folder)


def every_instant(recording: Recording, frame_sets: FrameSets) -> Iterator[tuple[int, Frames]]:
    """(i, frames) for each instant of the recording in order; its frames are those within half a period, else none."""
    t_ns = recording.poses.t_ns
    reach_ns = float(np.median(np.diff(t_ns))) / 2 if len(t_ns) > 1 else 0.5e9
    nothing: Frames = (None,) * len(recording.rig)
    sets = iter(frame_sets)
    pending = next(sets, None)
    for i, now_ns in enumerate(t_ns.tolist()):
        while pending is not None and pending[0] < now_ns - reach_ns:
            pending = next(sets, None)
        if pending is not None and pending[0] <= now_ns + reach_ns:
            yield i, pending[1]
            pending = next(sets, None)
        else:
            yield i, nothing
