"""Detections stored while they are made: an append-only file that loses nothing but its end, whatever happens.

A header, then one record per answer of the detector. Each begins with its length and CRC-32, so that a tail that was cut off or
never reached the disk is detected. Numbers are little endian. Depth follows the other arrays of a camera that has any, whose
number then carries a mark.
"""

from __future__ import annotations

import json
import os
import struct
import time
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from posefuse.core import DetectionBatch, Detections2D, InputError, LookKind, PosefuseError, Skeleton
from posefuse.core.arrays import Array
from posefuse.core.values import DETECTION_ARRAYS, DETECTION_DTYPES
from posefuse.foundation.parsing import read_bytes

LOG_FILE = "detections.log"
_MAGIC = b"posefuse detections 2\n"
_FRAME = struct.Struct("<II")  # bytes of the record, CRC-32
_BATCH = struct.Struct("<iqBH")  # time step, its ns, look, frames
_CAMERA = struct.Struct("<HqH")  # camera, exposure ns, detections
# arrays of a detection in their order: type, and axes
_ARRAYS = {name: (np.dtype(DETECTION_DTYPES[name]).newbyteorder("<"), axes.split()) for name, axes in DETECTION_ARRAYS.items()}
_WITH_DEPTH = 1 << 15  # the mark
_LARGEST = 1 << 28  # bytes of one record; more is a damaged length
_SYNC_S = 2.0  # seconds of work that a power failure may cost


@dataclass(frozen=True, kw_only=True)
class StoredDetections:
    """The whole records of a log.

    Attributes:
        made_with: plain JSON values that identify inputs and settings.
        batches: in the order in which they were made. ends: byte in the file after each.
        begin: byte at which the first record begins.
    """

    made_with: Mapping[str, Any]
    batches: tuple[DetectionBatch, ...]
    ends: tuple[int, ...]
    begin: int

    def whole_steps(self) -> tuple[tuple[DetectionBatch, ...], int]:
        """The batches of all time steps but the last, which may lack a look, and the byte in the file after them."""
        last = self.batches[-1].step if self.batches else 0
        count = sum(batch.step < last for batch in self.batches)
        return self.batches[:count], self.ends[count - 1] if count else self.begin


class ObservationLog:
    """Writes a log; every record is handed to the operating system at once, and to the disk every few seconds.

    Args:
        path: the file; a new one, or one that continues after its first `keep` bytes.
        skeleton: of all detections. camera_names: axis C. made_with: see `StoredDetections`.

    Raises:
        InputError: the file cannot be written to, or another process writes to it.
    """

    def __init__(
        self,
        path: Path,
        *,
        skeleton: Skeleton,
        camera_names: tuple[str, ...],
        made_with: Mapping[str, Any],
        keep: int = 0,
    ) -> None:
        self._path, self._skeleton, self._camera_names = path, skeleton, camera_names
        self._synced_s = time.monotonic()
        try:
            self._file: BinaryIO = path.open("r+b" if keep else "xb", buffering=0)
        except OSError as error:
            raise _unwritable(path, error) from None
        try:
            _lock(self._file, path)
            self._file.truncate(keep)
            self._file.seek(keep)
            if not keep:
                about = {"skeleton": asdict(skeleton), "camera_names": camera_names, "made_with": made_with}
                self._write(_MAGIC + _record(json.dumps(about).encode()))
        except BaseException:
            self._file.close()
            raise

    def append(self, batch: DetectionBatch) -> None:
        """Store one answer of the detector; raises InputError when it cannot be written (the disk is full)."""
        self._write(_record(_bytes_of(batch, self._camera_names)))
        now_s = time.monotonic()
        if now_s - self._synced_s > _SYNC_S:
            os.fsync(self._file.fileno())
            self._synced_s = now_s

    def close(self) -> None:
        """Close the file; safe to call twice."""
        self._file.close()

    def _write(self, content: bytes) -> None:
        try:
            _write_all(self._file, content)
        except OSError as error:
            raise _unwritable(self._path, error) from None


def is_in_use(path: Path) -> bool:
    """Whether another process writes to the log (not known on Windows)."""
    try:
        with path.open("rb") as file:
            _lock(file, path)
    except (InputError, OSError):
        return True
    return False


