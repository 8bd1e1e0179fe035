"""The operator's side: views, heartbeats and the robot's state in, orders out. One pure step, its loop, `posefuse.teleoperate`.

For the limits of all this see docs/teleoperation.md.
"""

from __future__ import annotations

import math
import time
from collections import Counter, deque
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from posefuse.api.arguments import shown
from posefuse.api.live import LiveSession, Newest
from posefuse.core import ConfigError, PosefuseError, Progress
from posefuse.core.live_messages import OK
from posefuse.foundation.output_file import check_output_file

from .gate import Gate, Pressed, Seen, speed_mps, step_gate
from .hands import operator_view
from .mapping import Clutch, Steady, engaged, moved, steadied
from .process import RobotLink, RobotPlan
from .separation import OperatorBody, remembered, separation_m, speed_share
from .settings import RosPlan, TeleoperationSettings
from .switches import DeadMan, open_deadman
from .values import CameraReport, OperatorView, Order, Phase, RobotState

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
    clutch, gate, view, steady, robot = operator.clutch, operator.gate, operator.view, operator.steady, operator.robot
    if gate.phase is not Phase.ENGAGED or view is None or steady is None or robot is None:
        return clutch
    if gate.engages or clutch is None:
        return engaged(steady.xyz_world, view.rotation_world, robot.xyz_world, robot.wxyz)
    return moved(
        clutch,
        steady.xyz_world,
        view.rotation_world,
        robot.xyz_world,
        robot.wxyz,
        mapping=settings.mapping,
        limits=settings.limits,
    )


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
        robot_late: control steps of the robot's side that were late. fault: why it ended early; empty when it did not.
        stopped_by: name of the signal that ended it; empty when none did.
    """

    seconds: float = 0.0
    ticks: Counter[str] = field(default_factory=Counter)
    reasons: Counter[str] = field(default_factory=Counter)
    latency_ms: deque[float] = field(default_factory=lambda: deque(maxlen=_NEWEST))
    engagements: int = 0
    robot_late: int = 0
    fault: str = ""
    stopped_by: str = ""


def run_control_loop(
    session: LiveSession,
    deadman: DeadMan,
    robot: RobotLink,
    settings: TeleoperationSettings,
    *,
    watches: Sequence[Callable[[Operator, Order | None], None]] = (),
    stopped: Sequence[str] = (),
) -> Summary:
    """Teleoperate until the session or the robot's process has ended, or a request to end is in `stopped`.

    watches: called with every step.
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
            for watch in watches:
                watch(operator, order)
    except PosefuseError as error:
        summary.fault = str(error)
    summary.seconds, summary.stopped_by = time.monotonic() - begun_s, next(iter(stopped), "")
    return summary


def _view(found: Newest, operator: Operator, settings: TeleoperationSettings) -> OperatorView:
    live = found.message
    view = operator_view(live.pose, settings.hands, operator.gate.person_id, found.measured_ns, live.joints)
    return replace(view, t_ns=found.t_ns)


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


def _camera_report(found: Newest) -> CameraReport:
    """How many of the session's cameras are well."""
    healthy = sum(camera.state == OK for camera in found.cameras.values())
    return CameraReport(t_ns=found.cameras_ns, healthy=healthy, total=len(found.cameras))


