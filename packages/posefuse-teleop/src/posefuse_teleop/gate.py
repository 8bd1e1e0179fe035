"""May the robot follow the hand now, and how fast? A pure state machine: IDLE, READY, ENGAGED, HOLD, STOPPED.

    IDLE ----- all well, switch let go -----> READY ----- switch held, robot stands -----> ENGAGED
     ^                                          |                                        |    ^
     +--------- something missing --------------+                      anything missing  v    | all well again, robot stands
     +------------- missing for longer than `REENGAGE_S`, another body or hand -------- HOLD

A fault of the robot or an emergency stop leads to STOPPED from everywhere; a reset with the switch let go leads to IDLE.

The dead-man's switch reports by heartbeats. Every check of what the gate depends on gives a share of the speed limit, 0 for HOLD,
and why. A view is compared with what was seen last of each part, however long ago: is it the same body, with the same hands?
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from posefuse.core.arrays import Array

from .hands import TRUNK
from .settings import (
    AHEAD_S,
    BEATS_TO_ENGAGE,
    FOREARM_SHARE,
    FULL_VIEWS,
    HAND_STEP_M,
    HANDS_APART_M,
    HEALTH_S,
    HEARTBEAT_S,
    REENGAGE_S,
    ROBOT_AGE_S,
    SETTLE_S,
    STANDING_MPS,
    TRUNK_SHARE,
    GateSettings,
)
from .values import CameraReport, OperatorView, Phase, RobotState, all_finite


@dataclass(frozen=True, kw_only=True)
class Beat:
    """One heartbeat. seq: counts up. sent_ns: when, on the gate's clock. grip: close the gripper."""

    seq: int
    sent_ns: int
    grip: bool = False


@dataclass(frozen=True, kw_only=True)
class Pressed:
    """What came from the switch since it was asked last. emergency: stop now, until a reset. reset: leave STOPPED."""

    heartbeats: tuple[Beat, ...] = ()
    emergency: bool = False
    reset: bool = False


@dataclass(frozen=True, kw_only=True)
class Heartbeats:
    """What was received.

    Attributes:
        seq, grip: of the newest heartbeat. last_ns: when it was sent. count: in a row.
        heard_ns: when the last one of any kind came: heartbeats that come too late show that the switch is still held.
    """

    seq: int = -1
    last_ns: int | None = None
    heard_ns: int | None = None
    count: int = 0
    grip: bool = False

    def with_beat(self, beat: Beat, now_ns: int) -> Heartbeats:
        """After one more heartbeat. A duplicate, one that overtook another, a late one and one from the future do not count."""
        longest_ns = HEARTBEAT_S * 1e9
        heard = replace(self, heard_ns=now_ns)
        if beat.seq <= self.seq or not 0 <= now_ns - beat.sent_ns <= longest_ns:
            return heard
        if self.last_ns is not None and beat.sent_ns < self.last_ns:
            return heard
        in_a_row = self.last_ns is not None and beat.sent_ns - self.last_ns <= longest_ns
        count = self.count + 1 if in_a_row else 1
        return replace(heard, seq=beat.seq, last_ns=beat.sent_ns, count=count, grip=beat.grip)

    def held(self, now_ns: int) -> bool:
        """Whether the switch is held now: enough heartbeats in a row, the newest one new enough."""
        return self.count >= BEATS_TO_ENGAGE and _new(self.last_ns, now_ns)

    def let_go(self, now_ns: int) -> bool:
        """Whether the switch is released: no heartbeat of any kind for so long that one would have come."""
        return not _new(self.heard_ns, now_ns)


def _new(t_ns: int | None, now_ns: int) -> bool:
    return t_ns is not None and 0 <= now_ns - t_ns <= HEARTBEAT_S * 1e9


# a gate that was not stepped for this long has lost track of the state
_STALLED_S = 0.1


class Finding(NamedTuple):
    """What one check found: share of the speed limit in 0..1, why it is not 1, and whether it ends the engagement."""

    share: float
    reason: str
    ends: bool = False


FINE = Finding(1.0, "")


def clock_finding(before_ns: int | None, now_ns: int) -> Finding:
    """Time goes forward, and the gate is stepped often enough."""
    if before_ns is None:
        return Finding(0.0, "begins")
    if now_ns < before_ns:
        return Finding(0.0, "the clock went backward")
    return Finding(0.0, "the control loop stalled") if now_ns - before_ns > _STALLED_S * 1e9 else FINE


