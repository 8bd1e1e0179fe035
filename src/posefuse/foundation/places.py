"""Where results may go: never onto, around or into what they are made from, and only where there is room."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator, Sequence
from datetime import datetime
from pathlib import Path

import platformdirs

from posefuse.core import InputError

_Identity = tuple[int, int]


def real_path(path: Path) -> Path:
    """Absolute path without links; raises InputError for links that lead in a circle."""
    try:
        return path.resolve()
    except (OSError, RuntimeError) as error:
        raise InputError(f"{path}: cannot be followed ({error}); name another place") from None


def check_outside_inputs(path: Path, inputs: Sequence[Path]) -> None:
    """Raise InputError where `path` is, contains or lies inside one of `inputs`, under whatever name it is reached.

    Folders are compared by identity on their disk, so links and capital letters make no difference where the disk makes none.
    """
    target = real_path(path)
    own, above = _identity(target), set(_identities(target))
    for given in inputs:
        source = real_path(given)
        identity = _identity(source)
        if identity is None:
            continue
        if own == identity:
            raise InputError(f"{path}: this is the input {given} itself; choose another place for the results")
        if identity in above:
            raise InputError(f"{path}: this lies inside the input {given}; choose a place outside it for the results")
        if own is not None and own in set(_identities(source)):
            raise InputError(f"{path}: this contains the input {given}; choose another place for the results")


def check_space(folder: Path, needed_bytes: int) -> None:
    """Raise InputError where the disk of an existing `folder` has less than `needed_bytes` free."""
    free_bytes = shutil.disk_usage(folder).free
    if free_bytes < needed_bytes:
        raise InputError(
            f"{folder}: about {needed_bytes / 1e6:,.0f} MB will be written, {free_bytes / 1e6:,.0f} MB are free; "
            "make room or choose another disk"
        )


def holds_working_folder(folder: Path) -> bool:
    """Whether the folder the program was started in is `folder` or lies inside it."""
    own = _identity(folder)
    return own is not None and own in set(_identities(Path.cwd()))


def name_aside(path: Path) -> Path:
    """A free name ``NAME.replaced-YYYYmmddTHHMMSS`` next to `path`, to move it to."""
    name = f"{path.name}.replaced-{datetime.now():%Y%m%dT%H%M%S}"
    candidate, count = path.with_name(name), 1
    while candidate.exists() or candidate.is_symlink():
        count += 1
        candidate = path.with_name(f"{name}-{count}")
    return candidate


def _identity(path: Path) -> _Identity | None:
    """Disk and number of what is at `path`; None where nothing is."""
    try:
        found = path.stat()
    except (OSError, ValueError):
        return None
    return found.st_dev, found.st_ino


def _identities(path: Path) -> Iterator[_Identity]:
    """Identities of `path` and of every folder it lies in, as far as they exist."""
    for one in (path, *path.parents):
        identity = _identity(one)
        if identity is not None:
            yield identity


# Where things that can be had again are kept for the user: model files, compiled kernels.


def default_cache_dir() -> Path:
    """The user's cache folder: POSEFUSE_CACHE, else the system's place for caches (Linux: XDG_CACHE_HOME or ~/.cache)."""
    if own := os.environ.get("POSEFUSE_CACHE"):
        return Path(own)
    return Path(platformdirs.user_cache_dir("posefuse", appauthor=False))
