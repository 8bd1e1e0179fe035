"""Live output ``rerun``: camera images with their detections, the skeleton in 3D, and the state of every camera."""

from __future__ import annotations

import colorsys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from posefuse.core import (
    Camera,
    CameraHealth,
    Detections2D,
    LiveDetections,
    LiveHealth,
    LiveMessage,
    LiveOutput,
    LivePose,
    LivePreview,
    LiveStart,
    Pose3D,
)
from posefuse.core.arrays import Array
from posefuse.foundation.settings import settings

from .parts import part_path

TIMELINE = "session"
_POSE_EVERY_NS = 30_000_000
_VIEW_EVERY_NS = 60_000_000
_IMAGE_PLANE_M = 0.5
_DETECTION_RGB = (255, 220, 60)
_GOOD_RGB, _BAD_RGB = (90, 200, 120), (235, 70, 60)
_PLOTS = {"latency_p95_ms": "latency_p95_ms", "residual_sigmas": "innovation_sigmas"}
# cameras in plots: the golden angle keeps neighbours apart, however many there are
_HUE_STEP, _SATURATION, _VALUE = 0.381966, 0.6, 0.95


@settings
class RerunLiveConfig:
    """The Rerun viewer (extra `viewer`), or a file it opens later.

    Attributes:
        file: .rrd file to write; None opens the viewer.
    """

    file: Path | None = None
    takes: ClassVar[tuple[type[LiveMessage], ...]] = (LivePose, LiveDetections, LivePreview, LiveHealth)
    keeps_all: ClassVar[bool] = False

    def build(self) -> LiveOutput:
        """Not yet opened; raises DependencyError without the Rerun SDK."""
        from posefuse.outputs.rerun import check_rerun

        check_rerun()
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
        self._captured: dict[str, tuple[int, float]] = {}
        self._people: set[int] = set()

    def take(self, message: LiveMessage) -> None:
        """See `LiveOutput`."""
        match message:
            case LiveStart():
                self._open(message)
            case LivePose(pose=pose) if self._due("pose", pose.t_ns, _POSE_EVERY_NS):
                self._pose(pose)
            case LiveDetections(detections=view) if self._due(f"view {view.camera}", view.t_ns, _VIEW_EVERY_NS):
                self._view(view)
            case LivePreview():
                self._preview(message)
            case LiveHealth():
                self._health(message.t_ns, message.cameras)

    def close(self) -> None:
        """Finish the stream."""
        if self._stream is not None:
            self._stream.disconnect()

    def _open(self, start: LiveStart) -> None:
        from posefuse.outputs.rerun import SPAWN, opened_stream

        if self._config.file is not None:
            self.where = str(part_path(self._config.file, start.part))
        place = SPAWN if self._config.file is None else self.where
        self._rig, self._zero_ns = start.rig, start.t_ns
        self._stream = opened_stream("posefuse live", place, _blueprint(start.rig.cameras))
        self._log_cameras()

    def _due(self, what: str, t_ns: int, every_ns: int) -> bool:
        if t_ns - self._shown_ns.get(what, 0) < every_ns:
            return False
        self._shown_ns[what] = t_ns
        self._stream.set_time(TIMELINE, duration=(t_ns - self._zero_ns) / 1e9)
        return True

    def _log_cameras(self) -> None:
        import rerun as rr

        self._stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        for camera in self._rig:
            pose, path = camera.cam_from_world.inverse(), _path(camera.name)
            self._stream.log(path, rr.Transform3D(translation=pose.xyz, mat3x3=pose.matrix()), static=True)
            self._stream.log(path, _pinhole(camera, _GOOD_RGB), static=True)
        for number, camera in enumerate(self._rig):
            line = rr.SeriesLines(colors=plot_rgb(number), names=camera.name)
            for plot in _PLOTS:
                self._stream.log(f"plots/{plot}/{camera.name}", line, static=True)

    def _pose(self, pose: Pose3D) -> None:
        import rerun as rr

        from posefuse.outputs.drawing import bone_colours, keypoint_colours

        bones = pose.skeleton.bone_indices
        bone_rgb, point_rgb = np.array(bone_colours(pose.skeleton)), np.array(keypoint_colours(pose.skeleton))
        for person, xyz in zip(pose.person_id.tolist(), pose.xyz_world, strict=True):
            here = np.isfinite(xyz).all(axis=-1)
            whole = here[bones].all(axis=1)
            path = f"world/people/{person}"
            self._stream.log(f"{path}/bones", rr.LineStrips3D(xyz[bones[whole]], colors=bone_rgb[whole], radii=0.012))
            self._stream.log(f"{path}/keypoints", rr.Points3D(xyz[here], colors=point_rgb[here], radii=0.02))
        for gone in self._people - set(pose.person_id.tolist()):
            self._stream.log(f"world/people/{gone}", rr.Clear(recursive=True))
        self._people = set(pose.person_id.tolist())
        for camera in self._rig:
            strips: Any = camera.project(pose.xyz_world)[:, bones] + 0.5
            strips = strips[np.isfinite(strips).all(axis=(-1, -2))]
            self._stream.log(f"{_path(camera.name)}/skeleton", rr.LineStrips2D(strips, colors=_GOOD_RGB, radii=-1.5))

    def _view(self, view: Detections2D) -> None:
        import rerun as rr

        points: Array = view.xy_img[view.score > 0] + 0.5
        self._stream.log(f"{_path(view.camera)}/detections", rr.Points2D(points, colors=_DETECTION_RGB, radii=-1.5))

    def _preview(self, preview: LivePreview) -> None:
        import cv2
        import rerun as rr

        if not self._due(f"preview {preview.camera}", preview.t_ns, 1):
            return
        # one pixel grid for images, points and lines: the camera's own
        size = self._rig[preview.camera].size_wh
        small = cv2.imdecode(np.frombuffer(preview.jpeg, np.uint8), cv2.IMREAD_COLOR_RGB)
        shown = cv2.resize(np.asarray(small), size, interpolation=cv2.INTER_LINEAR)
        self._stream.log(f"{_path(preview.camera)}/image", rr.Image(shown).compress(jpeg_quality=70))

    def _health(self, t_ns: int, cameras: Mapping[str, CameraHealth]) -> None:
        import rerun as rr

        self._stream.set_time(TIMELINE, duration=(t_ns - self._zero_ns) / 1e9)
        for name, camera in cameras.items():
            self._stream.log(_path(name), _pinhole(self._rig[name], _GOOD_RGB if camera.state == "ok" else _BAD_RGB))
            for plot, key in _PLOTS.items():
                self._stream.log(f"plots/{plot}/{name}", rr.Scalars(camera.figures[key]))
        came_hz = {name: self._rate_hz(name, t_ns, camera.figures["captured"]) for name, camera in cameras.items()}
        self._stream.log("health", rr.TextDocument(health_table(cameras, came_hz), media_type="text/markdown"))

    def _rate_hz(self, name: str, t_ns: int, captured: float) -> float:
        """Frames that came per second since the last message."""
        before_ns, before = self._captured.get(name, (t_ns, captured))
        self._captured[name] = t_ns, captured
        return (captured - before) * 1e9 / (t_ns - before_ns) if t_ns > before_ns else 0.0


