"""The workspace: the only folder that the studio reads and writes, but for keys of sessions.

Values are JSON files of this user alone. A workspace may be a folder that others write to, or an archive from elsewhere: what
it holds is checked, and never trusted with a key. Keys are in the user's own folder of state.
"""

from __future__ import annotations

import hashlib
import os
import stat
from collections.abc import AsyncIterable, Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any, TypeVar

import platformdirs
from pydantic import ConfigDict, TypeAdapter, ValidationError

from posefuse.core import InputError
from posefuse.foundation.output_file import atomic_file
from posefuse.foundation.platform import home_folder

MOST_UPLOAD_BYTES = 4 * 2**30
STATE_FOLDER = ".posefuse-studio"
POSES_FILE = "recording.mcap"
"""Of a live recording, in its folder."""
_MOST_LETTERS = 80
# what Windows takes in no name, and what divides a camera from its source
_NOT_IN_NAMES = '"*/:<=>?\\|'
_RESERVED = {"con", "prn", "aux", "nul", *(f"{kind}{n}" for kind in ("com", "lpt") for n in range(1, 10))}


class StudioWorkspace:
    """A folder; every path that a page names is checked to lie inside it.

    Attributes:
        root: absolute, without links.

    Raises:
        InputError: `folder` is not an existing folder.
    """

    def __init__(self, folder: Path) -> None:
        if not folder.is_dir():
            raise InputError(f"workspace {folder}: expected an existing folder")
        self.root = folder.resolve()

    def path(self, name: str) -> Path:
        """The absolute path of `name`, given with ``/`` relative to the workspace.

        Raises:
            InputError: an absolute path, one with ``..``, or one that leaves the workspace through a link.
        """
        if not name:
            raise InputError("expected the name of a file or folder inside the workspace, got none")
        relative = PurePosixPath(name)
        # Windows: a drive, and a colon leads to a hidden part of a file
        elsewhere = bool(PureWindowsPath(name).drive) or (os.name == "nt" and ":" in name)
        if "\\" in name or "\0" in name or elsewhere or relative.is_absolute() or ".." in relative.parts:
            raise InputError(f"{name!r}: expected a path inside the workspace, without '..'")
        target = self.root.joinpath(*relative.parts)
        if not target.resolve().is_relative_to(self.root):
            raise InputError(f"{name!r}: leads out of the workspace")
        return target

    def existing(self, name: str) -> Path:
        """As `path`; raises InputError also where there is no such file or folder."""
        target = self.path(name)
        # unlike Path.exists, this takes a name that is too long for the disk as one of a missing file
        if not os.path.exists(target):  # noqa: PTH110
            raise InputError(f"{name!r}: not in the workspace")
        return target

    def name_of(self, path: Path) -> str:
        """The name that a page uses for a path inside the workspace; raises InputError for any other path."""
        try:
            return path.resolve().relative_to(self.root).as_posix()
        except ValueError:
            raise InputError(f"{path}: not inside the workspace {self.root}") from None

    def in_names(self, text: str) -> str:
        """A message with files named as pages name them, wherever the workspace is on the server."""
        return text.replace(f"{self.root}{os.sep}", "")

    def free_name(self, folder: str, stem: str, suffix: str = "") -> str:
        """``FOLDER/STEM``, or with ``-2``, ``-3`` ... where that exists; `folder` is made."""
        place = self.folder(folder)
        name, number = stem, 1
        while (place / f"{name}{suffix}").exists():
            number += 1
            name = f"{stem}-{number}"
        return f"{folder}/{name}{suffix}"

    def folder(self, name: str) -> Path:
        """A folder of the workspace, made where it is missing."""
        target = self.path(name)
        try:
            target.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"{name}: cannot be made ({error.strerror})") from None
        return target

    def files(self, *suffixes: str, depth: int = 3) -> list[str]:
        """Names of the files with these endings, at most `depth` folders deep, sorted; hidden and linked folders left out."""
        found: list[str] = []
        for place, folders, names in os.walk(self.root):
            here = Path(place).relative_to(self.root)
            folders[:] = [one for one in folders if not one.startswith(".") and len(here.parts) < depth]
            paths = [here / name for name in names if Path(name).suffix.lower() in suffixes and not name.startswith(".")]
            found += [path.as_posix() for path in paths if not (self.root / path).is_symlink()]
        return sorted(found)

    async def upload(self, folder: str, file_name: str, parts: AsyncIterable[bytes], most_bytes: int = MOST_UPLOAD_BYTES) -> str:
        """Write what a page sends under a free name in `folder`; returns that name.

        Raises:
            InputError: a file name that is not plain, or more than `most_bytes`. Nothing is left then.
        """
        check_name(file_name)
        stem, suffix = Path(file_name).stem, Path(file_name).suffix
        name = self.free_name(folder, stem, suffix)
        with atomic_file(self.path(name)) as temporary, temporary.open("wb") as file:
            size = 0
            async for part in parts:
                size += len(part)
                if size > most_bytes:
                    raise InputError(f"{file_name}: more than {most_bytes / 2**20:,.0f} MB; copy it into {self.root} instead")
                file.write(part)
        return name


