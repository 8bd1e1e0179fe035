"""One way to read a finished result, whatever made it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from posefuse.core import InputError, Recording
from posefuse.core.arrays import Array
from posefuse.core.errors import warn_caller
from posefuse.formats.recording import ABOUT_FILE, RECORDING_FILES, read_recording
from posefuse.foundation.output_file import parts_of
from posefuse.foundation.plugins import from_package

LIVE_SUFFIX = ".mcap"


def is_live(path: Path) -> bool:
    """Whether `path` names a recording of a live session (or of any other MCAP file) rather than a result folder."""
    return path.suffix.lower() == LIVE_SUFFIX and not path.is_dir()


class LiveReader(Protocol):
    """Reads recordings of live sessions: a module, entry point ``mcap`` of the group ``posefuse.readers``."""

    def read(self, path: Path, warn: Callable[[str], None], *, start_s: float | None, end_s: float | None) -> Recording:
        """The recording of the file and its later parts; of a part of the session, where one is named."""
        ...

    def simulated_times(self, path: Path) -> tuple[Array, Array]:
        """Times (T,) of the session and the simulated times (T,) then, ns; empty where it kept none."""
        ...


def live_reader() -> LiveReader:
    """Raises DependencyError without the extra `ros`."""
    found: LiveReader = from_package("readers", LIVE_SUFFIX[1:], extra="ros")
    return found


def is_result(path: Path) -> bool:
    """Whether `path` is a result folder of posefuse, complete or not."""
    return (path / ABOUT_FILE).is_file()


def read_result(
    path: Path | str,
    warn: Callable[[str], None] | None = None,
    *,
    start_s: float | None = None,
    end_s: float | None = None,
    observed: bool = True,
) -> Recording:
    """Read a result folder of `posefuse track`, or the .mcap file of a live session with its later parts.

    Args:
        warn: is given one line about what is missing of a recording that was cut off; a `UserWarning` where none is given.
        start_s, end_s: of a live session, this part alone is decoded (and a little on both sides).
        observed: False: a result folder is read without the detections that it was made from.

    Raises:
        InputError: neither of the two, or one that is incomplete or of another format version.
        SourceError: a damaged MCAP file.
    """
    path = Path(path)
    if is_live(path):
        return live_reader().read(path, warn or warn_caller, start_s=start_s, end_s=end_s)
    if not path.exists():
        raise InputError(f"{path}: no such file or folder")
    if path.is_file():
        raise InputError(f"{path}: expected a result folder of `posefuse track` or a {LIVE_SUFFIX} file of `posefuse live`")
    return read_recording(path, observed=observed)


def files_of_result(path: Path) -> list[Path]:
    """The files that `read_result` reads: what an output must not be written over."""
    if is_live(path):
        return parts_of(path)
    return [path / name for name in RECORDING_FILES]
