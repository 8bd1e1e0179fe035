"""Numeric kernels compiled by numba, kept on disk between runs.

Numba looks only at the file of a function to see whether its compiled form is still good, so a kernel whose callee in another
file has changed would go stale unseen. Here the folder is named by the text of all kernel files of a room, whose kernels call no
other room's, and of what of the core they compile: a change of any of them starts a new folder for that room.
"""

from __future__ import annotations

import functools
import hashlib
import os
import shutil
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numba
from llvmlite import binding
from numba import config, njit

from .platform import default_cache_dir

_PACKAGE = Path(__file__).resolve().parents[1]
_KEPT_S = 14 * 86400.0  # the folder of another version goes when it was not used for so long
_settings: Any = config  # its names come from the environment while numba is imported


def kernel(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Decorator: `numba.njit(**options)` without the GIL and with IEEE division, its machine code kept on disk.

    For functions in files of `kernel_files` only: others would not be noticed when they change.
    """

    def compiled(function: Callable[..., Any]) -> Any:
        folder = _folder(function.__module__.split(".")[1])
        before, _settings.CACHE_DIR = _settings.CACHE_DIR, str(folder or "")
        try:
            return njit(cache=folder is not None, nogil=True, error_model="numpy", **options)(function)
        finally:
            _settings.CACHE_DIR = before

    return compiled


@contextmanager
def compiling(what: str, say: Callable[[str], None]) -> Iterator[None]:
    """Around the first use of the kernels of `what`: prints before it that they are compiled, where that was not done so far."""
    folder = _folder()
    # machine code is kept for one numba, one kind of processor, and one place of the source files
    place = hashlib.sha256(str(_PACKAGE).encode()).hexdigest()[:8]
    kept_for = f"{numba.__version__}-{binding.get_host_cpu_name()}-{place}"
    done = folder / f"{what.replace(' ', '_')}-{kept_for}.compiled" if folder else None
    if done is None or not done.exists():
        say(f"compiling the numeric kernels for {what}: about a minute" + (", the first time only" if done else ""))
    yield
    if done is not None:
        with suppress(OSError):
            done.touch()


def kernel_files(package: Path = _PACKAGE) -> list[Path]:
    """All files below a folder that may hold kernels: `kernels.py`, `*_kernels.py`, and what lies in a folder `kernels`."""
    return sorted(path for path in package.rglob("*.py") if path.stem.endswith("kernels") or path.parent.name == "kernels")


def room_files(room: str = "") -> list[Path]:
    """What the machine code of a room, or of all, is made from: kernel files, and what of the core they compile."""
    return [*kernel_files(_PACKAGE / room), _PACKAGE / "core" / "lens.py"]


def fingerprint(files: Sequence[Path]) -> str:
    """Changes with the text of any of the files."""
    digest = hashlib.sha256()
    for path in files:
        digest.update(hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()[:16]


@functools.cache
def _folder(room: str = "") -> Path | None:
    """The folder of a room's kernels as they are now, or of all; None where nothing can be written: every run compiles again."""
    folder = default_cache_dir() / "kernels" / fingerprint(room_files(room))
    try:
        folder.mkdir(parents=True, exist_ok=True)
        os.utime(folder)
        old_s = time.time() - _KEPT_S
        stale = [path for path in folder.parent.iterdir() if path.stat().st_mtime < old_s]
    except OSError:
        return None
    for path in stale:
        shutil.rmtree(path, ignore_errors=True)
    return folder if os.access(folder, os.W_OK) else None