def teleoperate(
    session: LiveSession,
    *,
    deadman: str | DeadMan = "web",
    settings: TeleoperationSettings | None = None,
    robot: str | Path = "sim",
    frames: Sequence[str] | None = None,
    command: str | None = None,
    ros: RosPlan | None = None,
    emergency_stop: bool = False,
    view: bool = False,
    show: str | Path | None = None,
    scene: str | None = None,
    record: str | Path | None = None,
    watch: Callable[[Operator, Order | None], None] | None = None,
    progress: Progress | bool | None = None,
) -> Summary:
    """Let a robot follow the operator's hand until the session ends, or Ctrl-C; no certified safety function.

    Args:
        session: from `posefuse.live`, not yet begun.
        deadman: ``key``, ``joystick:DEVICE``, ``ros:/TOPIC``, ``web``, ``web:PORT``, ``gesture``, or a switch of your own.
        settings: hands, mapping, gate, limits, separation, robot.
        robot: ``sim``, our own in MuJoCo, or an MJCF file. frames: its sites, one per hand; default ``right_hand`` ...
        command: None drives the robot in MuJoCo; ``pose``, ``twist`` or ``joints`` drives one over `ros`. A dead-man's switch
            ``ros:/TOPIC`` is there, too; without `ros` where the session has ROS.
        emergency_stop: there is one within reach; needed for a gesture that moves a robot over ROS.
        view: open MuJoCo's viewer. show: operator, robot, workspace and keep-out in Rerun: ``spawn`` opens its viewer, anything
            else is the .rrd file to write (extra ``viewer``).
        scene: MJCF text instead of a file. record: .mcap of commands and states of the robot.
        watch: is shown the operator's side and the order after every step.

    Raises:
        PosefuseError: what keeps it from beginning.

    Examples:
        >>> import posefuse as pf
        >>> session = pf.live("rig.toml", {"cam1": "usb:0", "cam2": "usb:1"})  # doctest: +SKIP
        >>> pf.teleoperate(session, deadman="web", robot="sim").engagements  # doctest: +SKIP
    """
    from posefuse.realtime.session import stop_requests

    settings = settings or TeleoperationSettings()
    sites = tuple(frames) if frames else tuple(f"{side}_hand" for side in settings.hands)
    _check(settings, command, sites)
    _check_files(record=record, show=None if show == "spawn" else show)
    plan = RobotPlan(
        settings=settings,
        model=None if str(robot) == "sim" else Path(robot),
        frames=sites,
        command=command,
        ros=ros,
        record=Path(record).absolute() if record is not None else None,
        view=view,
        scene=scene,
    )
    with ExitStack() as stack:
        switch = open_deadman(
            deadman, gesture_allowed=command is None or emergency_stop, ros=lambda: ros or RosPlan.listening(session.ros)
        )
        stack.callback(switch.close)
        watches = [] if watch is None else [watch]
        if show is not None:
            from .scene_view import SceneView

            scene_view = SceneView(settings, str(show))
            stack.callback(scene_view.close)
            watches.append(scene_view)
        link = RobotLink(plan)
        stack.callback(link.close)
        link.wait_ready()
        stack.enter_context(session)
        with shown(progress) as report:
            report("teleoperation", 0, None, switch.hint)
        with stop_requests() as stopped:
            summary = run_control_loop(session, switch, link, settings, watches=watches, stopped=stopped)
            stack.close()
    return summary


def _check_files(**places: str | Path | None) -> None:
    for option, place in places.items():
        if place is not None:
            check_output_file(Path(place), option=option)


def _check(settings: TeleoperationSettings, command: str | None, sites: Sequence[str]) -> None:
    if not settings.hands or len(set(settings.hands)) != len(settings.hands):
        raise ConfigError(f"hands: expected left, right or both, each once, got {settings.hands}")
    if len(sites) != len(settings.hands):
        raise ConfigError(f"frames: expected one per hand ({', '.join(settings.hands)}), got {len(sites)}")
    if command not in (None, "pose", "twist", "joints"):
        raise ConfigError(f"command: expected pose, twist or joints, got {command!r}")
    if any(low >= high for low, high in zip(settings.limits.box_low_m, settings.limits.box_high_m, strict=True)):
        raise ConfigError("limits.box_low_m: expected each coordinate below that of box_high_m")
    if settings.separation.stop_m >= settings.separation.slow_m:
        raise ConfigError("separation.stop_m: expected less than slow_m")
    if settings.gate.slow_sigma_m >= settings.gate.hold_sigma_m:
        raise ConfigError("gate.slow_sigma_m: expected less than hold_sigma_m")
