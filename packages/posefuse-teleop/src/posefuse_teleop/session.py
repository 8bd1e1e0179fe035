"""The operator's side: views, heartbeats and the robot's state in, orders out. One pure step, and its loop."""

from __future__ import annotations

import math
import time
from collections import Counter, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from posefuse.core import PosefuseError
from posefuse.core.live_messages import OK

from .gate import Gate, Pressed, Seen, speed_mps, step_gate
from .hands import operator_view
from .mapping import Clutch, Steady, engaged, moved, steadied
from .separation import OperatorBody, remembered, separation_m, speed_share
from .settings import TeleoperationSettings
from .values import CameraReport, OperatorView, Order, Phase, RobotState

if TYPE_CHECKING:
    from posefuse.api.live import LiveSession, Newest

    from .process import RobotLink
    from .switches import DeadMan

_NEWEST = 100_000


@dataclass(frozen=True, eq=False, kw_only=True)
class Operator(Seen):
    """State of the operator's side: what the gate goes by, and the states of the parts.

    Attributes:
        gate, clutch, body, steady: states of the parts; the clutch is None before the first engagement, steady before the
            first view.
        separation_m: least distance of robot and operator; NaN: not known.
    """

    gate: Gate = field(default_factory=Gate)
    body: OperatorBody = field(default_factory=OperatorBody.unknown)
    clutch: Clutch | None = None
    steady: Steady | None = None
    separation_m: float = math.nan
    seq: int = 0


@dataclass(frozen=True, eq=False, kw_only=True)
class OperatorNews:
    """What came since the last step: newest of each, None where there is nothing new; heartbeats in the order they came."""

    view: OperatorView | None = None
    pressed: Pressed = field(default_factory=Pressed)
    cameras: CameraReport | None = None
    robot: RobotState | None = None


def step_operator(
    operator: Operator, news: OperatorNews, now_ns: int, settings: TeleoperationSettings
) -> tuple[Operator, Order | None]:
    """Take in what is new and decide: the new state, and the order for the robot; None before its first state is known."""
    heartbeats, body, steady, apart_m = operator.heartbeats, operator.body, operator.steady, math.nan
    for beat in news.pressed.heartbeats:
        heartbeats = heartbeats.with_beat(beat, now_ns)
    if news.view is not None:
        # the gate goes by the hand as it was measured, the target by the steady one
        body, steady = remembered(body, news.view), steadied(steady, news.view)
    robot = news.robot or operator.robot
    if settings.robot.shared and robot is not None:
        apart_m = separation_m(body, robot.spheres_world, now_ns, settings.separation)
    operator = replace(
        operator,
        now_ns=now_ns,
        view=news.view or operator.view,
        heartbeats=heartbeats,
        pressed=news.pressed,
        cameras=news.cameras or operator.cameras,
        robot=robot,
        body=body,
        steady=steady,
        separation_m=apart_m,
        separation_share=speed_share(apart_m, settings.separation) if settings.robot.shared else 1.0,
        seq=operator.seq + 1,
    )
    operator = replace(operator, gate=step_gate(operator.gate, operator, settings.gate))
    operator = replace(operator, clutch=_clutch(operator, settings))
    return operator, _order(operator, settings, now_ns)


def _clutch(operator: Operator, settings: TeleoperationSettings) -> Clutch | None:
    clutch, gate, steady, robot = operator.clutch, operator.gate, operator.steady, operator.robot
    if gate.phase is not Phase.ENGAGED or steady is None or robot is None:
        return clutch
    if gate.engages or clutch is None:
        return engaged(steady.xyz_world, robot.xyz_world, robot.wxyz)
    return moved(clutch, steady.xyz_world, robot.xyz_world, settings.mapping, settings.limits)


def _order(operator: Operator, settings: TeleoperationSettings, now_ns: int) -> Order | None:
    robot, gate, clutch = operator.robot, operator.gate, operator.clutch
    if robot is None:
        return None
    hands = len(settings.hands)
    # what does not move needs no target
    order = Order(
        seq=operator.seq,
        sent_ns=now_ns,
        phase=gate.phase,
        xyz_world=np.zeros((hands, 3)),
        wxyz=np.tile([1.0, 0.0, 0.0, 0.0], (hands, 1)),
        speed_mps=0.0,
        grip=np.full(hands, operator.heartbeats.grip),
        measured_ns=operator.view.measured_ns if operator.view is not None else 0,
        reason=gate.reason,
    )
    if gate.phase is not Phase.ENGAGED or clutch is None:
        return order
    moves = replace(order, xyz_world=clutch.xyz, wxyz=clutch.wxyz, speed_mps=speed_mps(gate, settings.limits.speed_mps))
    return moves if moves.usable else replace(order, phase=Phase.HOLD)