def health_table(cameras: Mapping[str, CameraHealth], came_hz: Mapping[str, float]) -> str:
    """Markdown, one row per camera; a faulty one in bold."""
    rows = ["| camera | state | frames/s | age ms | dropped | p95 ms | residual |", "|---" * 7 + "|"]
    for name, camera in cameras.items():
        figures, words = camera.figures, camera.state if camera.state == "ok" else f"**{camera.state}** {camera.text}"
        rows.append(
            f"| {name} | {words} | {came_hz[name]:.0f} | {figures['age_ms']:.0f} | {figures['replaced']:.0f} "
            f"| {figures['latency_p95_ms']:.0f} | {figures['innovation_sigmas']:.2f} |"
        )
    return "\n".join(rows)


def plot_rgb(number: int) -> tuple[int, int, int]:
    """Colour of camera `number` in plots."""
    r, g, b = colorsys.hsv_to_rgb(number * _HUE_STEP % 1.0, _SATURATION, _VALUE)
    return round(255 * r), round(255 * g), round(255 * b)


def _pinhole(camera: Camera, rgb: tuple[int, int, int]) -> Any:
    import rerun as rr

    return rr.Pinhole(
        image_from_camera=camera.K, resolution=camera.size_wh, camera_xyz=rr.ViewCoordinates.RDF,
        image_plane_distance=_IMAGE_PLANE_M, color=rgb,
    )  # fmt: skip


def _path(camera: str) -> str:
    import rerun as rr

    return f"world/cameras/{rr.escape_entity_path_part(camera)}"


def _blueprint(cameras: Sequence[Camera]) -> Any:
    import rerun.blueprint as rrb

    views = [rrb.Spatial2DView(origin=_path(camera.name), contents=["$origin/**"], name=camera.name) for camera in cameras]
    plots = [
        rrb.TimeSeriesView(origin="plots/latency_p95_ms", name="latency p95, ms"),
        rrb.TimeSeriesView(origin="plots/residual_sigmas", name="residual, sigmas"),
        rrb.TextDocumentView(origin="health", name="cameras"),
    ]
    above = rrb.Horizontal(rrb.Spatial3DView(origin="world", name="3D"), rrb.Grid(*views), column_shares=[3, 4])
    return rrb.Blueprint(rrb.Vertical(above, rrb.Horizontal(*plots), row_shares=[3, 1]), collapse_panels=True)
