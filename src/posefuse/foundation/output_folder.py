"""The one way in which commands write a folder of results.

Results are made in a staging folder ``.NAME.xxxxxxxx.unfinished`` in the same parent and renamed at the end. An older result of
the same command (`folder_mark`) is moved to ``NAME.replaced-TIME`` with all that is in it; posefuse never removes a result.
"""

from __future__ import annotations

import dataclasses
import json
import shutil
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from posefuse import __version__
from posefuse.core import DiskFullError, InputError
from posefuse.core.errors import warn_caller

from .output_file import (
    check_outside_inputs,
    check_space,
    holds_working_folder,
    is_disk_full,
    name_aside,
    new_folder,
    real_path,
)

# The mark that posefuse puts into every folder it makes, so that it never takes any other folder for its own.
#
# ``posefuse-folder.json`` states the command that made the folder and, until it is complete, the name that it is made for.

MARK_FILE = "posefuse-folder.json"
_FORMAT = "posefuse folder"


@dataclasses.dataclass(frozen=True, kw_only=True)
class FolderMark:
    """What made a folder.

    Attributes:
        command: such as ``track``. unfinished: the name that it takes once it is complete; empty: it is complete.
    """

    command: str
    unfinished: str = ""


def write_mark(folder: Path, mark: FolderMark) -> None:
    """Write the mark of `folder`, replacing the one that is there; raises OSError where it cannot be written."""
    about = {"format": _FORMAT, "posefuse": __version__, **dataclasses.asdict(mark)}
    new = folder / f"{MARK_FILE}.new"
    try:
        new.write_text(json.dumps(about, indent=1) + "\n", encoding="utf-8")
        new.replace(folder / MARK_FILE)
    finally:
        new.unlink(missing_ok=True)


def read_mark(folder: Path) -> FolderMark | None:
    """The mark of a folder; None where there is none, or where the file of that name is not one of posefuse."""
    try:
        about = json.loads((folder / MARK_FILE).read_text(encoding="utf-8"))
        found = FolderMark(command=about["command"], unfinished=about["unfinished"])
        return found if about["format"] == _FORMAT else None
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None


_SUFFIX = ".unfinished"
_NAMED = 3  # entries named in a message
_LONGEST_NAME = 40  # characters of the target's name in that of its staging folder
# what Finder and Explorer leave in every folder they show
_DESKTOP_FILES = (".DS_Store", "Thumbs.db", "desktop.ini")


@dataclasses.dataclass(frozen=True, kw_only=True)
class OutputFolder:
    """A folder of results in the making.

    Attributes:
        folder: staging folder to write to. target: absolute path it takes at the end.
    """

    folder: Path
    target: Path

    def final(self, path: Path) -> Path:
        """Where a file of the staging folder lies at the end."""
        return self.target / path.relative_to(self.folder)


@contextmanager
def output_folder(
    path: Path,
    *,
    command: str,
    inputs: Sequence[Path] = (),
    replace: bool = False,
    estimated_bytes: int = 0,
    keep_unfinished: bool = False,
    unfinished: Path | None = None,
) -> Iterator[OutputFolder]:
    """Give a staging folder to fill; it becomes `path` when the block ends well. Everything is checked before the block.

    Where an older result is kept, and what an earlier run left, is a `UserWarning`.

    When the block raises, nothing is left, except what was finished when the disk was full; an older `path` stays as it was.

    Args:
        command: what makes the results; only results of the same command are replaced.
        inputs: what the results are made from; `path` may not be, contain or lie inside any of them.
        replace: whether an older result may be moved aside, as `move_aside` does.
        estimated_bytes: what will be written, compared with the free space.
        keep_unfinished: leave the staging folder when the block raises, if something was written to it; see `find_unfinished`.
        unfinished: a staging folder from `find_unfinished` to continue in, instead of a new one.

    Raises:
        InputError: before the block: `path` cannot be made or written to, overlaps an input, holds results (without
            `replace`) or anything that posefuse did not write; or too little space. After the block: `path` was changed
            meanwhile or cannot be written to; the finished results stay in the staging folder, which the message names.
        DiskFullError: the block raised this, or an OSError that means the same.
    """
    target = real_path(path)
    check_outside_inputs(path, inputs)
    check_replaceable(path, command=command, replace=replace)
    if not keep_unfinished:
        for left in find_unfinished(path):
            line = f"{left}: was left by an earlier run that could not be finished; delete it when it is not needed any more"
            warn_caller(line)
    made = _make_parents(path, target)
    staging = unfinished
    try:
        check_space(target.parent, estimated_bytes)
        staging = unfinished or _new_staging(path, target, command)
        yield OutputFolder(folder=staging, target=target)
    except BaseException as error:
        full = isinstance(error, DiskFullError) or (isinstance(error, OSError) and is_disk_full(error))
        kept = staging is not None and (keep_unfinished or full) and _holds_work(staging)
        if staging is not None and not kept:
            shutil.rmtree(staging, ignore_errors=True)
        _remove_empty(made)
        if full and not (keep_unfinished and isinstance(error, InputError)):
            reason = error.strerror if isinstance(error, OSError) else error
            outcome = f"what was finished until then is kept in {staging}" if kept else "nothing was written"
            raise DiskFullError(f"{path}: no room ({reason}); {outcome}") from None
        raise
    _finish(path, staging, target, command, replace)


