"""Live output ``record``: the session as an MCAP file with ROS 2 types, see `wire.bags`."""

from __future__ import annotations

import contextlib
import shutil
from pathlib import Path
from typing import Any, ClassVar

from posefuse.core import InputError, LiveDetections, LiveHealth, LiveJointCentres, LiveMessage, LiveOutput, LivePose, LiveStart
from posefuse.foundation.settings import settings
from posefuse.messages import topics
from posefuse.messages.messages import message_from_detections
from posefuse.messages.ros_output import RosOutput, publish_pose

from .parts import part_path
from .ros import health_lines, message_from_live_centres

NOTES = "posefuse_live"
# a part that ends in its first second again is of no use
_LEAST_FREE_BYTES = 4 * 2**20


@settings
class RecordConfig:
    """Detections and poses in the order the tracker took and gave them, so that a replay reproduces the session.

    After a failure recording goes on in ``NAME.2.mcap``, then ``.3`` and so on; no file is written over.

    Attributes:
        path: the .mcap file; must not exist.
    """

    path: Path
    takes: ClassVar[tuple[type[LiveMessage], ...]] = (LiveDetections, LivePose, LiveJointCentres, LiveHealth)
    keeps_all: ClassVar[bool] = True

    def build(self) -> LiveOutput:
        """Not yet opened; raises DependencyError without the extra `ros`."""
        return RecordOutput(self)


class RecordOutput:
    """Writes one part."""

    name = "record"

    def __init__(self, config: RecordConfig) -> None:
        from posefuse.messages.types import optional_module

        optional_module("mcap.writer")
        self._config = config
        self._recorder: Any = None
        self._ros: Any = None

    @property
    def where(self) -> str:
        """The file that is open."""
        return str(self._recorder.path if self._recorder is not None else self._config.path)

    def take(self, message: LiveMessage) -> None:
        """See `LiveOutput`."""
        match message:
            case LiveStart():
                self._open(message)
            case LiveDetections(detections=view):
                self._recorder.publish(topics.DETECTIONS, message_from_detections(view, message.stages_ns), view.t_ns)
            case LivePose():
                publish_pose(self._recorder, message.pose, message.joints, message.stages_ns)
            case LiveJointCentres():
                self._recorder.publish(topics.JOINT_CENTRES, message_from_live_centres(message), message.t_ns)
            case LiveHealth():
                self._ros.diagnose(message.t_ns, health_lines(message))

    def close(self) -> None:
        """Finish the file."""
        if self._recorder is not None:
            self._recorder.close()

    def _open(self, start: LiveStart) -> None:
        from posefuse.messages.bags import Recorder

        path = part_path(self._config.path, start.part)
        if start.part > 1:
            _check_room(path)
        self._recorder = Recorder(path)
        if start.notes:
            self._recorder.note(NOTES, {**start.notes, "part": str(start.part)})
        self._ros = RosOutput(self._recorder, start.rig)
        self._ros.start(start.t_ns)


def _check_room(path: Path) -> None:
    with contextlib.suppress(FileNotFoundError):
        free = shutil.disk_usage(path.parent).free
        if free < _LEAST_FREE_BYTES:
            raise InputError(
                f"{path}: the disk is full: {free / 2**20:.1f} MB free, expected {_LEAST_FREE_BYTES / 2**20:g} MB to go on"
            )
