"""Files of this user alone, outside of every workspace: how the server reaches a session, and the page that opens the browser.

A workspace may be a folder that others write to, or an archive from elsewhere: what it holds is never trusted with a key.
"""

from __future__ import annotations

import hashlib
import json
import os
import stat
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import platformdirs

from posefuse.core import InputError
from posefuse.foundation.output_file import atomic_file


def private_folder() -> Path:
    """The user's folder for this, mode 0700; made where it is missing."""
    folder = Path(platformdirs.user_state_dir("posefuse", appauthor=False)) / "studio"
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made ({error.strerror})") from None
    return folder


def write_own(path: Path, text: str) -> None:
    """Whole or not at all, readable by its owner only."""
    with atomic_file(path) as temporary:
        temporary.chmod(0o600)
        temporary.write_text(text, encoding="utf-8")


def read_own(path: Path) -> dict[str, Any]:
    """A JSON object that this user has written; empty where it is missing, damaged, a link, or of another owner."""
    try:
        # as others may change the file between a look at it and its reading, the look is at what is open
        with os.fdopen(os.open(path, os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0)), "rb") as file:
            found = os.fstat(file.fileno())
            ours = not hasattr(os, "geteuid") or found.st_uid == os.geteuid()
            content = json.load(file) if ours and stat.S_ISREG(found.st_mode) else {}
    except (OSError, ValueError, RecursionError):
        return {}
    return content if isinstance(content, dict) else {}


@dataclass(frozen=True, kw_only=True)
class SessionAddress:
    """Where the process of a job listens on the loopback address, and the key that both ends prove to have."""

    port: int
    key: bytes


def write_address(workspace: Path, job: str, address: SessionAddress) -> None:
    """For servers of this user; raises InputError where it cannot be written."""
    write_own(_address_file(workspace, job), json.dumps({"port": address.port, "key": address.key.hex()}))


def read_address(workspace: Path, job: str) -> SessionAddress | None:
    """None where the job does not listen, or not yet."""
    content: Mapping[str, Any] = read_own(_address_file(workspace, job))
    try:
        return SessionAddress(port=int(content["port"]), key=bytes.fromhex(content["key"]))
    except (KeyError, TypeError, ValueError):
        return None


def delete_address(workspace: Path, job: str) -> None:
    """When the job ends."""
    _address_file(workspace, job).unlink(missing_ok=True)


def _address_file(workspace: Path, job: str) -> Path:
    name = hashlib.sha256(f"{workspace}\0{job}".encode()).hexdigest()
    return private_folder() / f"{name[:32]}.json"