def find_unfinished(path: Path) -> list[Path]:
    """Staging folders that posefuse left when it was interrupted while it made `path`, oldest first."""
    target = real_path(path)
    if not target.parent.is_dir():
        return []
    found = []
    # by name: a parent folder that was renamed took them along
    for folder in target.parent.glob(f".*{_SUFFIX}"):
        mark = read_mark(folder) if folder.is_dir() and not folder.is_symlink() else None
        if mark is not None and mark.unfinished == target.name:
            found.append(folder)
    return sorted(found, key=lambda folder: (folder / MARK_FILE).stat().st_mtime_ns)


def check_replaceable(path: Path, *, command: str, replace: bool) -> None:
    """Raise InputError unless results of `command` can go to `path`.

    A place where nothing is, an empty folder, and with `replace` a result of the same command can be used.
    """
    target = real_path(path)
    if not target.name:
        raise InputError(f"{path}: expected a folder to write results to, got the top of a disk")
    try:
        if not target.exists():
            return
        if not target.is_dir():
            raise InputError(f"{path}: expected a folder to write results to, got a file")
        if holds_working_folder(target):
            raise InputError(f"{path}: is the folder posefuse was started in, or contains it; choose another folder")
        names = sorted(entry.name for entry in target.iterdir() if entry.name not in _DESKTOP_FILES)
    except OSError as error:
        raise InputError(f"{path}: cannot be looked at ({error.strerror}); choose another folder") from None
    if names:
        _check_own(path, read_mark(target), names, command, replace)


def _check_own(path: Path, mark: FolderMark | None, names: Sequence[str], command: str, replace: bool) -> None:
    if mark is None:
        listed = ", ".join(names[:_NAMED]) + (", ..." if len(names) > _NAMED else "")
        raise InputError(f"{path}: holds what posefuse did not write ({listed}); choose an empty or a new folder")
    if mark.command != command:
        raise InputError(f"{path}: holds results of `posefuse {mark.command}`; choose another folder")
    if not replace:
        raise InputError(
            f"{path}: holds results already; choose another folder or add `replace=True`: the old ones are then kept in "
            "NAME.replaced-TIME"
        )


def growing_folder(path: Path, *, command: str, names: Iterable[str]) -> Path:
    """Open or make a folder that a command adds files of these names to over days; returns its absolute path.

    Raises:
        InputError: it cannot be made or written to, holds the results of another command, or posefuse did not make it and it
            holds a file of a name of ours.
    """
    target = real_path(path)
    if target.exists() and not target.is_dir():
        raise InputError(f"{path}: expected a folder to write results to, got a file")
    mark = read_mark(target)
    if mark is not None and mark.command != command:
        raise InputError(f"{path}: holds results of `posefuse {mark.command}`; choose another folder")
    if mark is not None:
        return target
    foreign = [name for name in (MARK_FILE, *names) if (target / name).exists() or (target / name).is_symlink()]
    if foreign:
        raise InputError(f"{path}: holds {', '.join(foreign)}, which posefuse did not write; choose another folder")
    try:
        target.mkdir(parents=True, exist_ok=True)
        write_mark(target, FolderMark(command=command))
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror})") from None
    return target


def _make_parents(path: Path, target: Path) -> list[Path]:
    """Make the folders that `target` lies in; returns those made, innermost first."""
    missing = [folder for folder in target.parents if not folder.exists()]
    try:
        if missing:
            target.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        _remove_empty(missing)
        raise InputError(f"{path}: no folder can be made there ({error.strerror})") from None
    return missing


def _new_staging(path: Path, target: Path, command: str) -> Path:
    staging = None
    try:
        if not target.exists():
            # a name the disk does not take shows here, and not after the work
            target.mkdir()
            target.rmdir()
        staging = new_folder(target.parent, f".{target.name[:_LONGEST_NAME]}.", _SUFFIX)
        write_mark(staging, FolderMark(command=command, unfinished=target.name))
    except OSError as error:
        if staging is not None:
            shutil.rmtree(staging, ignore_errors=True)
        raise InputError(f"{path}: no folder can be made there ({error.strerror})") from None
    return staging


def _holds_work(staging: Path) -> bool:
    return any(entry.name != MARK_FILE for entry in staging.iterdir())


def _remove_empty(folders: Sequence[Path]) -> None:
    for folder in folders:
        # not empty: something else was put there meanwhile, and it stays
        with suppress(OSError):
            folder.rmdir()


def _finish(path: Path, staging: Path, target: Path, command: str, replace: bool) -> None:
    try:
        write_mark(staging, FolderMark(command=command))
        # once more: hours may have passed
        check_replaceable(path, command=command, replace=replace)
        aside = _swap(staging, target)
    except (OSError, InputError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise InputError(f"{path}: the results are complete in {staging} but cannot be moved there ({reason})") from None
    if aside is not None:
        warn_caller(f"the earlier results are kept in {aside}")


def _swap(staging: Path, target: Path) -> Path | None:
    """Put the staging folder in its place; returns where the older result is now."""
    aside = move_aside(target)
    try:
        staging.rename(target)
    except BaseException:
        if aside is not None:
            aside.rename(target)
        raise
    return aside


def move_aside(folder: Path) -> Path | None:
    """Rename a folder to ``NAME.replaced-TIME``; an empty one is removed instead. Returns where it is now.

    Raises:
        OSError: it cannot be renamed.
    """
    if not folder.exists():
        return None
    if not any(folder.iterdir()):
        folder.rmdir()
        return None
    aside = name_aside(folder)
    folder.rename(aside)
    return aside
