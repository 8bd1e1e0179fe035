"""Live output ``record``: the session as an MCAP file with ROS 2 types, see `bags`."""

from __future__ import annotations

import contextlib
import shutil
import time
from pathlib import Path
from typing import Any, ClassVar

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
    LivePreview,
    LiveStart,
)
from posefuse.foundation.output_file import part_path
from posefuse.foundation.settings import settings

from . import topics
from .bags import Recorder
from .camera_messages import message_from_joint_centres
from .dds import RosNode
from .dds_domain import NetworkSettings
from .live_output import health_lines, publish_preview
from .markers import annotations_of_view
from .messages import message_from_detections, message_from_names, time_from_ns
from .ros_output import RosOutput
from .sim_time import ClockReader, SimulatedClock
from .types import message, optional_module

_WITHIN_S = 10.0
NOTES = "posefuse_live"
SUFFIX = ".mcap"
# a part that ends in its first second again is of no use
_LEAST_FREE_BYTES = 4 * 2**20
# so often it is looked whether the file is still there
_LOOK_S = 1.0
_TAKES = (LiveDetections, LivePose, LiveJointCentres, LiveNames, LiveHealth)
# what viewers draw is recorded so often
_SHOWN_NS = 1_000_000_000 // 30
# topics of a body that follow from others
_NOT_RECORDED = frozenset(topics.BODY_PARTS) - {"joint_states", "joint_angles", "urdf"}


def keep_clock(recorder: topics.Outlet, clock: SimulatedClock, t_ns: int) -> None:
    """Write the value of `clock` at `t_ns` of the session."""
    if clock.known:
        recorder.publish(topics.CLOCK, message(topics.CLOCK.type_name, clock=time_from_ns(clock.sim_from_real(t_ns))), t_ns)


class _SessionRecorder(Recorder):
    """Takes what a replay needs, small images, and what viewers draw while it is `shown`."""

    shown = True

    def wanted(self, topic: topics.Topic) -> bool:
        """See `topics.Outlet`."""
        name = topic.name
        if topic.latched or name == topics.POSE.name or name.endswith("/joint_angles") or "/preview/" in name:
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
        images: record the cameras' small images, too, with the 2D keypoints to draw over them.
        sim_time: cameras are stamped in simulated time: with every pose `/clock` is kept, as it was then.
    """

    path: Path
    spare: Path | None = None
    images: bool = False
    sim_time: bool = False
    takes: ClassVar[tuple[type[LiveMessage], ...]] = _TAKES
    keeps_all: ClassVar[bool] = True

    def __post_init__(self) -> None:
        if self.path.suffix.lower() != SUFFIX:
            raise ConfigError(f"{self.path}: expected a name that ends in {SUFFIX}, by which recordings are recognized")
        # an instance may accept more than its class states
        object.__setattr__(self, "takes", (*_TAKES, LivePreview) if self.images else _TAKES)

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
        self._shown_ns = -_SHOWN_NS
        self._looked_s = 0.0
        self._views: dict[str, Detections2D] = {}
        # whether the session got as far as a view or a pose
        self._filled = False

    @property
    def where(self) -> str:
        """The file that is open."""
        return str(self._recorder.path if self._recorder is not None else self._config.path)

    def take(self, message: LiveMessage) -> None:
        """See `LiveOutput`."""
        if self._recorder is not None and time.monotonic() - self._looked_s > _LOOK_S:
            self._looked_s = time.monotonic()
            self._recorder.check_there()
        match message:
            case LiveStart():
                self._open(message)
            case LiveDetections(detections=view):
                self._filled, self._views[view.camera] = True, view
                self._recorder.publish(topics.DETECTIONS, message_from_detections(view, message.stages_ns), view.t_ns)
            case LivePose():
                self._filled = True
                self._pose(message)
            case LivePreview():
                self._preview(message)
            case LiveJointCentres():
                self._recorder.publish(topics.JOINT_CENTRES, message_from_joint_centres(message), message.t_ns)
            case LiveNames(names=names):
                self._recorder.publish(topics.NAMES, message_from_names(names), message.t_ns)
            case LiveHealth():
                self._ros.diagnose(message.t_ns, health_lines(message))

    def close(self) -> None:
        """Finish the file."""
        if self._node is not None:
            self._node.close()
        if self._recorder is not None:
            self._recorder.close()
            if not self._filled:
                self._recorder.path.unlink(missing_ok=True)

    def _pose(self, message: LivePose) -> None:
        t_ns = message.pose.t_ns
        self._recorder.shown = not 0 <= t_ns - self._shown_ns < _SHOWN_NS * 19 // 20
        if self._recorder.shown:
            # due times, so that the rate does not fall to that of every fourth pose
            went_on = t_ns - self._shown_ns < 2 * _SHOWN_NS
            self._shown_ns = self._shown_ns + _SHOWN_NS if went_on and t_ns > self._shown_ns else t_ns
        if self._clock is not None:
            self._clock.update()
            keep_clock(self._recorder, self._clock.clock, t_ns)
        self._ros.step(message.pose, message.joints, message.stages_ns)

    def _preview(self, preview: LivePreview) -> None:
        publish_preview(self._recorder, preview, self._ros.rig)
        view = self._views.get(preview.camera)
        if view is not None and view.t_ns == preview.t_ns:
            msg = annotations_of_view(view, preview.size_wh, self._ros.rig[preview.camera].size_wh)
            self._recorder.publish(topics.preview_annotations(preview.camera), msg, preview.t_ns)

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
            self._clock.wait(_WITHIN_S)
        self._recorder = self._part(start.part)
        if start.notes:
            self._recorder.note(NOTES, {**start.notes, "part": str(start.part)})
        self._ros = RosOutput(self._recorder, start.rig)
        self._ros.start(start.t_ns)


def _with_room(path: Path) -> Path:
    """The path; raises InputError where its disk is full."""
    with contextlib.suppress(FileNotFoundError):
        free = shutil.disk_usage(path.parent).free
        if free < _LEAST_FREE_BYTES:
            raise InputError(
                f"{path}: the disk is full: {free / 2**20:.1f} MB free, expected {_LEAST_FREE_BYTES / 2**20:g} MB to continue"
            )
    return path
