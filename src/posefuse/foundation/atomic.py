"""Results appear whole or not at all: written beside their place and renamed at the end."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from posefuse.core import InputError

PARTIAL = ".partial"


@contextmanager
def atomic_file(path: Path) -> Iterator[Path]:
    """Give a path beside `path` (same ending) to write to; it takes the name `path` when the block ends well.

    When the block raises, nothing is left and an older `path` stays as it was.

    Raises:
        InputError: the folder of `path` does not exist or cannot be written to, or `path` is a folder.
    """
    if not path.parent.is_dir():
        raise InputError(f"{path}: cannot be written, there is no folder {path.parent}")
    if path.is_dir():
        raise InputError(f"{path}: expected a file name, got a folder")
    beside = path.with_name(f"{path.stem}{PARTIAL}{path.suffix}")
    try:
        yield beside
        beside.replace(path)
    except PermissionError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror})") from None
    finally:
        beside.unlink(missing_ok=True)


@contextmanager
def atomic_folder(path: Path) -> Iterator[Path]:
    """Give an empty folder ``NAME.partial`` to fill; it becomes `path` when the block ends well, replacing an older one.

    When the block raises, the partial folder is removed and an older `path` stays as it was. An older `path` is
    replaced only if it is empty or a result of this kind (it holds a file named as one of those just written).

    Raises:
        InputError: `path` is a file, or a folder of something else; the parent cannot be written to.
    """
    if path.exists() and not path.is_dir():
        raise InputError(f"{path}: expected a folder to write results to, got a file")
    beside = path.with_name(path.name + PARTIAL)
    try:
        shutil.rmtree(beside, ignore_errors=True)
        beside.mkdir(parents=True)
    except OSError as error:
        raise InputError(f"{path}: no folder can be made there ({error.strerror})") from None
    try:
        yield beside
        _replace_folder(beside, path)
    finally:
        shutil.rmtree(beside, ignore_errors=True)


def _replace_folder(beside: Path, path: Path) -> None:
    if not path.exists():
        beside.rename(path)
        return
    there = {entry.name for entry in path.iterdir()}
    if there and not there & {entry.name for entry in beside.iterdir()}:
        raise InputError(f"{path}: holds other files ({', '.join(sorted(there)[:3])}); name an empty or a new folder")
    older = path.with_name(f"{path.name}.older-{os.getpid()}")
    path.rename(older)
    beside.rename(path)
    shutil.rmtree(older)