def read_log(path: Path) -> StoredDetections:
    """All whole records of a log; a tail that was cut off is left out.

    Raises:
        InputError: the file cannot be read or is no log.
    """
    content = read_bytes(path)
    if not content.startswith(_MAGIC):
        raise InputError(f"{path}: not a log of detections, or of another version of posefuse")
    records = _records(content, len(_MAGIC))
    header = next(records, None)
    if header is None:
        raise InputError(f"{path}: the header is cut off; nothing can be read from it")
    about, begin = json.loads(header[0]), header[1]
    try:
        skeleton, names = Skeleton(**about["skeleton"]), tuple(about["camera_names"])
        found = [(_batch_of(record, skeleton, names), end) for record, end in records]
    except (KeyError, TypeError, ValueError, IndexError, struct.error, PosefuseError) as error:
        raise InputError(f"{path}: a record is not as it was written ({error})") from None
    batches, ends = tuple(batch for batch, _ in found), tuple(end for _, end in found)
    return StoredDetections(made_with=about["made_with"], batches=batches, ends=ends, begin=begin)


def _records(content: bytes, at: int) -> Iterator[tuple[bytes, int]]:
    """Each whole record from byte `at` on, and the byte after it."""
    while at + _FRAME.size <= len(content):
        size, crc = _FRAME.unpack_from(content, at)
        at += _FRAME.size
        record = content[at : at + size]
        if size > _LARGEST or len(record) < size or zlib.crc32(record) != crc:
            return
        at += size
        yield record, at


def _record(content: bytes) -> bytes:
    return _FRAME.pack(len(content), zlib.crc32(content)) + content


def _bytes_of(batch: DetectionBatch, names: tuple[str, ...]) -> bytes:
    parts = [_BATCH.pack(batch.step, batch.t_ns, batch.kind, len(batch.detections))]
    for one in batch.detections:
        mark = 0 if one.depth_m is None else _WITH_DEPTH
        parts.append(_CAMERA.pack(names.index(one.camera) | mark, one.t_ns, len(one)))
        layout = _layout(mark)
        parts += [np.ascontiguousarray(getattr(one, name), dtype).tobytes() for name, (dtype, _) in layout.items()]
    return b"".join(parts)


def _layout(mark: int) -> Mapping[str, tuple[np.dtype[Any], list[str]]]:
    """The arrays of a camera whose number carries this mark."""
    return {**_ARRAYS, "depth_m": _ARRAYS["xy_img"]} if mark else _ARRAYS


def _batch_of(record: bytes, skeleton: Skeleton, names: tuple[str, ...]) -> DetectionBatch:
    stream = BytesIO(record)
    step, t_ns, kind, frames = _BATCH.unpack(stream.read(_BATCH.size))
    detections = []
    for _ in range(frames):
        camera, exposed_ns, people = _CAMERA.unpack(stream.read(_CAMERA.size))
        sizes, layout = {"P": people, "K": len(skeleton)}, _layout(camera & _WITH_DEPTH)
        arrays = {name: _read(stream, dtype, axes, sizes) for name, (dtype, axes) in layout.items()}
        detections.append(Detections2D(camera=names[camera & ~_WITH_DEPTH], t_ns=exposed_ns, skeleton=skeleton, **arrays))
    return DetectionBatch(step=step, t_ns=t_ns, kind=LookKind(kind), detections=tuple(detections))


def _read(stream: BytesIO, dtype: np.dtype[Any], axes: list[str], sizes: Mapping[str, int]) -> Array:
    shape = [sizes[axis] if axis in sizes else int(axis) for axis in axes]
    return np.frombuffer(stream.read(dtype.itemsize * int(np.prod(shape))), dtype).reshape(shape)


def _write_all(file: BinaryIO, content: bytes) -> None:
    while content:
        content = content[file.write(content) :]


def _unwritable(path: Path, error: OSError) -> InputError:
    return InputError(f"{path}: detections cannot be stored ({error.strerror})")


def _lock(file: BinaryIO, path: Path) -> None:
    try:
        import fcntl
    except ImportError:  # Windows: the file has no lock, two runs into one folder are not noticed
        return
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise InputError(f"{path}: another posefuse is writing to it; wait for it, or choose another folder") from None
    except OSError:  # a network file system without locks
        return
