"""Files from web addresses: resumed where a download broke off, from the next address where one is dead, checked by their hash.

The part that was received stays next to the file as ``NAME.part``; a second process waits for the first.
"""

from __future__ import annotations

import hashlib
import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from io import BufferedRandom
from pathlib import Path
from urllib.error import HTTPError, URLError
from urllib.request import Request, build_opener

from posefuse.core import ModelError
from posefuse.foundation.parsing import one_line

_TIMEOUT_S = 30.0
_PIECE_BYTES = 1 << 18
# of one address, with a pause that doubles
_ATTEMPTS, _PAUSE_S = 4, 1.0
_PARTIAL, _NOT_SATISFIABLE, _SERVER_ERROR = 206, 416, 500


def downloaded(
    urls: Sequence[str], target: Path, sha256: str, most_bytes: int, pause: Callable[[float], None] = time.sleep
) -> Path:
    """The file at the first address that gives it whole.

    A proxy is taken from the environment (``HTTPS_PROXY``).

    Args:
        urls: addresses of the same file, best first. target: where it goes; its folder exists.
        sha256: of the file; "" where no source states it. most_bytes: nothing larger is received.
        pause: for tests.

    Raises:
        ModelError: no address gives it, each with its reason; or there is no room for it.
    """
    part = target.with_name(f"{target.name}.part")
    reasons: list[str] = []
    try:
        with _alone(part) as file:
            if not _is_at(file, part):
                # another process has completed it meanwhile
                return target if target.is_file() else downloaded(urls, target, sha256, most_bytes, pause)
            whole = any(_received(url, file, sha256, most_bytes, pause, reasons) for url in urls)
        # a file that is open cannot be renamed on Windows; another process that waited for it may have been first
        with suppress(FileNotFoundError):
            if whole:
                part.replace(target)
            elif not part.stat().st_size:
                part.unlink()
    except OSError as error:
        raise ModelError(f"{part}: cannot be written ({error.strerror})") from None
    if not whole:
        raise ModelError(
            f"{target.name}: cannot be downloaded ({'; '.join(reasons)}); bring it from elsewhere:"
            " posefuse models NAME --from PATH"
        )
    return target


@contextmanager
def _alone(part: Path) -> Iterator[BufferedRandom]:
    """The part, open for this process only."""
    with part.open("a+b") as file:
        # Windows has none: there two downloads at once end with a wrong hash, and the next one starts from the beginning
        with suppress(ImportError, OSError):
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX)
        yield file


def _is_at(file: BufferedRandom, path: Path) -> bool:
    try:
        return os.path.samestat(path.stat(), os.fstat(file.fileno()))
    except FileNotFoundError:
        return False


def _received(
    url: str, file: BufferedRandom, sha256: str, most_bytes: int, pause: Callable[[float], None], reasons: list[str]
) -> bool:
    """Receive what is missing from one address; whether the file is whole, else `reasons` gets why it is not."""
    reason = ""
    for attempt in range(_ATTEMPTS):
        if attempt:
            pause(_PAUSE_S * 2 ** (attempt - 1))
        try:
            _receive(url, file, most_bytes)
        except _UnusableError as error:
            reason = str(error)
            break
        except (URLError, ConnectionError, TimeoutError, _BrokenOffError) as error:
            reason = one_line(getattr(error, "reason", error))
            continue
        got = _sha256(file)
        if not sha256 or got == sha256:
            return True
        # the beginning may have come from elsewhere, so once from the beginning
        file.truncate(0)
        reason = f"expected sha256 {sha256}, got {got}"
    reasons.append(f"{url}: {reason}")
    return False


class _UnusableError(Exception):
    """An address that does not get better by asking again."""


class _BrokenOffError(Exception):
    """A file that ended too early."""


def _receive(url: str, file: BufferedRandom, most_bytes: int) -> None:
    """Append what is missing."""
    begin = file.seek(0, os.SEEK_END)
    request = Request(url, headers={"Range": f"bytes={begin}-"} if begin else {})
    try:
        answer = build_opener().open(request, timeout=_TIMEOUT_S)
    except HTTPError as error:
        if error.code == _NOT_SATISFIABLE:
            # all of it is there, or more than the server has: the hash decides
            return
        if error.code >= _SERVER_ERROR:
            raise
        raise _UnusableError(f"HTTP {error.code} {error.reason}") from None
    with answer:
        if begin and answer.status != _PARTIAL:
            file.truncate(0)
            begin = 0
        length = int(answer.headers.get("Content-Length") or 0)
        if begin + length > most_bytes:
            raise _UnusableError(f"expected at most {most_bytes} bytes, got {begin + length}")
        got = 0
        while piece := answer.read(_PIECE_BYTES):
            got += len(piece)
            if begin + got > most_bytes:
                raise _UnusableError(f"expected at most {most_bytes} bytes, got more")
            file.write(piece)
        file.flush()
        if got < length:
            raise _BrokenOffError(f"broke off after {begin + got} of {begin + length} bytes")


def _sha256(file: BufferedRandom) -> str:
    file.seek(0)
    return hashlib.file_digest(file, "sha256").hexdigest()
