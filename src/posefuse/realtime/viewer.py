"""The session in Rerun, live: views with what was seen in them, the skeleton in the room, and how every camera fares."""

from __future__ import annotations

import colorsys
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from posefuse.core import Detections2D, Pose3D
from posefuse.outputs.rerun_scene import (
    TIMELINE,
    camera_path,
    log_cameras,
    log_detections,
    log_person,
    log_projection,
    opened_stream,
    pinhole,
    session_blueprint,
)

from .messages import Preview

if TYPE_CHECKING:
    from .outputs import OutputPlan

_POSE_EVERY_NS = 30_000_000
_VIEW_EVERY_NS = 60_000_000
_DETECTION_RGB = (255, 220, 60)
_GOOD_RGB, _BAD_RGB = (90, 200, 120), (235, 70, 60)
_PLOTS = {"latency_p95_ms": "latency_p95_ms", "residual_sigmas": "innovation_sigmas"}
# cameras in plots: the golden angle keeps neighbours apart, however many there are
_HUE_STEP, _SATURATION, _VALUE = 0.381966, 0.6, 0.95


class ViewSink:
    """Logs at a pace an eye can follow; cameras that are ill turn red."""

    name, keeps_all = "view", False

    def __init__(self, plan: OutputPlan) -> None:
        self._rig, self._zero_ns = plan.rig, plan.clock.now_ns()
        self._stream = opened_stream("posefuse live", plan.view, session_blueprint(plan.rig.names, _below()))
        self._shown_ns: dict[str, int] = {}
        self._captured: dict[str, tuple[int, float]] = {}
        self._people: set[int] = set()
        log_cameras(self._stream, plan.rig.cameras, _GOOD_RGB)
        self._name_plots()

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

    def _name_plots(self) -> None:
        import rerun as rr

        for number, camera in enumerate(self._rig):
            line = rr.SeriesLines(colors=plot_rgb(number), names=camera.name)
            for plot in _PLOTS:
                self._stream.log(f"plots/{plot}/{camera.name}", line, static=True)

    def _pose(self, pose: Pose3D) -> None:
        import rerun as rr

        for person, xyz in zip(pose.person_id.tolist(), pose.xyz_world, strict=True):
            log_person(self._stream, f"world/people/{person}", pose.skeleton, xyz)
        for gone in self._people - set(pose.person_id.tolist()):
            self._stream.log(f"world/people/{gone}", rr.Clear(recursive=True))
        self._people = set(pose.person_id.tolist())
        for camera in self._rig:
            log_projection(self._stream, camera, pose.skeleton, pose.xyz_world, _GOOD_RGB)

    def _view(self, view: Detections2D) -> None:
        log_detections(self._stream, view.camera, view.xy_img[view.score > 0], _DETECTION_RGB)

    def _preview(self, preview: Preview) -> None:
        import cv2
        import rerun as rr

        if not self._due(f"preview {preview.camera}", preview.t_ns, 1):
            return
        # one pixel grid for pictures, points and lines: the camera's own
        size = self._rig[preview.camera].size_wh
        small = cv2.imdecode(np.frombuffer(preview.jpeg, np.uint8), cv2.IMREAD_COLOR_RGB)
        shown = cv2.resize(np.asarray(small), size, interpolation=cv2.INTER_LINEAR)
        self._stream.log(f"{camera_path(preview.camera)}/image", rr.Image(shown).compress(jpeg_quality=70))

    def _health(self, t_ns: int, states: dict[str, tuple[str, str]], rates: dict[str, dict[str, float]]) -> None:
        import rerun as rr

        self._stream.set_time(TIMELINE, duration=(t_ns - self._zero_ns) / 1e9)
        for name, (state, _) in states.items():
            self._stream.log(camera_path(name), pinhole(self._rig[name], _GOOD_RGB if state == "ok" else _BAD_RGB))
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


def _below() -> list[Any]:
    """Plots and texts under the views."""
    import rerun.blueprint as rrb

    return [
        rrb.TimeSeriesView(origin="plots/latency_p95_ms", name="latency p95, ms"),
        rrb.TimeSeriesView(origin="plots/residual_sigmas", name="residual, sigmas"),
        rrb.TextDocumentView(origin="health", name="cameras"),
    ]
