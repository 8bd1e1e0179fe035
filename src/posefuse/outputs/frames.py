"""Outputs that show images, fed by one pass over the frames so that nothing is decoded twice or kept."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Protocol, Self, runtime_checkable

import numpy as np

from posefuse.core import Frame, InputError, Recording, Sink

Frames = Sequence[Frame | None]
"""The frames of one time step: axis C in the order of the rig, None where a camera has none."""
FrameSets = Iterable[tuple[int, Frames]]
"""(t_ns, frames) in time order; t_ns as in the recording, time steps may be left out."""


ShowStep = Callable[[int, Frames], None]
"""Shows time step i of the recording, with its frames; i only grows."""


@runtime_checkable
class FrameSink(Sink, Protocol):
    """An output that can show images, in one file. Its `write` is the same without any.

    Attributes:
        file: its name.
    """

    file: ClassVar[str]

    def showing(self, recording: Recording, path: Path) -> AbstractContextManager[ShowStep]:
        """What shows each time step; the file is finished on a good end of the block, and removed on a bad one."""
        ...


@dataclass(frozen=True, kw_only=True)
class OutputOutcome:
    """The result of writing outputs.

    Attributes:
        files: made, in the order of the outputs. failed: the error of each output that could not be written, by its name.
    """

    files: tuple[Path, ...]
    failed: Mapping[str, Exception]


def write_outputs(sinks: Sequence[Sink], recording: Recording, folder: Path, frame_sets: FrameSets | None = None) -> list[Path]:
    """`write_each`; returns the files made, and raises the error of the first output that failed."""
    outcome = write_each(sinks, recording, folder, frame_sets)
    for error in outcome.failed.values():
        raise error
    return list(outcome.files)


def write_each(sinks: Sequence[Sink], recording: Recording, folder: Path, frame_sets: FrameSets | None = None) -> OutputOutcome:
    """Write all outputs of a recording into an existing folder, reading the frames once and keeping one set at a time.

    Time steps that `frame_sets` leaves out are shown without images; frame sets that are at no time step are skipped. An
    output that fails does not keep the others from being written.
    """
    made: dict[int, list[Path]] = {}
    failed: dict[int, Exception] = {}
    open_files: dict[int, tuple[ExitStack, ShowStep, Path]] = {}
    try:
        for place, sink in enumerate(sinks):
            with _noted(failed, place):
                if isinstance(sink, FrameSink):
                    whole, path = ExitStack(), folder / sink.file
                    open_files[place] = whole, whole.enter_context(sink.showing(recording, path)), path
                else:
                    made[place] = _files(sink.write(recording, folder), folder)
        for i, frames in every_time_step(recording, frame_sets or ()) if open_files else ():
            for place, (whole, show, _) in list(open_files.items()):
                with _noted(failed, place):
                    show(i, frames)
                if place in failed:
                    _end_badly(whole, failed[place])
                    del open_files[place]
    except BaseException as error:
        for whole, *_ in open_files.values():
            _end_badly(whole, error)
        raise
    for place, (whole, _, path) in open_files.items():
        with _noted(failed, place):
            whole.close()
            made[place] = [path]
    files = tuple(path for place in sorted(made) for path in made[place])
    return OutputOutcome(files=files, failed={sinks[place].name: error for place, error in sorted(failed.items())})


def _files(named: Iterable[Path] | None, folder: Path) -> list[Path]:
    """What an output names; raises InputError unless these are files in the folder."""
    found: list[Any] = [named] if named is None else [*named]
    for path in found:
        if not (isinstance(path, Path) and path.is_relative_to(folder) and path.is_file()):
            raise InputError(f"write() named {path}, expected the path of a file that it made in the folder given")
    return found


@contextmanager
def _noted(failed: dict[int, Exception], place: int) -> Iterator[None]:
    try:
        yield
    except Exception as error:  # noqa: BLE001 - also an unknown plug-in's bug must not cost the other outputs
        failed[place] = error


def _end_badly(whole: ExitStack, error: BaseException) -> None:
    with suppress(Exception):
        whole.__exit__(type(error), error, error.__traceback__)


class OwnConfig:
    """An output whose settings are itself."""

    def build(self) -> Self:
        """This output, ready."""
        return self


class ImageOutput(OwnConfig):
    """What our outputs that show images have in common; a `FrameSink` with `file` and the method `showing`."""

    def write(self: FrameSink, recording: Recording, folder: Path) -> list[Path]:
        """Write without images; returns the files made."""
        return write_outputs([self], recording, folder)


def every_time_step(recording: Recording, frame_sets: FrameSets) -> Iterator[tuple[int, Frames]]:
    """(i, frames) for each time step of the recording in order; its frames are those within half a period, else none."""
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
