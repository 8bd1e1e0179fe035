"""The operator's loop: newest pose, heartbeats and robot state -> orders, about 100 times a second."""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Protocol

from posefuse.core import CameraHealth, LivePose, PosefuseError, SourceError
from posefuse.core.live_messages import OK
from posefuse.foundation.worker import Worker

from .hands import operator_view
from .operator import Operator, OperatorNews, step_operator
from .robots.plan import RobotPlan
from .robots.process import Failed, Leave, run_robot
from .settings import TeleoperationSettings
from .switches import DeadMan, Pressed
from .values import CameraReport, OperatorView, Order, Phase, RobotState

_READY_S, _LEAVE_S = 60.0, 3.0
_NEWEST = 100_000


class Feed(Protocol):
    """Where poses come from."""

    def wait(self, timeout_s: float) -> None:
        """Until there is a new pose, at most so long."""
        ...

    def newest(self) -> tuple[LivePose, int, int] | None:
        """Newest pose, and on the monotonic clock: what time it is for, and mid-exposure of the newest image in it."""
        ...

    def cameras(self) -> CameraReport | None:
        """Newest report of the cameras."""
        ...

    @property
    def ended(self) -> bool:
        """Whether no more poses will come."""
        ...


@dataclass(eq=False, kw_only=True)
class Summary:
    """What a session did.

    Attributes:
        seconds: it lasted. ticks: steps by phase. reasons: steps by what limited or held the robot.
        latency_ms: mid-exposure of the newest image to the command that used it, newest ones. engagements: how often.
        robot_late: control steps of the robot's side that were late. fault: why it ended early; empty when it did not.
    """

    seconds: float = 0.0
    ticks: Counter[str] = field(default_factory=Counter)
    reasons: Counter[str] = field(default_factory=Counter)
    latency_ms: deque[float] = field(default_factory=lambda: deque(maxlen=_NEWEST))
    engagements: int = 0
    robot_late: int = 0
    fault: str = ""


class RobotLink:
    """The robot's process, as the operator's side sees it. pid: of the process. state: the newest; None before the first."""

    def __init__(self, plan: RobotPlan) -> None:
        self.state: RobotState | None = None
        self._worker = Worker(run_robot)
        self._worker.start(plan)
        self.pid = self._worker.pid

    def wait_ready(self) -> None:
        """Until the first state; raises PosefuseError where the robot cannot be driven."""
        end_s = time.monotonic() + _READY_S
        while self.state is None:
            if not self._worker.wait(0.2) and time.monotonic() > end_s:
                raise SourceError(f"robot: no state within {_READY_S:g} s")
            self.poll()

    def poll(self) -> RobotState | None:
        """The newest state that came since the last call; raises PosefuseError when the process is gone or gives up."""
        newest = None
        while (message := self._worker.receive()) is not None:
            if isinstance(message, Failed):
                raise message.error
            newest = message
        self._check()
        self.state = newest or self.state
        return newest

    def send(self, order: Order) -> None:
        """Hand an order on; never waits."""
        self._worker.send(order)
        self._check()

    def close(self) -> None:
        """Let the robot brake and its process leave."""
        self._worker.send(Leave())
        self._worker.end(_LEAVE_S)

    def _check(self) -> None:
        if not self._worker.running:
            raise SourceError("robot: its process has ended")


def run_control_loop(
    feed: Feed,
    deadman: DeadMan,
    robot: RobotLink,
    settings: TeleoperationSettings,
    *,
    until: Callable[[], bool],
    watch: Callable[[Operator, Order | None], None] | None = None,
) -> Summary:
    """Teleoperate until `until` is true, the poses end or the robot's process has ended. watch: called with every step."""
    period_s = 1.0 / settings.robot.rate_hz
    operator, summary, begun_s = Operator(), Summary(), time.monotonic()
    used_ns: int | None = None
    image_ns = 0
    try:
        while not until() and not feed.ended:
            feed.wait(period_s)
            now_ns = time.monotonic_ns()
            view = _view(feed, operator, settings)
            pressed = deadman.poll(now_ns, view)
            news = _news(view if view is not None and view.t_ns != used_ns else None, pressed, feed, robot)
            operator, order = step_operator(operator, news, now_ns, settings)
            used_ns = operator.view.t_ns if operator.view is not None else None
            if order is not None:
                robot.send(order)
            image_ns = _count(summary, operator, robot, image_ns)
            if watch is not None:
                watch(operator, order)
    except PosefuseError as error:
        summary.fault = str(error)
    summary.seconds = time.monotonic() - begun_s
    return summary


def _view(feed: Feed, operator: Operator, settings: TeleoperationSettings) -> OperatorView | None:
    found = feed.newest()
    if found is None:
        return None
    live, t_ns, measured_ns = found
    view = operator_view(live.pose, settings.hands, operator.gate.person_id, measured_ns, live.joints)
    return replace(view, t_ns=t_ns)


def _news(view: OperatorView | None, pressed: Pressed, feed: Feed, robot: RobotLink) -> OperatorNews:
    return OperatorNews(
        view=view,
        beats=pressed.beats,
        cameras=feed.cameras(),
        robot=robot.poll(),
        emergency=pressed.emergency,
        reset=pressed.reset,
    )


def _count(summary: Summary, operator: Operator, robot: RobotLink, image_ns: int) -> int:
    """Add a step. image_ns: mid-exposure of the newest image that the robot has received so far; returns the new value."""
    gate = operator.gate
    summary.ticks[gate.phase.value] += 1
    summary.engagements += gate.engages
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


def camera_report(cameras: dict[str, CameraHealth], t_ns: int) -> CameraReport:
    """How many of the session's cameras are well."""
    return CameraReport(t_ns=t_ns, healthy=sum(camera.state == OK for camera in cameras.values()), total=len(cameras))