def robot_finding(robot: RobotState | None, now_ns: int) -> Finding:
    """The robot's state is there, new and finite."""
    if robot is None:
        return Finding(0.0, "no state of the robot")
    if not -AHEAD_S * 1e9 <= now_ns - robot.sent_ns <= ROBOT_AGE_S * 1e9:
        return Finding(0.0, "state of the robot is too old")
    return FINE if robot.usable else Finding(0.0, "state of the robot is not finite")


def camera_finding(cameras: CameraReport | None, now_ns: int, settings: GateSettings) -> Finding:
    """Enough cameras are healthy; with some faulty the speed limit falls with their share."""
    if cameras is None or not -AHEAD_S * 1e9 <= now_ns - cameras.t_ns <= HEALTH_S * 1e9:
        return Finding(0.0, "no news of the cameras")
    if cameras.healthy < settings.least_cameras or cameras.healthy > cameras.total:
        return Finding(0.0, f"{cameras.healthy} of {cameras.total} cameras are well")
    if cameras.healthy < cameras.total:
        return Finding(cameras.healthy / cameras.total, f"{cameras.healthy} of {cameras.total} cameras are well")
    return FINE


def hand_finding(view: OperatorView | None, late: str, settings: GateSettings) -> Finding:
    """The hands are recent, measured and certain. late: why the view is not of now (`time_problem`)."""
    if view is None or view.person_id < 0:
        return Finding(0.0, "no person is seen")
    problem = late or hand_problem(view, settings)
    if problem:
        return Finding(0.0, problem)
    sigma, views = float(view.sigma_m.max()), int(view.views.min())
    sure = (settings.hold_sigma_m - sigma) / max(settings.hold_sigma_m - settings.slow_sigma_m, 1e-9)
    few = Finding(0.5, f"{views} cameras see the hand") if views < FULL_VIEWS else FINE
    unsure = Finding(sure, _known_to(sigma)) if sure < 1 else FINE
    return min(few, unsure, key=lambda found: found.share)


def _known_to(sigma_m: float) -> str:
    return f"hand known to {1e3 * sigma_m:.0f} mm only"


def time_problem(view: OperatorView, before_ns: int | None, changed_ns: int | None, now_ns: int, settings: GateSettings) -> str:
    """Why the view is not of now; empty: it is.

    Args:
        before_ns: of the view before; None: there is none. changed_ns: when the hands differed last from those before.
    """
    for t_ns in (view.t_ns, view.measured_ns):
        if now_ns - t_ns < -AHEAD_S * 1e9:
            return "pose from the future"
    if now_ns - view.measured_ns > settings.pose_age_s * 1e9 or now_ns - view.t_ns > settings.pose_age_s * 1e9:
        return "pose is too old"
    if before_ns is not None and view.t_ns < before_ns:
        return "poses go back in time"
    if changed_ns is not None and now_ns - changed_ns > settings.pose_age_s * 1e9:
        return "the hand is frozen"
    return ""


def hand_problem(view: OperatorView, settings: GateSettings) -> str:
    """Why the view does not show where the hands are; empty: it does."""
    if not all_finite(view.xyz_world, view.sigma_m, view.forearm_m):
        return "hand is not seen"
    if not (view.sigma_m >= 0).all():
        return "hand without an uncertainty"
    if not view.measured.all():
        return "hand is only predicted"
    if (view.views < settings.least_views).any():
        return f"{int(view.views.min())} cameras see the hand"
    if (view.sigma_m >= settings.hold_sigma_m).any():
        return _known_to(float(view.sigma_m.max()))
    apart = np.linalg.norm(view.other_xyz_world - view.xyz_world, axis=1)
    return "" if (apart >= HANDS_APART_M).all() else "left and right hand are too near to each other, or one is not seen"


# of a trunk: ISO 13855 has it for walking; a longer absence does not make a longer step of a trunk credible
_WALK_MPS, _ABSENCE_S = 1.6, 0.1
# steps beyond these speeds: of the walker of examples/demo, found by blazepose_lite and tracked, those of the trunk (the mean of
# its keypoints) are 15 mm at most, and those of a wrist 56 mm
_TRUNK_STEP_M, _HAND_STEP_M = 0.06, 0.1
# share of a new length in the running mean
_NEW = 0.003


@dataclass(frozen=True, eq=False, kw_only=True)
class SeenBody:
    """What was seen last of a person, and when; NaN: never.

    Attributes:
        person_id: whose. hand_xyz, other_xyz: (H, 3) hands and the wrists of the other arms, seen together at hand_ns.
        trunk_xyz: (4, 3) `hands.TRUNK`, each seen at trunk_ns (4,).
        lengths_m: (H + 1,) of the forearms, and from the middle of the shoulders to that of the hips: running means.
    """

    person_id: int
    hand_xyz: Array
    other_xyz: Array
    hand_ns: int
    trunk_xyz: Array
    trunk_ns: Array
    lengths_m: Array


