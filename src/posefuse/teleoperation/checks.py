"""What the gate asks of each thing it depends on. Every check gives a share of the speed limit, 0 for HOLD, and why."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .settings import GateSettings
from .values import CameraReport, OperatorView, RobotState, all_finite

# a gate that was not stepped for this long has lost track of the state
_STALLED_S = 0.1
# clocks of one machine, and poses that are predicted to the next output tick, may be ahead by so much
_AHEAD_S = 0.05


class Finding(NamedTuple):
    """What one check found: share of the speed limit in 0..1, why it is not 1, and whether it ends the engagement."""

    share: float
    reason: str
    ends: bool = False


FINE = Finding(1.0, "")


def clock_finding(before_ns: int | None, now_ns: int, settings: GateSettings) -> Finding:
    """Time goes forward, and the gate is stepped often enough."""
    if before_ns is None:
        return Finding(0.0, "begins")
    if now_ns < before_ns:
        return Finding(0.0, "the clock went backward")
    return Finding(0.0, "the control loop stalled") if now_ns - before_ns > _STALLED_S * 1e9 else FINE


def robot_finding(robot: RobotState | None, now_ns: int, settings: GateSettings) -> Finding:
    """The robot's state is there, new and finite."""
    if robot is None:
        return Finding(0.0, "no state of the robot")
    if not -_AHEAD_S * 1e9 <= now_ns - robot.sent_ns <= settings.robot_age_s * 1e9:
        return Finding(0.0, "state of the robot is too old")
    return FINE if robot.usable else Finding(0.0, "state of the robot is not finite")


def camera_finding(cameras: CameraReport | None, now_ns: int, settings: GateSettings) -> Finding:
    """Enough cameras are healthy; with some faulty the speed limit falls with their share."""
    if cameras is None or not -_AHEAD_S * 1e9 <= now_ns - cameras.t_ns <= settings.health_s * 1e9:
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
    few = Finding(0.5, f"{views} cameras see the hand") if views < settings.full_views else FINE
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
        if now_ns - t_ns < -_AHEAD_S * 1e9:
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
    return "" if (apart >= settings.hands_apart_m).all() else "left and right hand are too near to each other, or one is not seen"