@dataclass(eq=False, kw_only=True)
class Summary:
    """What a session did.

    Attributes:
        seconds: it lasted. ticks: steps by phase. reasons: steps by what limited or held the robot.
        latency_ms: mid-exposure of the newest image to the command that used it, newest ones. engagements: how often.
        robot_late: control steps of the robot's side that were late. fault: why it ended early, or what failed; empty: nothing.
        stopped_by: name of the signal that ended it; empty when none did. people: whether a person was ever seen.
    """

    seconds: float = 0.0
    ticks: Counter[str] = field(default_factory=Counter)
    reasons: Counter[str] = field(default_factory=Counter)
    latency_ms: deque[float] = field(default_factory=lambda: deque(maxlen=_NEWEST))
    engagements: int = 0
    robot_late: int = 0
    fault: str = ""
    stopped_by: str = ""
    people: bool = False

    @property
    def failed(self) -> bool:
        """Whether anything went wrong."""
        return bool(self.fault)


def run_control_loop(
    session: LiveSession,
    deadman: DeadMan,
    robot: RobotLink,
    settings: TeleoperationSettings,
    *,
    watch: Callable[[Operator, Order | None], None] | None = None,
    stopped: Sequence[str] = (),
) -> Summary:
    """Teleoperate until the session or the robot's process has ended, or a request to end is in `stopped`.

    watch: called with every step.
    """
    period_s = 1.0 / settings.robot.rate_hz
    operator, summary, begun_s = Operator(), Summary(), time.monotonic()
    used_ns: int | None = None
    image_ns, found = 0, None
    try:
        while not (session.ended or stopped):
            session.wait_newer(-1 if found is None else found.message.pose.t_ns, period_s)
            now_ns, found = time.monotonic_ns(), session.newest()
            view = None if found is None else _view(found, operator, settings)
            news = OperatorNews(
                view=view if view is not None and view.t_ns != used_ns else None,
                pressed=deadman.poll(now_ns, view),
                cameras=_camera_report(found) if found is not None and found.cameras else None,
                robot=robot.poll(),
            )
            operator, order = step_operator(operator, news, now_ns, settings)
            used_ns = operator.view.t_ns if operator.view is not None else None
            if order is not None:
                robot.send(order)
            image_ns = _count(summary, operator, robot, image_ns)
            if watch is not None:
                watch(operator, order)
        session.check()
    except PosefuseError as error:
        summary.fault = str(error)
    summary.seconds, summary.stopped_by = time.monotonic() - begun_s, next(iter(stopped), "")
    return summary


def _view(found: Newest, operator: Operator, settings: TeleoperationSettings) -> OperatorView:
    view = operator_view(found.message.pose, settings.hands, operator.gate.person_id, found.measured_ns)
    return replace(view, t_ns=found.t_ns)


def _count(summary: Summary, operator: Operator, robot: RobotLink, image_ns: int) -> int:
    """Add a step. image_ns: mid-exposure of the newest image that the robot has received so far; returns the new value."""
    gate = operator.gate
    summary.ticks[gate.phase.value] += 1
    summary.engagements += gate.engages
    summary.people |= operator.view is not None and operator.view.person_id >= 0
    if gate.reason and gate.phase in (Phase.ENGAGED, Phase.HOLD):
        summary.reasons[gate.reason] += 1
    state = robot.state
    if state is None:
        return image_ns
    summary.robot_late = state.late
    # the first command that used a new image; one that was new while the robot held is old when it continues
    if state.order_measured_ns > image_ns and not state.limited:
        summary.latency_ms.append((state.sent_ns - state.order_measured_ns) / 1e6)
    return max(image_ns, state.order_measured_ns)


def _camera_report(found: Newest) -> CameraReport:
    """How many of the session's cameras are well."""
    healthy = sum(camera.state == OK for camera in found.cameras.values())
    return CameraReport(t_ns=found.cameras_ns, healthy=healthy, total=len(found.cameras))
