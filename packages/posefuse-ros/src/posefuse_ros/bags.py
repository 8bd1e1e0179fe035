"""Recordings as MCAP with ROS 2 types: they open in Foxglove, `ros2 bag play` and every MCAP library.

Messages are kept in the order they were published, so a replay sees what the live run saw, in its order.
"""

from __future__ import annotations

import contextlib
import os
import struct
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np

from posefuse.core import SE3, Closing, Detections2D, InputError, MessageError, Pose3D, Rig, SourceError
from posefuse.core.arrays import Array
from posefuse.core.errors import choices, warn_caller

from . import topics
from .camera_messages import CAMERA_INFO_TYPE, camera_from_info
from .messages import detections_from_message, ns_from_time, optical_frame, pose_from_message
from .topics import Topic
from .types import decode, definition, encode, optional_module, ros2_types

_MB = 1e6


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


def mcap_records(path: Path, warn: Callable[[str], None]) -> Iterator[tuple[str, Any]]:
    """(kind, record) of everything in the file, in order; records that are too long are damage.

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
        records = stream_reader.StreamReader(reads, validate_crcs=True, record_size_limit=_MAX_MESSAGE_BYTES).records
        whole_bytes, any_record = 0, False
        while True:
            try:
                record = next(records, None)
            except _CutOff:
                if not any_record:
                    raise SourceError(
                        f"{path}: cannot be read as MCAP: it ends after {size} bytes, before its header does"
                    ) from None
                warn(
                    f"{path}: the recording was cut off; the last {(size - whole_bytes) / _MB:.3f} of {size / _MB:.3f} MB are "
                    "unfinished, later messages missing"
                )
                return
            except _damage() as error:
                where = f"damaged at byte {whole_bytes} of {size}" if any_record else "cannot be read as MCAP"
                raise SourceError(f"{path}: {where} ({str(error) or type(error).__name__})") from None
            if record is None:
                return
            any_record, whole_bytes = True, reads.read_bytes
            yield type(record).__name__, record


def _damage() -> tuple[type[BaseException], ...]:
    """What MCAP's reader and the libraries it unpacks with raise for bytes that make no sense."""
    mcap_error, zstd_error = optional_module("mcap.exceptions").McapError, optional_module("zstandard").ZstdError
    return (mcap_error, zstd_error, ValueError, struct.error, RuntimeError, MemoryError, OverflowError, EOFError)


_MAX_MESSAGE_BYTES = 2**28
_CHUNK_BYTES = 2**18
# so often it is looked whether the file is still there
_LOOK_S = 1.0
_NOTES = "posefuse_live"
Warn = Callable[[str], None]
"""Takes the one line about what is missing of a recording that was cut off; a `UserWarning` where none is given."""


