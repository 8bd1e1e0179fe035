"""Single files of results: an existing one is never lost."""

from __future__ import annotations

import filecmp
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from posefuse.core import InputError

from .atomic import new_file
from .places import check_outside_inputs, name_aside


def check_output_file(path: Path, *, option: str, inputs: Sequence[Path] = (), replace: bool | None = None) -> None:
    """Raise InputError unless a file can be written to `path`, before any work is done.

    Args:
        option: the option of the command line that names it, for the message.
        inputs: what the file is made from; it may not be, contain or lie inside any of them.
        replace: whether a file may be there already; None where the command has no --force.
    """
    if not path.absolute().parent.is_dir():
        raise InputError(f"{option} {path}: there is no folder {path.parent}")
    if path.is_dir():
        raise InputError(f"{option} {path}: expected a file name, got a folder")
    check_outside_inputs(path, inputs)
    if path.exists() and not replace:
        force = "" if replace is None else ", or add `replace=True`: the old one is then kept as NAME.replaced-TIME"
        raise InputError(f"{option} {path} already exists; choose another name{force}")
    try:
        new_file(path).unlink()
    except OSError as error:
        raise InputError(f"{option} {path}: cannot be written ({error.strerror})") from None


def keep_copy(path: Path) -> Path | None:
    """Copy an existing file to ``NAME.replaced-TIME`` before it is replaced; returns the copy.

    Raises:
        InputError: it cannot be copied.
    """
    if not path.is_file():
        return None
    aside = name_aside(path)
    try:
        shutil.copy2(path, aside)
    except OSError as error:
        raise InputError(f"{path}: cannot be kept as {aside.name} ({error.strerror}); nothing was replaced") from None
    return aside


@contextmanager
def earlier_kept(path: Path) -> Iterator[None]:
    """Around writing a file: what was at `path` before stays as ``NAME.replaced-TIME``, unless it is what was written again.

    Raises:
        InputError: it cannot be copied.
    """
    aside = keep_copy(path)
    yield
    if aside is not None and filecmp.cmp(aside, path, shallow=False):
        aside.unlink()
