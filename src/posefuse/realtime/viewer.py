"""The session in Rerun, live: views with what was seen in them, the skeleton in the room, and how every camera fares."""

from __future__ import annotations

import colorsys
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from posefuse.core import Camera, Detections2D, Pose3D
from posefuse.core.arrays import Array

from .messages import Preview

if TYPE_CHECKING:
    from .outputs import OutputPlan

TIMELINE = "session"
_POSE_EVERY_NS = 30_000_000
_VIEW_EVERY_NS = 60_000_000
_IMAGE_PLANE_M = 0.5
_DETECTION_RGB = (255, 220, 60)
_GOOD_RGB, _BAD_RGB = (90, 200, 120), (235, 70, 60)
_PLOTS = {"latency_p95_ms": "latency_p95_ms", "residual_sigmas": "innovation_sigmas"}
# cameras in plots: the golden angle keeps neighbours apart, however many there are
_HUE_STEP, _SATURATION, _VALUE = 0.381966, 0.6, 0.95


class ViewSink:
    """Logs at a pace an eye can follow; cameras that are ill turn red."""

    name, keeps_all = "view", False

    def __init__(self, plan: OutputPlan) -> None:
        from posefuse.outputs.rerun import check_rerun, opened_stream

        check_rerun()
        self._rig, self._zero_ns = plan.rig, plan.clock.now_ns()
        self._stream = opened_stream("posefuse live", plan.view, _blueprint(plan.rig.cameras))
        self._shown_ns: dict[str, int] = {}
        self._captured: dict[str, tuple[int, float]] = {}
        self._people: set[int] = set()
        self._log_cameras()

    def take(self, kind: str, values: Sequence[Any]) -> None:
        """See `LiveSink`."""
        if kind == "pose" and self._due("pose", values[0].t_ns, _POSE_EVERY_NS):
            self._pose(values[0])
        elif kind == "view" and self._due(f"view {values[0].camera}", values[0].t_ns, _VIEW_EVERY_NS):
            self._view(values[0])
        elif kind == "preview":
            self._preview(values[0])
        elif kind == "health":
            self._health(*values)

    def close(self) -> None:
        """Finish the stream."""
        self._stream.disconnect()

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

    def _preview(self, preview: Preview) -> None:
        import cv2
        import rerun as rr

        if not self._due(f"preview {preview.camera}", preview.t_ns, 1):
            return
        # one pixel grid for pictures, points and lines: the camera's own
        size = self._rig[preview.camera].size_wh
        small = cv2.imdecode(np.frombuffer(preview.jpeg, np.uint8), cv2.IMREAD_COLOR_RGB)
        shown = cv2.resize(np.asarray(small), size, interpolation=cv2.INTER_LINEAR)
        self._stream.log(f"{_path(preview.camera)}/image", rr.Image(shown).compress(jpeg_quality=70))

    def _health(self, t_ns: int, states: dict[str, tuple[str, str]], rates: dict[str, dict[str, float]]) -> None:
        import rerun as rr

        self._stream.set_time(TIMELINE, duration=(t_ns - self._zero_ns) / 1e9)
        for name, (state, _) in states.items():
            self._stream.log(_path(name), _pinhole(self._rig[name], _GOOD_RGB if state == "ok" else _BAD_RGB))
            for plot, key in _PLOTS.items():
                self._stream.log(f"plots/{plot}/{name}", rr.Scalars(rates[name][key]))
        came_hz = {name: self._rate_hz(name, t_ns, rates[name]["captured"]) for name in states}
        self._stream.log("health", rr.TextDocument(health_table(states, rates, came_hz), media_type="text/markdown"))

    def _rate_hz(self, name: str, t_ns: int, captured: float) -> float:
        """Frames that came per second since the last word."""
        before_ns, before = self._captured.get(name, (t_ns, captured))
        self._captured[name] = t_ns, captured
        return (captured - before) * 1e9 / (t_ns - before_ns) if t_ns > before_ns else 0.0


def health_table(
    states: Mapping[str, tuple[str, str]], rates: Mapping[str, Mapping[str, float]], came_hz: Mapping[str, float]
) -> str:
    """Markdown, one row per camera; an ill one in bold."""
    rows = ["| camera | state | frames/s | age ms | given up | p95 ms | residual |", "|---" * 7 + "|"]
    for name, (state, text) in states.items():
        rate, words = rates[name], state if state == "ok" else f"**{state}** {text}"
        rows.append(
            f"| {name} | {words} | {came_hz[name]:.0f} | {rate['age_ms']:.0f} | {rate['replaced']:.0f} "
            f"| {rate['latency_p95_ms']:.0f} | {rate['innovation_sigmas']:.2f} |"
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
