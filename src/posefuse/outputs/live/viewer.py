"""Live output ``rerun``: camera images with their detections, the skeleton in 3D, and the state of every camera."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from posefuse.core import (
    CameraHealth,
    LiveDetections,
    LiveHealth,
    LiveMessage,
    LiveNames,
    LiveOutput,
    LivePose,
    LivePreview,
    LiveStart,
    Pose3D,
)
from posefuse.core.recording import person_name
from posefuse.foundation.output_file import part_path
from posefuse.foundation.settings import settings
from posefuse.outputs.rerun import (
    SPAWN,
    TIMELINE,
    camera_path,
    check_rerun,
    check_room,
    check_viewer,
    log_cameras,
    log_detections,
    log_name,
    log_person,
    log_projection,
    opened_stream,
    pinhole,
    session_blueprint,
)

_POSE_EVERY_NS = 30_000_000
_VIEW_EVERY_NS = 60_000_000
_DETECTION_RGB = (255, 220, 60)
_GOOD_RGB, _BAD_RGB = (90, 200, 120), (235, 70, 60)


@settings
class RerunLiveConfig:
    """The Rerun viewer (extra `viewer`), or a file it opens later.

    Attributes:
        file: .rrd file to write; None opens the viewer.
    """

    file: Path | None = None
    takes: ClassVar[tuple[type[LiveMessage], ...]] = (LivePose, LiveNames, LiveDetections, LivePreview, LiveHealth)
    keeps_all: ClassVar[bool] = False

    def build(self) -> LiveOutput:
        """Not yet opened; raises DependencyError without the Rerun SDK, or a display to open its viewer on."""
        check_viewer() if self.file is None else check_rerun()
        return RerunLiveOutput(self)


class RerunLiveOutput:
    """Logs at a pace an eye can follow; faulty cameras turn red."""

    name = "rerun"

    def __init__(self, config: RerunLiveConfig) -> None:
        self._config = config
        self.where = str(config.file or "viewer")
        self._stream: Any = None
        self._rig: Any = ()
        self._zero_ns = 0
        self._shown_ns: dict[str, int] = {}
        self._people: set[int] = set()
        self._names: dict[int, str] = {}

    def take(self, message: LiveMessage) -> None:
        """See `LiveOutput`."""
        match message:
            case LiveStart():
                self._open(message)
            case LivePose(pose=pose) if self._due("pose", pose.t_ns, _POSE_EVERY_NS):
                self._pose(pose)
            case LiveDetections(detections=view) if self._due(f"view {view.camera}", view.t_ns, _VIEW_EVERY_NS):
                log_detections(self._stream, view.camera, view.xy_img[view.score > 0], _DETECTION_RGB)
            case LivePreview():
                self._preview(message)
            case LiveNames(names=names):
                self._names |= names
            case LiveHealth():
                self._health(message.t_ns, message.cameras)

    def close(self) -> None:
        """Finish the stream."""
        if self._stream is not None:
            self._stream.disconnect()

    def _open(self, start: LiveStart) -> None:
        import rerun.blueprint as rrb

        if self._config.file is not None:
            self.where = str(part_path(self._config.file, start.part))
        place = SPAWN if self._config.file is None else self.where
        self._rig, self._zero_ns, self._names = start.rig, start.t_ns, dict(enumerate(start.names))
        states = rrb.TextDocumentView(origin="health", name="cameras")
        self._stream = opened_stream("posefuse live", place, lambda: session_blueprint(start.rig.names, [states]))
        log_cameras(self._stream, start.rig.cameras, _GOOD_RGB)

    def _due(self, what: str, t_ns: int, every_ns: int) -> bool:
        if t_ns - self._shown_ns.get(what, 0) < every_ns:
            return False
        if self._config.file is not None:
            check_room(self._config.file)
        self._shown_ns[what] = t_ns
        self._stream.set_time(TIMELINE, duration=(t_ns - self._zero_ns) / 1e9)
        return True

    def _pose(self, pose: Pose3D) -> None:
        import rerun as rr

        for person, xyz in zip(pose.person_id.tolist(), pose.xyz_world, strict=True):
            log_person(self._stream, f"world/people/{person}", pose.skeleton, xyz)
            log_name(self._stream, f"world/people/{person}", self._names.get(person) or person_name((), person), xyz)
        for gone in self._people - set(pose.person_id.tolist()):
            self._stream.log(f"world/people/{gone}", rr.Clear(recursive=True))
        self._people = set(pose.person_id.tolist())
        for camera in self._rig:
            log_projection(self._stream, camera, pose.skeleton, pose.xyz_world, _GOOD_RGB)

    def _preview(self, preview: LivePreview) -> None:
        import cv2
        import rerun as rr

        if not self._due(f"preview {preview.camera}", preview.t_ns, 1):
            return
        # one pixel grid for images, points and lines: the camera's own
        size = self._rig[preview.camera].size_wh
        small = cv2.imdecode(np.frombuffer(preview.jpeg, np.uint8), cv2.IMREAD_COLOR_RGB)
        shown = cv2.resize(np.asarray(small), size, interpolation=cv2.INTER_LINEAR)
        self._stream.log(f"{camera_path(preview.camera)}/image", rr.Image(shown).compress(jpeg_quality=70))

    def _health(self, t_ns: int, cameras: Mapping[str, CameraHealth]) -> None:
        import rerun as rr

        self._stream.set_time(TIMELINE, duration=(t_ns - self._zero_ns) / 1e9)
        for name, camera in cameras.items():
            self._stream.log(camera_path(name), pinhole(self._rig[name], _GOOD_RGB if camera.state == "ok" else _BAD_RGB))
        rows = [f"- {name}: {camera.state} {camera.text}" for name, camera in cameras.items()]
        self._stream.log("health", rr.TextDocument("\n".join(rows), media_type="text/markdown"))
