"""Values as JSON files of this user alone: in the workspace, and keys of sessions in the user's own folder of state.

A workspace may be a folder that others write to, or an archive from elsewhere: what it holds is checked, and never trusted
with a key.
"""

from __future__ import annotations

import hashlib
import os
import stat
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import platformdirs
from pydantic import ConfigDict, TypeAdapter, ValidationError

from posefuse.core import InputError
from posefuse.foundation.output_file import atomic_file

T = TypeVar("T")
adapter: Callable[[Any], TypeAdapter[Any]] = cache(TypeAdapter)
"""What checks values of a class."""


def private_folder() -> Path:
    """The user's folder for this, mode 0700; made where it is missing."""
    folder = Path(platformdirs.user_state_dir("posefuse", appauthor=False)) / "studio"
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