class Recorder(Closing):
    """Writes messages to one .mcap file as they come (`topics.Outlet`).

    The file is whole after `close`; cut off before that it still holds all but the last part of a second or so. Once a second
    it is looked for: what is written to one that is gone would be lost.

    Raises:
        InputError: the file cannot be made, or already exists; when writing: it was removed, or its disk unplugged.
    """

    def __init__(self, path: Path) -> None:
        writer = optional_module("mcap.writer")
        self.path = path
        try:
            self._file = path.open("xb")
        except FileExistsError:
            raise InputError(f"{path} already exists; choose another name or move it away") from None
        except OSError as error:
            raise InputError(f"{path}: cannot be written ({error.strerror})") from None
        self._writer = writer.Writer(self._file, chunk_size=_CHUNK_BYTES, compression=writer.CompressionType.ZSTD)
        self._begin()
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._counts: dict[str, int] = {}
        self._looked_s, self._open = time.monotonic(), True

    def publish(self, topic: Topic, msg: Any, t_ns: int) -> None:
        """Record one message of the time `t_ns`; raises OSError when the disk is full."""
        self.write(topic, encode(msg), t_ns, t_ns)

    def write(self, topic: Topic, raw: bytes, logged_ns: int, sent_ns: int) -> None:
        """Record ready-made CDR bytes, e.g. as they came from a `dds.Reader`."""
        if time.monotonic() - self._looked_s > _LOOK_S:
            self._looked_s = time.monotonic()
            self._check_there()
        channel = self._channels.get(topic.name)
        if channel is None:
            channel = self._channels[topic.name] = self._register(topic)
        seq = self._counts[topic.name] = self._counts.get(topic.name, -1) + 1
        self._writer.add_message(channel, logged_ns, raw, sent_ns, seq)

    def _check_there(self) -> None:
        try:
            if os.path.samestat(os.fstat(self._file.fileno()), self.path.stat()):
                return
        except OSError:
            pass
        raise InputError(f"{self.path}: the file is gone; its folder was removed, or its disk unplugged")

    def note(self, texts: Mapping[str, str]) -> None:
        """Keep texts by their names, to be found by `read_notes`; before the first message."""
        self._writer.add_metadata(_NOTES, dict(texts))

    def wanted(self, topic: Topic) -> bool:
        """A file takes everything."""
        return True

    def forget(self, name: str) -> None:
        """Nothing to do: a file keeps its channels."""

    def close(self) -> None:
        """Finish the file; safe to call twice. Raises OSError when the disk is full; what was written before stays."""
        if self._open:
            self._open = False
            try:
                self._writer.finish()
                self._file.flush()
            finally:
                with contextlib.suppress(OSError):
                    self._file.close()

    def _begin(self) -> None:
        """Write the header now: a full disk is known at once, and leaves no empty file."""
        try:
            self._writer.start(profile="ros2", library="posefuse")
            # by it rosbag2 from Jazzy on knows that policies of topics are numbers, which earlier ones expect
            self._writer.add_metadata("rosbag2", {"ROS_DISTRO": "humble"})
            self._file.flush()
        except OSError as error:
            with contextlib.suppress(OSError):
                self._file.close()
            self.path.unlink(missing_ok=True)
            raise InputError(f"{self.path}: cannot be written ({error.strerror})") from None

    def _register(self, topic: Topic) -> int:
        schema = self._schemas.get(topic.type_name)
        if schema is None:
            text = definition(topic.type_name).encode()
            schema = self._schemas[topic.type_name] = self._writer.register_schema(topic.type_name, "ros2msg", text)
        metadata = {"offered_qos_profiles": _qos_yaml(topic)}
        return int(self._writer.register_channel(topic.name, "cdr", schema, metadata))


class Recorded(NamedTuple):
    """One message of a recording.

    Attributes:
        topic: its name. msg: the message. logged_ns: when it was recorded (Unix epoch).
    """

    topic: str
    msg: Any
    logged_ns: int


def read_mcap(
    path: Path, names: Collection[str] | None = None, warn: Warn | None = None, wanted: Callable[[str, int], bool] | None = None
) -> Iterator[Recorded]:
    """Messages of a ROS 2 .mcap file in the order they were written; `names` picks topics.

    `wanted` is asked with topic and logged time before a message is decoded; None: all of them.

    Types this package knows are checked against the file's own definition of them; others are skipped. A file that was cut off
    (power, full disk, a killed process) is read up to its last whole chunk, and `warn` gets one line about it.

    Raises:
        SourceError: no such file, no MCAP file, or one with a damaged part.
        MessageError: a message that is malformed, or of a type whose definition is not ours.
    """
    schemas: dict[int, Any] = {}
    channels: dict[int, Any] = {}
    checked: set[int] = set()
    for kind, record in mcap_records(path, warn or warn_caller):
        if kind == "Schema":
            schemas[record.id] = record
        elif kind == "Channel":
            channels[record.id] = record
        elif kind == "Message":
            channel = channels.get(record.channel_id)
            if channel is None:
                raise SourceError(f"{path}: damaged: a message belongs to channel {record.channel_id}, which is not in the file")
            schema = schemas.get(channel.schema_id)
            if schema is None or (names is not None and channel.topic not in names) or not _known(schema, channel):
                continue
            if wanted is not None and not wanted(channel.topic, record.log_time):
                continue
            if schema.id not in checked:
                _check_definition(path, schema)
                checked.add(schema.id)
            yield Recorded(channel.topic, decode(record.data, schema.name, _MAX_MESSAGE_BYTES), record.log_time)


def read_notes(path: Path) -> dict[str, str]:
    """Texts kept by `Recorder.note`; empty where there are none. Raises SourceError as `read_mcap` does."""
    # the reader of the messages reports that the file was cut off
    for kind, record in mcap_records(path, lambda line: None):
        if kind == "Metadata" and record.name == _NOTES:
            return dict(record.metadata)
        if kind == "Message":
            break
    return {}


def read_detections(path: Path, warn: Warn | None = None) -> Iterator[tuple[Detections2D, dict[str, int]]]:
    """Recorded 2D poses with their stages, in the order they arrived."""
    for recorded in read_mcap(path, {topics.DETECTIONS.name}, warn):
        yield detections_from_message(recorded.msg)