def seen_in(view: OperatorView, hands_known: bool, settings: GateSettings) -> SeenBody:
    """What one view shows; `hands_known`: there is no doubt about the hands in it."""
    trunk, sigma_m = view.body_xyz_world[TRUNK], view.body_sigma_m[TRUNK]
    sure = view.body_measured[TRUNK] & (sigma_m <= settings.hold_sigma_m) & np.isfinite(trunk).all(axis=1)
    trunk = np.where(sure[:, None], trunk, np.nan)
    here = 1.0 if hands_known else np.nan
    length = np.linalg.norm(trunk[:2].mean(axis=0) - trunk[2:].mean(axis=0))
    return SeenBody(
        person_id=view.person_id,
        hand_xyz=here * view.xyz_world,
        other_xyz=here * view.other_xyz_world,
        hand_ns=view.t_ns,
        trunk_xyz=trunk,
        trunk_ns=np.full(4, view.t_ns),
        lengths_m=np.array([*(here * view.forearm_m), length]),
    )


def continuity_finding(known: SeenBody, now: SeenBody, settings: GateSettings) -> Finding:
    """The view shows the body and the hand that are known; else it ends the engagement. A hand that is only too fast: HOLD."""
    if now.person_id != known.person_id:
        return _ends("another person")
    trunk, absent_s = _length(now.trunk_xyz - known.trunk_xyz), (now.trunk_ns - known.trunk_ns) / 1e9
    both = np.isfinite(trunk)
    if both.any() and (trunk - _WALK_MPS * np.clip(absent_s, 0.0, _ABSENCE_S))[both].mean() > _TRUNK_STEP_M:
        return _ends("the trunk jumped: another body")
    hand, other = _length(now.hand_xyz - known.hand_xyz), _length(now.other_xyz - known.other_xyz)
    # a hand that was hidden may be elsewhere, where the trunk shows that it is the same person's
    longest_s = REENGAGE_S if both.any() else _ABSENCE_S
    too_far_m = hand - settings.hand_speed_mps * np.clip((now.hand_ns - known.hand_ns) / 1e9, 0.0, longest_s)
    if (too_far_m > _HAND_STEP_M).any():
        return _ends("the hand jumped")
    if (_length(now.hand_xyz - known.other_xyz) + _length(now.other_xyz - known.hand_xyz) < hand + other).any():
        return _ends("left and right hand were swapped")
    share = np.append(np.full(len(hand), FOREARM_SHARE), TRUNK_SHARE)
    if (np.abs(now.lengths_m - known.lengths_m) > share * known.lengths_m).any():
        return _ends("forearm or trunk of another length: another body or hand")
    return Finding(0.0, "the hand is too fast") if (too_far_m > HAND_STEP_M).any() else FINE


def _ends(reason: str) -> Finding:
    return Finding(0.0, reason, ends=True)


def continued(known: SeenBody, now: SeenBody) -> SeenBody:
    """The known body after a view of it: what the view does not show stays as it was seen last."""
    hands, trunk = np.isfinite(now.hand_xyz).all(), np.asarray(np.isfinite(now.trunk_xyz).all(axis=1))
    mean_m = known.lengths_m + _NEW * (now.lengths_m - known.lengths_m)
    return SeenBody(
        person_id=known.person_id,
        hand_xyz=now.hand_xyz if hands else known.hand_xyz,
        other_xyz=now.other_xyz if hands else known.other_xyz,
        hand_ns=now.hand_ns if hands else known.hand_ns,
        trunk_xyz=np.where(trunk[:, None], now.trunk_xyz, known.trunk_xyz),
        trunk_ns=np.where(trunk, now.trunk_ns, known.trunk_ns),
        lengths_m=np.where(np.isfinite(mean_m), mean_m, np.where(np.isfinite(known.lengths_m), known.lengths_m, now.lengths_m)),
    )


def _length(vectors: Array) -> Array:
    return np.asarray(np.linalg.norm(vectors, axis=-1))


