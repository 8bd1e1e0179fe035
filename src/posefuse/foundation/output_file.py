"""Single files of results, never onto, around or into what they are made from, and only where there is room; none is lost."""

from __future__ import annotations

import errno
import filecmp
import itertools
import re
import secrets
import shutil
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path

from posefuse.core import DiskFullError, InputError


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
    for given in inputs:
        source = real_path(given)
        if _same(target, source):
            raise InputError(f"{path}: this is the input {given} itself; choose another place for the results")
        if _inside(target, source):
            raise InputError(f"{path}: this lies inside the input {given}; choose a place outside it for the results")
        if _inside(source, target):
            raise InputError(f"{path}: this contains the input {given}; choose another place for the results")


def check_space(folder: Path, needed_bytes: int) -> None:
    """Raise InputError where the disk of an existing `folder` has less than `needed_bytes` free."""
    free_bytes = shutil.disk_usage(folder).free
    if free_bytes < needed_bytes:
        # rounded apart, so that the line holds of what it states, too
        needed, free = -(-needed_bytes // 1_000_000), free_bytes // 1_000_000
        raise InputError(f"{folder}: about {needed:,} MB will be written, {free:,} MB are free; make room or choose another disk")


def holds_working_folder(folder: Path) -> bool:
    """Whether the folder the program was started in is `folder` or lies inside it."""
    return _inside(Path.cwd(), folder)


def name_aside(path: Path) -> Path:
    """A free name ``NAME.replaced-YYYYmmddTHHMMSS`` next to `path`, to move it to."""
    name = f"{path.name}.replaced-{datetime.now():%Y%m%dT%H%M%S}"
    candidate, count = path.with_name(name), 1
    while candidate.exists() or candidate.is_symlink():
        count += 1
        candidate = path.with_name(f"{name}-{count}")
    return candidate


def _inside(path: Path, folder: Path) -> bool:
    """Whether `path`, or a folder that it lies in, is `folder`."""
    return any(_same(one, folder) for one in (path, *path.parents))


def _same(path: Path, other: Path) -> bool:
    """Whether the same is at both; False where nothing is at one of them."""
    try:
        return path.samefile(other)
    except (OSError, ValueError):
        return False


# A file appears whole or not at all: written under another name in the same folder and renamed at the end.


def is_disk_full(error: OSError) -> bool:
    """Whether there was no room to write: on the disk, within a quota, or within the largest size of a file."""
    return error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


@contextmanager
def atomic_file(path: Path) -> Iterator[Path]:
    """Give a new empty file in the folder of `path` (same ending) to write to; it takes the name `path` when the block ends well.

    When the block raises, nothing is left and an older `path` stays as it was. No other file is touched.

    Raises:
        InputError: the folder of `path` does not exist or cannot be written to, or `path` is a folder.
        DiskFullError: there is no room.
    """
    if not path.parent.is_dir():
        raise InputError(f"{path}: cannot be written, there is no folder {path.parent}")
    if path.is_dir():
        raise InputError(f"{path}: expected a file name, got a folder")
    try:
        temporary = new_file(path)
    except OSError as error:
        raise _unwritten(path, error) from None
    try:
        yield temporary
        temporary.replace(path)
    except OSError as error:
        # trouble with another file, or with a connection that content comes from
        if error.filename not in (None, str(temporary)) or isinstance(error, ConnectionError):
            raise
        raise _unwritten(path, error) from None
    finally:
        temporary.unlink(missing_ok=True)


def _unwritten(path: Path, error: OSError) -> InputError:
    kind = DiskFullError if is_disk_full(error) else InputError
    return kind(f"{path}: cannot be written ({error.strerror or error})")


def write_text(path: Path, text: str) -> None:
    """Write a UTF-8 file as `atomic_file` does, and raise as it does."""
    with atomic_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_lines(path: Path, lines: Iterable[str]) -> None:
    """`write_text` of lines, each ended by a line feed, that are made while the file is written."""
    with atomic_file(path) as temporary, temporary.open("w", encoding="utf-8", newline="\n") as file:
        file.writelines(f"{line}\n" for line in lines)


def new_file(path: Path) -> Path:
    """Make an empty file with a name of its own in the folder of `path`, with the ending of `path`.

    Like `tempfile.mkstemp`, but with the permissions of the user's other files: it becomes a result.

    Raises:
        OSError: it cannot be made.
    """
    new = path.with_name(f".{secrets.token_hex(8)}{path.suffix}")
    new.touch(exist_ok=False)
    return new


def new_folder(parent: Path, prefix: str, suffix: str) -> Path:
    """Make an empty folder ``PREFIXxxxxxxxxSUFFIX`` in `parent`.

    Like `tempfile.mkdtemp`, but with the permissions of the user's other folders: it becomes a result.

    Raises:
        OSError: it cannot be made.
    """
    new = parent / f"{prefix}{secrets.token_hex(4)}{suffix}"
    new.mkdir()
    return new


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


def part_path(path: Path, part: int) -> Path:
    """`path` for part 1; later ones get a number before the suffix (``NAME.2.mcap``), one no file has yet."""
    if part == 1:
        return path
    numbered = (path.with_name(f"{path.stem}.{number}{path.suffix}") for number in itertools.count(part))
    return next(name for name in numbered if not name.exists())


def parts_of(path: Path) -> list[Path]:
    """A file and the parts in which it is continued, in order."""
    pattern = re.compile(re.escape(path.stem) + r"\.(\d+)" + re.escape(path.suffix))
    numbered = ((pattern.fullmatch(file.name), file) for file in path.parent.glob(f"*{path.suffix}"))
    later = sorted((int(found[1]), file) for found, file in numbered if found)
    return [path, *(file for _, file in later)]


def check_first_part(path: Path, *, option: str) -> None:
    """`check_output_file` for a file that may be continued in later parts: its name may not join it to other files.

    Raises:
        InputError: it cannot be written, or its name makes it a part of another file, or another file a part of it.
    """
    check_output_file(path, option=option)
    first, _, number = path.stem.rpartition(".")
    if first and number.isdecimal() and path.with_name(f"{first}{path.suffix}").exists():
        raise InputError(f"{option} {path}: by its name it is a later part of {first}{path.suffix}; choose another name")
    if later := parts_of(path)[1:]:
        raise InputError(f"{option} {path}: by its name, {later[0].name} is a later part of it; choose another name")


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
