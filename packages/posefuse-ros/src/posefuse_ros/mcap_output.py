"""Outputs as MCAP files with ROS 2 types, for Foxglove and `ros2 bag play`: live ``record``, and ``mcap`` of a recording.

The second holds what a live session would have published; see `bags`.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from datetime import datetime
from heapq import merge
from operator import attrgetter
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from posefuse.core import (
    ConfigError,
    Detections2D,
    InputError,
    LiveDetections,
    LiveHealth,
    LiveJointCentres,
    LiveMessage,
    LiveNames,
    LiveOutput,
    LivePose,
    LiveStart,
    Pose3D,
    Recording,
    Sink,
)
from posefuse.formats.recording import rig_values
from posefuse.foundation.output_file import atomic_file, part_path
from posefuse.foundation.parsing import plain
from posefuse.foundation.settings import settings

from . import topics
from .bags import Recorder
from .dds import RosNode
from .dds_domain import NetworkSettings
from .live_output import publish
from .messages import message_from_detections, time_from_ns
from .ros_output import RosOutput, ShownTimes
from .sim_time import ClockReader, SimulatedClock
from .types import message, optional_module


@settings
class McapSink:
    """``pose.mcap``: cameras, 2D poses of each view, 3D poses, REP-155 bodies, tf and markers.

    Attributes:
        epoch_offset_ns: Unix time at time 0 of the recording, added to every stamp; None: the start time stated in
            the files; where there is none, 0, or what brings a recording that begins before time 0 there.
    """

    epoch_offset_ns: int | None = None
    name: ClassVar[str] = "mcap"

    def build(self) -> Sink:
        """This output, ready; raises DependencyError without the extra `ros`."""
        optional_module("mcap.writer")
        return self

    def write(self, recording: Recording, folder: Path) -> list[Path]:
        """Write ``pose.mcap``; returns the file made."""
        path, begin_ns, offset_ns = folder / "pose.mcap", int(recording.poses.t_ns[0]), self.epoch_offset_ns
        if offset_ns is None:
            offset_ns = max(recorded_ns(recording.provenance), -begin_ns)
        with atomic_file(path) as staged:
            staged.unlink(missing_ok=True)
            with Recorder(staged) as recorder:
                recorder.note(_notes(recording, offset_ns))
                output = RosOutput(recorder, recording.rig, epoch_offset_ns=offset_ns)
                output.start(begin_ns)
                poses = (_present(recording.poses.at(i)) for i in range(len(recording.poses)))
                in_order: Iterator[Detections2D | Pose3D] = merge(_views(recording), poses, key=attrgetter("t_ns"))
                for one in in_order:
                    if isinstance(one, Pose3D):
                        output.step(one)
                    else:
                        stamped = replace(one, t_ns=one.t_ns + offset_ns)
                        # the first frames of a session were exposed a little before its time 0
                        recorder.publish(topics.DETECTIONS, message_from_detections(stamped, {}), max(stamped.t_ns, 0))
        return [path]


def _notes(recording: Recording, offset_ns: int) -> dict[str, str]:
    """What a second solve needs and no message has; the provenance as it is, and the stamp of its time 0."""
    return {
        "rig": json.dumps(rig_values(recording.rig)),
        "provenance": json.dumps(plain({**recording.provenance, "start_ns": offset_ns})),
    }


def recorded_ns(provenance: Mapping[str, Any]) -> int:
    """Unix time at time 0 of a recording: a live session's start, or the date that the camera wrote; 0 where neither is known."""
    if isinstance(start_ns := provenance.get("start_ns"), int):
        return start_ns
    with suppress(ValueError, TypeError):
        return round(datetime.fromisoformat(str(provenance["recorded"])).timestamp() * 1e9) if "recorded" in provenance else 0
    return 0


def _present(pose: Pose3D) -> Pose3D:
    """Only the people with any known keypoint at this time step."""
    here = np.isfinite(pose.xyz_world).all(axis=-1).any(axis=-1)
    return pose.people(np.asarray(here))


def _views(recording: Recording) -> Iterator[Detections2D]:
    """Of a live session every frame at its own time; of others what each camera saw of the people at the time steps."""
    if recording.is_live:
        log = recording.observations
        yield from (log.detections(i) for i in np.argsort(log.frame_t_ns, kind="stable").tolist())
    else:
        for i in range(len(recording.poses)):
            yield from _views_at(recording, i)


def _views_at(recording: Recording, i: int) -> Iterator[Detections2D]:
    """What each camera saw at time step i, people as fused."""
    for c, camera in enumerate(recording.rig):
        score = recording.views.score[i, :, c]
        here = (score > 0).any(axis=-1)
        t_ns, skeleton, views = int(recording.poses.t_ns[i]), recording.poses.skeleton, recording.views
        xy, sigma = views.xy_img[i, here, c], views.sigma_px[i, here, c]
        view = Detections2D.of(camera.name, t_ns, skeleton, xy, score[here], sigma)
        yield view if views.depth_m is None else replace(view, depth_m=views.depth_m[i, here, c])


