"""Operator, robot, workspace and keep-out in the Rerun viewer, or in a file for it."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Any

import numpy as np

from posefuse.core.arrays import Array
from posefuse.outputs.rerun import TIMELINE, opened_stream

from .separation import limbs_of
from .session import Operator
from .settings import LIMB_RADIUS_M, TeleoperationSettings
from .values import Order, Phase

if TYPE_CHECKING:
    import rerun as rr

_EVERY_NS = 50_000_000
_TRAIL = 60
# a workspace larger than a room is not worth drawing
_MOST_BOX_M = 8.0
_ROBOT_RGB = {
    Phase.IDLE: (150, 150, 150),
    Phase.READY: (90, 150, 230),
    Phase.ENGAGED: (80, 190, 110),
    Phase.HOLD: (240, 180, 60),
    Phase.STOPPED: (225, 70, 60),
}
_OPERATOR_RGB, _HAND_RGB, _TARGET_RGB, _BOX_RGB = (70, 120, 205), (240, 190, 40), (60, 220, 80), (130, 130, 130)
_STOP_RGB = (225, 70, 60)
_HAND_M, _TARGET_M, _TRAIL_M, _WIRE_M = 0.04, 0.025, 0.006, 0.002


class SceneView:
    """Shows the operator's side after a step, at a pace an eye can follow; one of the `watches` of `session.run_control_loop`.

    Args:
        settings: whose box and distances are drawn. place: ``spawn`` opens the viewer, anything else is the .rrd file to write.

    Raises:
        DependencyError: the Rerun SDK is not installed, or there is no display for a viewer.
    """

    def __init__(self, settings: TeleoperationSettings, place: str) -> None:
        self._settings = settings
        self._stream = opened_stream("posefuse teleoperate", place, _blueprint)
        self._shown_ns: int | None = None
        self._first_ns = 0
        self._trail: deque[Array] = deque(maxlen=_TRAIL)
        self._shown = ""
        self._log_box()

    def __call__(self, operator: Operator, order: Order | None) -> None:
        """Show one step, unless one was shown just now."""
        now_ns = operator.gate.now_ns
        if now_ns is None or (self._shown_ns is not None and 0 <= now_ns - self._shown_ns < _EVERY_NS):
            return
        self._first_ns = now_ns if self._shown_ns is None else self._first_ns
        self._shown_ns = now_ns
        self._stream.set_time(TIMELINE, duration=(now_ns - self._first_ns) / 1e9)
        self._log_operator(operator, now_ns)
        self._log_robot(operator, order)
        self._log_state(operator)

    def close(self) -> None:
        """Finish the stream; safe to call twice."""
        self._stream.disconnect()

    def _log_box(self) -> None:
        import rerun as rr

        low, high = np.array(self._settings.limits.box_low_m), np.array(self._settings.limits.box_high_m)
        self._stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        if (high - low).max() <= _MOST_BOX_M:
            box = rr.Boxes3D(mins=[low], sizes=[high - low], colors=_BOX_RGB, labels=["workspace"], show_labels=False)
            self._stream.log("world/workspace", box, static=True)

    def _log_operator(self, operator: Operator, now_ns: int) -> None:
        import rerun as rr

        limbs = limbs_of(operator.body, now_ns, self._settings.separation)
        if limbs is not None:
            bare = np.full(len(limbs.radius), LIMB_RADIUS_M)
            self._stream.log("world/operator/limbs", _capsules(limbs.start, limbs.end, bare, _OPERATOR_RGB))
            # what the robot's surface must not enter
            around = limbs.radius + self._settings.separation.stop_m
            if self._settings.robot.shared:
                self._stream.log("world/operator/keep_out", _capsules(limbs.start, limbs.end, around, _STOP_RGB, wire=True))
        if operator.view is not None:
            hands = operator.view.xyz_world[np.isfinite(operator.view.xyz_world).all(axis=1)]
            self._stream.log("world/operator/hands", rr.Points3D(hands, radii=_HAND_M, colors=_HAND_RGB))

    def _log_robot(self, operator: Operator, order: Order | None) -> None:
        import rerun as rr

        robot = operator.robot
        if robot is None:
            return
        spheres = robot.spheres_world
        rgb = _ROBOT_RGB[operator.gate.phase]
        self._stream.log("world/robot/body", rr.Points3D(spheres[:, :3], radii=spheres[:, 3], colors=rgb))
        self._trail.append(robot.measured_xyz_world)
        paths = np.stack(self._trail, axis=1)
        self._stream.log("world/robot/path", rr.LineStrips3D(list(paths), radii=_TRAIL_M, colors=_TARGET_RGB))
        moves = order is not None and order.phase is Phase.ENGAGED
        target = order.xyz_world if order is not None and moves else np.zeros((0, 3))
        self._stream.log("world/robot/target", rr.Points3D(target, radii=_TARGET_M, colors=_TARGET_RGB))

    def _log_state(self, operator: Operator) -> None:
        import rerun as rr

        self._stream.log("separation_m", rr.Scalars(operator.separation_m))
        text = f"{operator.gate.phase.value.upper()} {operator.gate.reason}"
        if text != self._shown:
            self._shown = text
            self._stream.log("state", rr.TextDocument(text))
            self._stream.log("news", rr.TextLog(text))


def _capsules(start: Array, end: Array, radius: Array, rgb: tuple[int, int, int], *, wire: bool = False) -> rr.Capsules3D:
    import rerun as rr

    along = end - start
    length = np.linalg.norm(along, axis=1)
    mode = rr.components.FillMode.MajorWireframe if wire else rr.components.FillMode.Solid
    return rr.Capsules3D(
        lengths=length,
        radii=radius,
        translations=start,
        quaternions=_xyzw_from_z(along / np.maximum(length, 1e-9)[:, None]),
        colors=rgb,
        line_radii=_WIRE_M,
        fill_mode=mode,
    )


def _xyzw_from_z(direction: Array) -> Array:
    """(B, 4) unit quaternions that turn the z axis to unit vectors (B, 3)."""
    x, y, z = np.moveaxis(direction, -1, 0)
    xyzw = np.stack([-y, x, np.zeros_like(x), 1 + z], axis=-1)
    # straight down: half a turn about x
    xyzw[z < -1 + 1e-9] = [1.0, 0.0, 0.0, 0.0]
    return np.asarray(xyzw / np.linalg.norm(xyzw, axis=-1, keepdims=True))


def _blueprint() -> Any:
    import rerun.blueprint as rrb

    below = rrb.Horizontal(
        rrb.TextDocumentView(origin="state", name="state"),
        rrb.TimeSeriesView(origin="separation_m", name="distance of operator and robot, m"),
        rrb.TextLogView(origin="news", name="news"),
        column_shares=[1, 2, 1],
    )
    return rrb.Blueprint(
        rrb.Vertical(rrb.Spatial3DView(origin="world", name="operator and robot"), below, row_shares=[4, 1]), collapse_panels=True
    )