@dataclass(frozen=True, eq=False, kw_only=True)
class Seen:
    """All that the gate goes by, at one time.

    Attributes:
        now_ns: of the monotonic clock. view: the operator in the newest pose; None before the first. heartbeats: of the switch.
        pressed: what came from it last. cameras: newest report. robot: newest state; both None before the first.
        separation_share: share of the speed limit that the distance between robot and operator leaves.
    """

    now_ns: int = 0
    view: OperatorView | None = None
    heartbeats: Heartbeats = field(default_factory=Heartbeats)
    pressed: Pressed = field(default_factory=Pressed)
    cameras: CameraReport | None = None
    robot: RobotState | None = None
    separation_share: float = 0.0


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
    view = seen.view
    late = time_problem(view, gate.view_t_ns, gate.changed_ns, seen.now_ns, settings) if view is not None else ""
    # the first of the lowest share; what ends the engagement comes first: no finding is worse than 0
    found = min(
        change,
        clock_finding(gate.now_ns, seen.now_ns),
        robot_finding(seen.robot, seen.now_ns),
        camera_finding(seen.cameras, seen.now_ns, settings),
        hand_finding(seen.view, late, settings),
        _separation_finding(seen.separation_share),
        key=lambda one: one.share,
    )
    fine_ns = None if found.share <= 0 else seen.now_ns if gate.fine_ns is None else gate.fine_ns
    after = replace(after, now_ns=seen.now_ns, fine_ns=fine_ns, share=0.0, reason=found.reason, engages=False)
    if seen.pressed.emergency or (seen.robot is not None and seen.robot.fault):
        reason = "emergency stop" if seen.pressed.emergency else f"robot: {seen.robot.fault if seen.robot else ''}"
        return replace(after, phase=Phase.STOPPED, person_id=None, let_go=False, reason=reason)
    if found.ends and gate.phase is not Phase.STOPPED:
        return replace(after, phase=Phase.IDLE, person_id=None, lost_ns=None, let_go=False)
    return _next_phase(gate, after, found, seen)


def _next_phase(before: Gate, after: Gate, found: Finding, seen: Seen) -> Gate:
    phase, now_ns, fine = before.phase, seen.now_ns, found.share > 0
    let_go = seen.heartbeats.let_go(now_ns)
    if phase is Phase.STOPPED:
        if seen.pressed.reset and let_go:
            return replace(after, phase=Phase.IDLE, let_go=True)
        return replace(after, reason="stopped; reset with the switch let go")
    held = seen.heartbeats.held(now_ns)
    settled = after.fine_ns is not None and now_ns - after.fine_ns >= SETTLE_S * 1e9 and _stands(seen.robot)
    if phase in (Phase.IDLE, Phase.READY):
        ready = fine and (after.let_go or let_go)
        if ready and held and settled and phase is Phase.READY and seen.view is not None:
            return replace(_engaged(after, found), person_id=seen.view.person_id)
        reason = after.reason if not fine else "press to engage" if ready else "let the switch go first"
        return replace(after, phase=Phase.READY if ready else Phase.IDLE, person_id=None, let_go=ready, reason=reason)
    if fine and held and phase is Phase.ENGAGED:
        return replace(after, phase=Phase.ENGAGED, share=found.share, lost_ns=None)
    if fine and held and settled:
        return _engaged(after, found)
    # from the last step without a loss: a program that was stopped meanwhile has lost all of that time
    lost_ns = before.now_ns if before.lost_ns is None else before.lost_ns
    if lost_ns is None or not 0 <= now_ns - lost_ns <= REENGAGE_S * 1e9:
        return replace(after, phase=Phase.IDLE, person_id=None, lost_ns=None, let_go=False)
    reason = after.reason if not fine else "switch let go" if not held else "settling"
    return replace(after, phase=Phase.HOLD, lost_ns=lost_ns, reason=reason)


def _engaged(after: Gate, found: Finding) -> Gate:
    return replace(after, phase=Phase.ENGAGED, share=found.share, lost_ns=None, let_go=False, engages=True)


def _separation_finding(share: float) -> Finding:
    if not share > 0:
        return Finding(0.0, "too near to the robot, or not known how near")
    return Finding(min(share, 1.0), "near the robot" if share < 1 else "")


def _stands(robot: RobotState | None) -> bool:
    return robot is not None and bool((np.linalg.norm(robot.velocity_world, axis=1) <= STANDING_MPS).all())


def _with_view(gate: Gate, seen: Seen, settings: GateSettings) -> tuple[Gate, Finding]:
    """With what the next view must continue, and whether this one continues what was known."""
    view, known = seen.view, gate.body
    if view is None or view.person_id < 0:
        return gate, FINE
    now = seen_in(view, not hand_problem(view, settings), settings)
    same = known is not None and np.array_equal(now.hand_xyz, known.hand_xyz)
    after = replace(gate, view_t_ns=view.t_ns, changed_ns=gate.changed_ns if same else seen.now_ns)
    # by the times of the views alone: a clock that is off hides no swap
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