def recording_place(name: str) -> PurePosixPath:
    """What a recording is known by: its own name, or its folder's for the file that a live session writes there."""
    place = PurePosixPath(name)
    return place.parent if place.name == POSES_FILE and place.parent.name else place


def check_name(name: str) -> None:
    """Raise InputError for a name of a file, folder or camera that some system does not take."""
    if not 1 <= len(name) <= _MOST_LETTERS or not name.isprintable() or set(name) & set(_NOT_IN_NAMES):
        raise InputError(f"{name!r}: expected a name of 1 to {_MOST_LETTERS} characters, none of them one of {_NOT_IN_NAMES}")
    if name.startswith((".", "-", " ")) or name.endswith((".", " ")) or name.split(".")[0].strip().lower() in _RESERVED:
        raise InputError(f"{name!r}: expected a name without '.', '-' or a space at its begin or end, and not one of a device")


T = TypeVar("T")
adapter: Callable[[Any], TypeAdapter[Any]] = cache(TypeAdapter)
"""What checks values of a class."""


def private_folder() -> Path:
    """The user's folder for this, mode 0700; made where it is missing."""
    folder = home_folder(platformdirs.user_state_dir, "XDG_STATE_HOME") / "studio"
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made ({error.strerror})") from None
    return folder


def write_private(path: Path, text: str) -> None:
    """Whole or not at all, readable by its owner only."""
    with atomic_file(path) as temporary:
        temporary.chmod(0o600)
        temporary.write_text(text, encoding="utf-8")


def write_stored(path: Path, value: Any) -> None:
    """A dataclass or plain values, see `write_private`."""
    write_private(path, adapter(type(value)).dump_json(value).decode())


def read_stored(path: Path, cls: type[T]) -> T | None:
    """A value of a class that this user has written; None where it is missing, damaged, of another form or owner, or a link."""
    try:
        # as others may change the file between a look at it and its reading, the look is at what is open
        with os.fdopen(os.open(path, os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0)), "rb") as file:
            found = os.fstat(file.fileno())
            ours = not hasattr(os, "geteuid") or found.st_uid == os.geteuid()
            made: T | None = adapter(cls).validate_json(file.read()) if ours and stat.S_ISREG(found.st_mode) else None
            return made
    except (OSError, ValidationError):
        return None


@dataclass(frozen=True, kw_only=True)
class SessionAddress:
    """Where the process of a job listens on the loopback address, and the key that both ends prove to have."""

    __pydantic_config__ = ConfigDict(ser_json_bytes="hex", val_json_bytes="hex")

    port: int
    key: bytes


def address_file(workspace: Path, job: str) -> Path:
    """For the `SessionAddress` of a job; raises InputError where it has no place."""
    name = hashlib.sha256(f"{workspace}\0{job}".encode()).hexdigest()
    return private_folder() / f"{name[:32]}.json"
