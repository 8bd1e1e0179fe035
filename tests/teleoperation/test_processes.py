"""Real processes: whatever is killed or stopped, the robot stands soon after. Times are measured in the bench, not here."""

import os
import signal
import sys
import time

import numpy as np
import pytest
from commanded import order

pytest.importorskip("mujoco")
pytest.importorskip("daqp")

from posefuse.core import ConfigError, SourceError
from posefuse_teleop.process import RobotLink, RobotPlan
from posefuse_teleop.settings import TeleoperationSettings

PLAN = RobotPlan(settings=TeleoperationSettings())


def wait_for(link, condition, wait_s=20.0):
    end_s = time.monotonic() + wait_s
    while time.monotonic() < end_s:
        link.poll()
        if condition(link.state):
            return True
        time.sleep(0.005)
    return False


@pytest.fixture
def link():
    made = RobotLink(PLAN)
    try:
        made.wait_ready()
        yield made
    finally:
        made.close()


def speed(state):
    return np.linalg.norm(state.velocity_world)


def set_moving(link):
    """Orders until the robot moves at 0.1 m/s or more."""
    seq = 0
    end_s = time.monotonic() + 20.0
    while speed(link.state) < 0.1 and time.monotonic() < end_s:
        seq += 1
        link.send(order(seq, time.monotonic_ns(), link.state.xyz_world + [0.0, 0.0, 0.1], link.state.wxyz))
        time.sleep(0.01)
        link.poll()
    assert speed(link.state) >= 0.1


def test_the_robot_moves_by_orders_and_stands_without_them(link):
    start = link.state.xyz_world
    set_moving(link)
    assert wait_for(link, lambda state: speed(state) == 0.0)
    assert "watchdog" in link.state.limited and np.abs(link.state.xyz_world - start).max() > 1e-3


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no signal that asks a process to end")
def test_a_robot_process_that_is_asked_to_end_brakes_first(link):
    set_moving(link)
    os.kill(link.pid, signal.SIGTERM)
    with pytest.raises(SourceError, match="its process has ended"):
        wait_for(link, lambda state: False)
    assert speed(link.state) == 0.0 and link.state.order_seq == -1


@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="this system has no hang-up")
def test_a_closed_terminal_leaves_the_robot_to_the_operators_side(link):
    os.kill(link.pid, signal.SIGHUP)
    set_moving(link)


def test_a_robot_process_that_is_killed_is_reported(link):
    os.kill(link.pid, getattr(signal, "SIGKILL", signal.SIGTERM))
    with pytest.raises(SourceError, match="its process has ended"):
        for _ in range(400):
            link.poll()
            time.sleep(0.01)


def test_a_robot_that_cannot_be_driven_is_reported_in_one_line():
    made = RobotLink(RobotPlan(settings=TeleoperationSettings(), frames=("tool",)))
    try:
        with pytest.raises(ConfigError, match="no site 'tool'"):
            made.wait_ready()
    finally:
        made.close()
