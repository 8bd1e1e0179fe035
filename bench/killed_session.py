"""A live session that teleoperates a simulated robot, in real processes, one of which is killed while the robot moves."""

from __future__ import annotations

import itertools
import os
import re
import signal
import tempfile
import time
from pathlib import Path

import numpy as np

import posefuse as pf
from posefuse.api.live import LiveSession
from posefuse.formats.rig import read_rig
from posefuse_ros.bags import read_mcap
from posefuse_ros.messages import ns_from_time
from posefuse_sim.session import SessionPaths
from posefuse_teleop.gate import Beat
from posefuse_teleop.settings import MappingSettings, RobotSettings, TeleoperationSettings
from posefuse_teleop.switches import Pressed

# of each: the words of the session's news that name the process, and the signal
FAULTS = {
    "session's process (fusion) killed": ("", signal.SIGKILL),
    "process of all cameras killed": (r"cameras [^;]* in process (\d+)", signal.SIGKILL),
    "process of all cameras stopped, as by a cut link": (r"cameras [^;]* in process (\d+)", signal.SIGSTOP),
    "process of the outputs killed": (r"outputs [^;]* in process (\d+)", signal.SIGKILL),
    "process of the rig watch killed": (r"rig watched in process (\d+)", signal.SIGKILL),
}
_MOVING_MPS, _ENGAGED_S, _AFTER_S, _LONGEST_S = 0.2, 1.0, 1.5, 60.0
_STILL_M = 1e-7


class Held:
    """A switch that is always held, but at first."""

    hint = "held by the bench"

    def __init__(self) -> None:
        self._seq, self._first_ns = 0, None

    def poll(self, now_ns, view):
        self._first_ns = now_ns if self._first_ns is None and view is not None else self._first_ns
        self._seq += 1
        held = self._first_ns is not None and now_ns - self._first_ns > 5e8
        return Pressed(heartbeats=(Beat(seq=self._seq, sent_ns=now_ns),) if held else ())

    def close(self):
        pass


class _Done(Exception):
    pass


def ms_until_standing(fault: str, session: Path) -> float | None:
    """From the fault to the last motion of the robot, by the robot's own recording; None: it continued moving.

    Raises:
        RuntimeError: the robot never moved.
    """
    oracle = {"name": "oracle", "options": {"truth": str(SessionPaths(session).truth), "noise": {"sigma_px": 1.0}}}
    # half the way of a walking person's hand, so that the robot can follow
    settings = TeleoperationSettings(
        mapping=MappingSettings(scale=0.3), robot=RobotSettings(position_xy_m=(2.5, 0.0), shared=False)
    )
    live = pf.live(read_rig(SessionPaths(session).rig), [f"sim:{session}"], settings={"detector": oracle, "groups": 1})
    seen: dict[str, float] = {}

    def watch(operator, order) -> None:
        now_s = time.monotonic()
        if "begun" not in seen:
            seen["begun"] = now_s
        if "fault_ns" in seen:
            if now_s - seen["fault_s"] > _AFTER_S:
                raise _Done
            return
        if now_s - seen["begun"] > _LONGEST_S:
            raise RuntimeError("the robot did not move")
        engaged = operator.gate.phase == "engaged"
        seen["engaged_s"] = seen.get("engaged_s", now_s) if engaged else now_s
        moves = operator.robot is not None and np.linalg.norm(operator.robot.velocity_world) > _MOVING_MPS
        if engaged and moves and now_s - seen["engaged_s"] > _ENGAGED_S:
            seen["fault_ns"], seen["fault_s"] = time.time_ns(), now_s
            os.kill(_process(live, FAULTS[fault][0]), FAULTS[fault][1])

    with tempfile.TemporaryDirectory() as folder:
        record = Path(folder) / "robot.mcap"
        stopped = None
        try:
            pf.teleoperate(live, deadman=Held(), settings=settings, record=record, watch=watch)
        except _Done:
            pass
        finally:
            if FAULTS[fault][1] is signal.SIGSTOP and "fault_ns" in seen:
                stopped = _process(live, FAULTS[fault][0])
        if stopped is not None:
            _end(stopped)
        if "fault_ns" not in seen:
            raise RuntimeError("the session ended before the robot moved")
        return _standing_ms(record, int(seen["fault_ns"]))


def _process(live: LiveSession, pattern: str) -> int:
    if not pattern:
        return int(live.pid or 0)
    found = [int(match[1]) for line in live.news if (match := re.search(pattern, line))]
    if not found:
        raise RuntimeError(f"no process {pattern!r} in {live.news}")
    return found[0]


def _end(pid: int) -> None:
    """A stopped process that outlived its session."""
    try:
        os.kill(pid, signal.SIGKILL)
    except ProcessLookupError:
        return


def _standing_ms(record: Path, fault_ns: int) -> float | None:
    places = [
        (ns_from_time(one.msg.header.stamp), np.array([getattr(one.msg.pose.position, axis) for axis in "xyz"]))
        for one in read_mcap(record, {"/posefuse/teleoperation/right/commanded"})
    ]
    moving = [t_ns for (_, a), (t_ns, b) in itertools.pairwise(places) if np.linalg.norm(b - a) > _STILL_M]
    later = [t_ns for t_ns in moving if t_ns > fault_ns]
    last_ns = max(later, default=fault_ns)
    # closing the session makes it brake, too
    return None if last_ns > fault_ns + 0.9e9 * _AFTER_S else (last_ns - fault_ns) / 1e6
