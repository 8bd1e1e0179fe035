"""Real processes that move a robot, of which one is killed: how long the robot moves on, by its process's own recording."""

from __future__ import annotations

import itertools
import multiprocessing
import os
import signal
import tempfile
import time
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from posefuse_ros.bags import read_mcap
from posefuse_ros.messages import ns_from_time
from posefuse_teleop.gate import Beat, Pressed
from posefuse_teleop.process import RobotLink, RobotPlan
from posefuse_teleop.settings import TeleoperationSettings
from posefuse_teleop.values import OperatorView, Order, Phase

SILENT = "operator's side goes silent"
OF_OPERATOR = {
    "operator's process killed (-9)": signal.SIGKILL,
    "operator's process stopped (-STOP)": signal.SIGSTOP,
    SILENT: None,
}
_STILL_M = 1e-7


class Held:
    """A switch that is held from a while after the first pose."""

    hint = "held by the bench"

    def __init__(self, from_s: float) -> None:
        self._from_s, self._seq = from_s, 0
        self._first_ns: int | None = None

    def poll(self, now_ns: int, view: OperatorView | None) -> Pressed:
        self._first_ns = now_ns if self._first_ns is None and view is not None else self._first_ns
        self._seq += 1
        held = self._first_ns is not None and now_ns - self._first_ns > 1e9 * self._from_s
        return Pressed(heartbeats=(Beat(seq=self._seq, sent_ns=now_ns),) if held else ())

    def close(self) -> None: ...


def last_motion_ms(record: Path, fault_ns: int) -> float:
    """From the fault to the last motion of the commanded hand."""
    places = [
        (ns_from_time(one.msg.header.stamp), np.array([getattr(one.msg.pose.position, axis) for axis in "xyz"]))
        for one in read_mcap(record, {"/posefuse/teleoperation/right/commanded"})
    ]
    moving = [t_ns for (_, a), (t_ns, b) in itertools.pairwise(places) if np.linalg.norm(b - a) > _STILL_M and t_ns > fault_ns]
    return (max(moving, default=fault_ns) - fault_ns) / 1e6


def of_operator(fault: str) -> float:
    """Milliseconds until the robot stands: orders at 100 Hz move it at full speed, then something happens to their process."""
    with tempfile.TemporaryDirectory() as folder:
        record, context = Path(folder) / "robot.mcap", multiprocessing.get_context("spawn")
        receiving, sending = context.Pipe(duplex=False)
        operator = context.Process(target=_drive, args=(record, sending, fault == SILENT))
        operator.start()
        robot_pid, fault_ns = receiving.recv(), receiving.recv()
        if OF_OPERATOR[fault]:
            fault_ns = time.time_ns()
            os.kill(operator.pid, OF_OPERATOR[fault])
        time.sleep(2.0)
        os.kill(operator.pid, signal.SIGKILL)
        operator.join()
        # the robot's process ends by itself, and writes its recording before
        end_s = time.monotonic() + 5
        while time.monotonic() < end_s and _runs(robot_pid):
            time.sleep(0.01)
        return last_motion_ms(record, fault_ns)


def _runs(pid: int) -> bool:
    return Path(f"/proc/{pid}").exists()


def _drive(record: Path, sending: Connection, silent: bool) -> None:
    """An operator's side that drives the robot forward at full speed until something happens to it."""
    link = RobotLink(RobotPlan(settings=TeleoperationSettings(), record=record))
    link.wait_ready()
    sending.send(link.pid)
    begun_s, moves = time.monotonic(), False
    for seq in itertools.count(1):
        time.sleep(0.01)
        link.poll()
        if not moves and np.linalg.norm(link.state.velocity_world) > 0.25 and time.monotonic() - begun_s > 0.3:
            moves = True
            sending.send(time.time_ns())
        if not (moves and silent):
            about = {"seq": seq, "sent_ns": time.monotonic_ns(), "phase": Phase.ENGAGED, "speed_mps": 0.5}
            target = link.state.xyz_world + [0.1, 0.0, 0.0]
            link.send(Order(**about, xyz_world=target, wxyz=link.state.wxyz, grip=np.array([False])))