def read_poses(path: Path, warn: Warn | None = None) -> Iterator[tuple[Pose3D, dict[str, int]]]:
    """Recorded 3D poses with their stages, in the order they went out."""
    for recorded in read_mcap(path, {topics.POSE.name}, warn):
        yield pose_from_message(recorded.msg)


def read_clock(path: Path, warn: Warn | None = None) -> tuple[Array, Array]:
    """Times (T,) at which `/clock` was recorded and its simulated times (T,), ns; empty where there was none."""
    pairs = [(recorded.logged_ns, ns_from_time(recorded.msg.clock)) for recorded in read_mcap(path, {topics.CLOCK.name}, warn)]
    t_ns, sim_ns = np.array(pairs, np.int64).reshape(-1, 2).T
    return t_ns, sim_ns


def read_rig(path: Path, warn: Warn | None = None) -> Rig:
    """The cameras of a recording, from its `camera_info` topics and static transforms; names as ROS writes them.

    Raises:
        SourceError: it holds no camera, or one without a pose.
    """
    infos: dict[str, Any] = {}
    poses: dict[str, SE3] = {}
    suffix = optical_frame("")
    for topic, msg, _ in read_mcap(path, None, warn):
        if msg.__msgtype__ == CAMERA_INFO_TYPE:
            frame = msg.header.frame_id
            # those of previews are of a smaller image
            if topic == topics.camera_info(frame.removesuffix(suffix)).name:
                infos[frame] = msg
        elif msg.__msgtype__ == topics.TF_STATIC.type_name:
            poses |= {tf.child_frame_id: _pose(tf.transform) for tf in msg.transforms}
    lost = sorted(infos.keys() - poses.keys())
    if not infos or lost:
        missing = f"no pose in /tf_static for {choices(lost)}" if lost else "no camera_info"
        raise SourceError(f"{path}: the rig cannot be read: {missing}; give the rig file instead")
    cameras = (camera_from_info(frame.removesuffix(suffix), msg, poses[frame].inverse()) for frame, msg in infos.items())
    return Rig(tuple(cameras), world_set_by="recording")


def _pose(transform: Any) -> SE3:
    q, p = transform.rotation, transform.translation
    return SE3(np.array([q.w, q.x, q.y, q.z]), np.array([p.x, p.y, p.z]))


def _known(schema: Any, channel: Any) -> bool:
    return schema is not None and channel.message_encoding == "cdr" and schema.name in ros2_types().fielddefs


def _check_definition(path: Path, schema: Any) -> None:
    """Fields of a recorded type must be ours in name, type and order; comments and constants may differ."""
    typesys = optional_module("rosbags.typesys")
    fault = f"{path}: {schema.name} was recorded with another definition of that type"
    try:
        recorded = typesys.get_types_from_msg(schema.data.decode(), schema.name)
    except (typesys.TypesysError, UnicodeDecodeError) as error:
        raise MessageError(f"{fault} ({error})") from None
    ours = ros2_types().fielddefs
    for name, (_, fields) in recorded.items():
        if name not in ours or [tuple(f) for f in fields] != [tuple(f) for f in ours[name][1]]:
            raise MessageError(f"{fault}: {name} differs; convert the recording or use the version that made it")


_KEEP_LAST, _AUTOMATIC = 1, 1
_RELIABLE, _BEST_EFFORT = 1, 2
_TRANSIENT_LOCAL, _VOLATILE = 1, 2


def _qos_yaml(topic: Topic) -> str:
    """How `ros2 bag play` should offer the topic (rosbag2 metadata version 8): policies are numbers of `rmw/types.h`."""
    return (
        f"- history: {_KEEP_LAST}\n  depth: {topic.depth}\n"
        f"  reliability: {_RELIABLE if topic.reliable else _BEST_EFFORT}\n"
        f"  durability: {_TRANSIENT_LOCAL if topic.latched else _VOLATILE}\n"
        "  deadline:\n    sec: 9223372036\n    nsec: 854775807\n"
        "  lifespan:\n    sec: 9223372036\n    nsec: 854775807\n"
        f"  liveliness: {_AUTOMATIC}\n"
        "  liveliness_lease_duration:\n    sec: 9223372036\n    nsec: 854775807\n"
        "  avoid_ros_namespace_conventions: false\n"
    )