SUFFIX = ".mcap"
# a part that ends in its first second again is of no use
_LEAST_FREE_BYTES = 4 * 2**20
_TAKES = (LiveDetections, LivePose, LiveJointCentres, LiveNames, LiveHealth)
# topics of a body that follow from others
_NOT_RECORDED = frozenset(topics.BODY_PARTS) - {"joint_states", "joint_angles"}


def keep_clock(recorder: topics.Outlet, clock: SimulatedClock, t_ns: int) -> None:
    """Write the value of `clock` at `t_ns` of the session."""
    if clock.known:
        recorder.publish(topics.CLOCK, message(topics.CLOCK.type_name, clock=time_from_ns(clock.sim_from_real(t_ns))), t_ns)


class _SessionRecorder(Recorder):
    """Takes what a replay needs, and what viewers draw while it is `shown`."""

    shown = True

    def wanted(self, topic: topics.Topic) -> bool:
        """See `topics.Outlet`."""
        name = topic.name
        if topic.latched or topic in (topics.DETECTIONS, topics.POSE) or name.endswith("/joint_angles"):
            return True
        return self.shown and name.removeprefix("/humans/bodies/").partition("/")[2] not in _NOT_RECORDED


@settings
class RecordConfig(NetworkSettings):
    """Detections and poses in the order the tracker took and gave them, so that a replay reproduces the session.

    Frames, joint states and markers go with them 30 times a second, so that viewers draw the people. The file of a session that
    did not start is removed.

    After a failure recording continues in ``NAME.2.mcap``, then ``.3`` and so on; no file is written over.

    Attributes:
        path: the file, whose name ends in .mcap; must not exist.
        spare: folder in which recording continues where that of `path` is gone or full; None waits until it can be written.
        sim_time: cameras are stamped in simulated time: with every pose `/clock` is kept, as it was then.
    """

    path: Path
    spare: Path | None = None
    sim_time: bool = False
    takes: ClassVar[tuple[type[LiveMessage], ...]] = _TAKES
    keeps_all: ClassVar[bool] = True

    def __post_init__(self) -> None:
        if self.path.suffix.lower() != SUFFIX:
            raise ConfigError(f"{self.path}: expected a name that ends in {SUFFIX}, by which recordings are recognized")

    def build(self) -> LiveOutput:
        """Not yet opened; raises DependencyError without the extra `ros`."""
        return RecordOutput(self)


class RecordOutput:
    """Writes one part."""

    name = "record"

    def __init__(self, config: RecordConfig) -> None:
        optional_module("mcap.writer")
        self._config = config
        self._recorder: Any = None
        self._ros: Any = None
        # where `/clock` is to be kept
        self._node: Any = None
        self._clock: Any = None
        self._shown = ShownTimes()
        # whether the session got as far as a view or a pose
        self._filled = False

    @property
    def where(self) -> str:
        """The file that is open."""
        return str(self._recorder.path if self._recorder is not None else self._config.path)

    def take(self, message: LiveMessage) -> None:
        """See `LiveOutput`."""
        match message:
            case LiveStart():
                self._open(message)
                return
            case LiveDetections():
                self._filled = True
            case LivePose(pose=Pose3D(t_ns=t_ns)):
                self._filled, self._recorder.shown = True, self._shown.due(t_ns)
                if self._clock is not None:
                    self._clock.update()
                    keep_clock(self._recorder, self._clock.clock, t_ns)
        publish(self._ros, message)

    def close(self) -> None:
        """Finish the file."""
        if self._node is not None:
            self._node.close()
        if self._recorder is not None:
            self._recorder.close()
            if not self._filled:
                self._recorder.path.unlink(missing_ok=True)

    def _part(self, part: int) -> _SessionRecorder:
        path, spare = self._config.path, self._config.spare
        if part == 1:
            return _SessionRecorder(path)
        try:
            return _SessionRecorder(_with_room(part_path(path, part)))
        except InputError:
            if spare is None:
                raise
            return _SessionRecorder(_with_room(part_path(spare / path.name, part)))

    def _open(self, start: LiveStart) -> None:
        if self._config.sim_time:
            self._node = RosNode("posefuse_record", self._config.network)
            self._clock = ClockReader(self._node)
            self._clock.wait()
        self._recorder = self._part(start.part)
        if start.notes:
            self._recorder.note({**start.notes, "part": str(start.part)})
        self._ros = RosOutput(self._recorder, start.rig)
        self._ros.start(start.t_ns)


def _with_room(path: Path) -> Path:
    """The path; raises InputError where its disk is full."""
    with suppress(FileNotFoundError):
        free = shutil.disk_usage(path.parent).free
        if free < _LEAST_FREE_BYTES:
            raise InputError(
                f"{path}: the disk is full: {free / 2**20:.1f} MB free, expected {_LEAST_FREE_BYTES / 2**20:g} MB to continue"
            )
    return path
