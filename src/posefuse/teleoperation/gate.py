"""May the robot follow the hand now, and how fast? A pure state machine: IDLE, READY, ENGAGED, HOLD, STOPPED.

    IDLE ----- all well, switch let go -----> READY ----- switch held, robot stands -----> ENGAGED
     ^                                          |                                        |    ^
     +--------- something missing --------------+                      anything missing  v    | all well again, robot stands
     +------------- missing for longer than `reengage_s`, another body or hand -------- HOLD

A fault of the robot or an emergency stop leads to STOPPED from everywhere; a reset with the switch let go leads to IDLE.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from .checks import FINE, Finding, camera_finding, clock_finding, hand_finding, hand_problem, robot_finding, time_problem
from .heartbeats import Heartbeats
from .identity import SeenBody, continued, continuity_finding, seen_in
from .settings import GateSettings
from .values import CameraReport, OperatorView, Phase, RobotState


@dataclass(frozen=True, eq=False, kw_only=True)
class Seen:
    """All that the gate goes by, at one time.

    Attributes:
        now_ns: of the monotonic clock. view: the operator in the newest pose; None before the first. heartbeats: of the switch.
        cameras: newest report; None before the first. robot: newest state; None before the first.
        separation_share: share of the speed limit that the distance between robot and operator leaves.
        emergency: an emergency stop is pressed. reset: leave STOPPED.
    """

    now_ns: int
    view: OperatorView | None
    beats: Heartbeats
    cameras: CameraReport | None
    robot: RobotState | None
    separation_share: float
    emergency: bool = False
    reset: bool = False


@dataclass(frozen=True, eq=False, kw_only=True)
class Gate:
    """State of the gate.

    Attributes:
        phase: see `Phase`. person_id: the operator while engaged or holding, else None.
        now_ns: when it was stepped last. lost_ns: since when something has been missing; None: nothing is.
        fine_ns: start of the present time without any fault. let_go: the switch was released since its last use.
        view_t_ns, changed_ns: newest pose, and when its hands differed last from the pose before.
        body: what a new view must continue; None before the first.
        share: of the speed limit. reason: what limits it or stops it, for people. engages: the clutch engages in this step.
    """

    phase: Phase = Phase.IDLE
    person_id: int | None = None
    now_ns: int | None = None
    lost_ns: int | None = None
    fine_ns: int | None = None
    let_go: bool = False
    view_t_ns: int | None = None
    changed_ns: int | None = None
    body: SeenBody | None = None
    share: float = 0.0
    reason: str = "no pose yet"
    engages: bool = False


def step_gate(gate: Gate, seen: Seen, settings: GateSettings) -> Gate:
    """The gate after all that is known now; never raises, whatever the numbers are."""
    after, change = _with_view(gate, seen, settings)
    # what ends the engagement comes first: no finding is worse than 0
    found = _worst(
        change,
        clock_finding(gate.now_ns, seen.now_ns, settings),
        robot_finding(seen.robot, seen.now_ns, settings),
        camera_finding(seen.cameras, seen.now_ns, settings),
        hand_finding(seen.view, _late(gate, seen, settings), settings),
        _separation_finding(seen.separation_share),
    )
    fine_ns = None if found.share <= 0 else seen.now_ns if gate.fine_ns is None else gate.fine_ns
    after = replace(after, now_ns=seen.now_ns, fine_ns=fine_ns, share=0.0, reason=found.reason, engages=False)
    if seen.emergency or (seen.robot is not None and seen.robot.fault):
        reason = "emergency stop" if seen.emergency else f"robot: {seen.robot.fault if seen.robot else ''}"
        return replace(after, phase=Phase.STOPPED, person_id=None, let_go=False, reason=reason)
    if found.ends and gate.phase is not Phase.STOPPED:
        return replace(after, phase=Phase.IDLE, person_id=None, lost_ns=None, let_go=False)
    return _next_phase(gate.phase, after, found, seen, settings)


def _next_phase(phase: Phase, after: Gate, found: Finding, seen: Seen, settings: GateSettings) -> Gate:
    now_ns, fine = seen.now_ns, found.share > 0
    let_go = seen.beats.let_go(now_ns, settings)
    if phase is Phase.STOPPED:
        leaves = seen.reset and let_go
        return (
            replace(after, phase=Phase.IDLE, let_go=True)
            if leaves
            else replace(after, reason="stopped; reset with the switch let go")
        )
    held = seen.beats.held(now_ns, settings)
    settled = after.fine_ns is not None and now_ns - after.fine_ns >= settings.settle_s * 1e9 and _stands(seen.robot, settings)
    if phase in (Phase.IDLE, Phase.READY):
        ready = fine and (after.let_go or let_go)
        if ready and held and settled and phase is Phase.READY and seen.view is not None:
            return replace(_engaged(after, found), person_id=seen.view.person_id)
        reason = after.reason if not fine else "press to engage" if ready else "let the switch go first"
        return replace(after, phase=Phase.READY if ready else Phase.IDLE, person_id=None, let_go=ready, reason=reason)
    if fine and held and (phase is Phase.ENGAGED or settled):
        return (
            replace(after, phase=Phase.ENGAGED, share=found.share, lost_ns=None)
            if phase is Phase.ENGAGED
            else _engaged(after, found)
        )
    lost_ns = after.lost_ns if phase is Phase.HOLD and after.lost_ns is not None else now_ns
    if not 0 <= now_ns - lost_ns <= settings.reengage_s * 1e9:
        return replace(after, phase=Phase.IDLE, person_id=None, lost_ns=None, let_go=False)
    reason = after.reason if not fine else "switch let go" if not held else "settling"
    return replace(after, phase=Phase.HOLD, lost_ns=lost_ns, reason=reason)


def _engaged(after: Gate, found: Finding) -> Gate:
    return replace(after, phase=Phase.ENGAGED, share=found.share, lost_ns=None, let_go=False, engages=True)


def _worst(*findings: Finding) -> Finding:
    """The first of the lowest share."""
    return min(findings, key=lambda found: found.share)


def _separation_finding(share: float) -> Finding:
    if not share > 0:
        return Finding(0.0, "too near to the robot, or not known how near")
    return Finding(min(share, 1.0), "near the robot" if share < 1 else "")


def _stands(robot: RobotState | None, settings: GateSettings) -> bool:
    return robot is not None and bool((np.linalg.norm(robot.velocity_world, axis=1) <= settings.standing_mps).all())


def _late(gate: Gate, seen: Seen, settings: GateSettings) -> str:
    """Why the newest view is not of now; empty: it is, or there is none."""
    return time_problem(seen.view, gate.view_t_ns, gate.changed_ns, seen.now_ns, settings) if seen.view is not None else ""


def _with_view(gate: Gate, seen: Seen, settings: GateSettings) -> tuple[Gate, Finding]:
    """With what the next view must continue, and whether this one continues what was known."""
    view, known = seen.view, gate.body
    if view is None or view.person_id < 0:
        return gate, FINE
    now = seen_in(view, not hand_problem(view, settings), settings)
    same = known is not None and np.array_equal(now.hand_xyz, known.hand_xyz)
    after = replace(gate, view_t_ns=view.t_ns, changed_ns=gate.changed_ns if same else seen.now_ns)
    # by the times of the views alone: a clock that is off hides no exchange
    before_ns = view.t_ns if gate.view_t_ns is None else gate.view_t_ns
    if view.t_ns < before_ns or view.t_ns - view.measured_ns > settings.pose_age_s * 1e9:
        return after, FINE
    if known is None:
        return replace(after, body=now), FINE
    found = continuity_finding(known, now, settings)
    return replace(after, body=now if found.ends else continued(known, now)), found


def speed_mps(gate: Gate, most_mps: float) -> float:
    """The speed limit that the gate leaves of `most_mps`: 0 unless engaged."""
    share = gate.share if gate.phase is Phase.ENGAGED else 0.0
    return most_mps * share if math.isfinite(share) else 0.0
