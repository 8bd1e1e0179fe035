"""The operator's side: views, heartbeats and the robot's state in, orders out. One pure step."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from .gate import Beat, Gate, Heartbeats, Seen, speed_mps, step_gate
from .mapping import Clutch, engaged, moved
from .separation import OperatorBody, remembered, separation_m, speed_share
from .settings import TeleoperationSettings
from .steady import Steady, steadied
from .values import CameraReport, OperatorView, Order, Phase, RobotState


@dataclass(frozen=True, eq=False, kw_only=True)
class Operator:
    """State of the operator's side.

    Attributes:
        gate, heartbeats, clutch, body, steady: states of the parts; the clutch is None before the first engagement, steady
            before the first view.
        view, cameras, robot: newest of each. separation_m: least distance of robot and operator; NaN: not known.
    """

    gate: Gate = field(default_factory=Gate)
    beats: Heartbeats = field(default_factory=Heartbeats)
    body: OperatorBody = field(default_factory=OperatorBody.unknown)
    clutch: Clutch | None = None
    steady: Steady | None = None
    view: OperatorView | None = None
    cameras: CameraReport | None = None
    robot: RobotState | None = None
    separation_m: float = float("nan")
    seq: int = 0


@dataclass(frozen=True, eq=False, kw_only=True)
class OperatorNews:
    """What came since the last step: newest of each, None where there is nothing new; heartbeats in the order they came."""

    view: OperatorView | None = None
    beats: tuple[Beat, ...] = ()
    cameras: CameraReport | None = None
    robot: RobotState | None = None
    emergency: bool = False
    reset: bool = False


def step_operator(
    operator: Operator, news: OperatorNews, now_ns: int, settings: TeleoperationSettings
) -> tuple[Operator, Order | None]:
    """Take in what is new and decide: the new state, and the order for the robot; None before its first state is known."""
    beats = operator.beats
    for beat in news.beats:
        beats = beats.with_beat(beat, now_ns, settings.gate)
    view, robot = news.view or operator.view, news.robot or operator.robot
    cameras = news.cameras or operator.cameras
    body = remembered(operator.body, news.view) if news.view is not None else operator.body
    distance_m, share = float("nan"), 1.0
    if settings.robot.shared:
        distance_m = separation_m(body, robot.spheres_world, now_ns, settings.separation) if robot is not None else distance_m
        share = speed_share(distance_m, settings.separation)
    seen = Seen(
        now_ns=now_ns,
        view=view,
        beats=beats,
        cameras=cameras,
        robot=robot,
        separation_share=share,
        emergency=news.emergency,
        reset=news.reset,
    )
    gate = step_gate(operator.gate, seen, settings.gate)
    steady = operator.steady
    if news.view is not None:
        # the gate goes by the hand as it was measured, the target by the steady one
        steady = steadied(steady, news.view, settings.mapping.rest_noise_m)
    clutch = _clutch(operator.clutch, gate, view, steady, robot, settings)
    after = Operator(
        gate=gate,
        beats=beats,
        body=body,
        clutch=clutch,
        steady=steady,
        view=view,
        cameras=cameras,
        robot=robot,
        separation_m=distance_m,
        seq=operator.seq + 1,
    )
    return after, _order(after, settings, now_ns)


def _clutch(
    clutch: Clutch | None,
    gate: Gate,
    view: OperatorView | None,
    steady: Steady | None,
    robot: RobotState | None,
    settings: TeleoperationSettings,
) -> Clutch | None:
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
        grip=np.full(hands, operator.beats.grip),
        measured_ns=operator.view.measured_ns if operator.view is not None else 0,
        reason=gate.reason,
    )
    if gate.phase is not Phase.ENGAGED or clutch is None:
        return order
    moves = replace(order, xyz_world=clutch.xyz, wxyz=clutch.wxyz, speed_mps=speed_mps(gate, settings.limits.speed_mps))
    return moves if moves.usable else replace(order, phase=Phase.HOLD)
