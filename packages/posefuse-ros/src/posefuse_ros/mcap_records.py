"""Records of an MCAP file one after the other: a file that was cut off up to its last whole chunk, a damaged one refused."""

from __future__ import annotations

import struct
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from typing import IO, Any

from posefuse.core import SourceError

from .types import optional_module

_MB = 1e6
_S = 1e9


class _CutOff(Exception):
    """The file ends before a record does."""


class _WholeReads:
    """A file of which every read gives all that was asked for; MCAP's own reader would take half a chunk for a damaged one."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self.read_bytes = 0

    def read(self, count: int) -> bytes:
        raw = self._file.read(count)
        if len(raw) < count:
            raise _CutOff
        self.read_bytes += count
        return raw


def mcap_records(path: Path, most_bytes: int, warn: Callable[[str], None]) -> Iterator[tuple[str, Any]]:
    """(kind, record) of everything in the file, in order; records longer than `most_bytes` are damage.

    `warn` is given one line when the file was cut off.

    Raises:
        SourceError: no such file, no MCAP file, or a damaged one (checksums are checked).
    """
    stream_reader = optional_module("mcap.stream_reader")
    try:
        file, size = path.open("rb"), path.stat().st_size
    except OSError as error:
        raise SourceError(f"{path}: cannot be opened ({error.strerror})") from None
    with file:
        reads = _WholeReads(file)
        records = stream_reader.StreamReader(reads, validate_crcs=True, record_size_limit=most_bytes).records
        whole_bytes, any_record = 0, False
        spans: dict[int, _Span] = {}
        while True:
            try:
                record = next(records, None)
            except _CutOff:
                if not any_record:
                    raise SourceError(
                        f"{path}: cannot be read as MCAP: it ends after {size} bytes, before its header does"
                    ) from None
                warn(_cut_line(path, size, whole_bytes, spans.values()))
                return
            except _damage() as error:
                where = f"damaged at byte {whole_bytes} of {size}" if any_record else "cannot be read as MCAP"
                raise SourceError(f"{path}: {where} ({str(error) or type(error).__name__})") from None
            if record is None:
                return
            any_record, whole_bytes, kind = True, reads.read_bytes, type(record).__name__
            if kind == "Message":
                spans.setdefault(record.channel_id, _Span(record.log_time)).add(record.log_time)
            yield kind, record


class _Span:
    """How many messages a channel has, from when to when."""

    def __init__(self, first_ns: int) -> None:
        self.count, self.first_ns, self.last_ns = 0, first_ns, first_ns

    def add(self, t_ns: int) -> None:
        """Its next message."""
        self.count, self.last_ns = self.count + 1, t_ns


def _cut_line(path: Path, size: int, whole_bytes: int, spans: Collection[_Span]) -> str:
    # of the channel with the most messages: what is sent once may be long before
    longest = max(spans, key=lambda span: span.count, default=None)
    kept = "no message is left" if longest is None else f"{(longest.last_ns - longest.first_ns) / _S:.2f} s of it were read"
    cut, whole = (size - whole_bytes) / _MB, size / _MB
    return (
        f"{path}: the recording was cut off; {kept}; the last {cut:.3f} of {whole:.3f} MB are unfinished, later messages missing"
    )


def _damage() -> tuple[type[BaseException], ...]:
    """What MCAP's reader and the libraries it unpacks with raise for bytes that make no sense."""
    mcap_error, zstd_error = optional_module("mcap.exceptions").McapError, optional_module("zstandard").ZstdError
    return (mcap_error, zstd_error, ValueError, struct.error, RuntimeError, MemoryError, OverflowError, EOFError)
