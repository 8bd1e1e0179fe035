"""Real processes: whatever is killed or stopped, the robot stands soon after. Times are measured in the bench, not here."""

import itertools
import math
import os
import shutil
import signal
import sys
import time
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
from checks import refusal
from commanded import order
from live_session import Live, command, until

pytest.importorskip("mujoco")
pytest.importorskip("daqp")

from posefuse.cli import main as cli
from posefuse.core import ConfigError, InputError, SourceError
from posefuse_teleop.process import RobotLink, RobotPlan
from posefuse_teleop.settings import TeleoperationSettings

PLAN = RobotPlan(settings=TeleoperationSettings())


@pytest.fixture
def link():
    with closing(RobotLink(PLAN)) as made:
        made.wait_ready()
        yield made


def speed(state):
    return np.linalg.norm(state.velocity_world)


def set_moving(link, least_mps=0.1):
    """Orders until the robot moves so fast."""
    numbers = itertools.count(1)

    def one_more():
        link.send(order(next(numbers), time.monotonic_ns(), link.state.xyz_world + [0.0, 0.0, 0.1], link.state.wxyz))
        link.poll()

    until(lambda: speed(link.state) >= least_mps, one_more)


def test_the_robot_moves_by_orders_and_stands_without_them(link):
    start = link.state.xyz_world
    set_moving(link)
    until(lambda: speed(link.state) == 0.0, link.poll)
    assert "watchdog" in link.state.limited and np.abs(link.state.xyz_world - start).max() > 1e-3


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no signal that asks a process to end")
def test_a_robot_process_that_is_asked_to_end_brakes_first(link):
    set_moving(link)
    os.kill(link.pid, signal.SIGTERM)
    refusal(SourceError, "its process has ended", until, lambda: False, link.poll)
    assert speed(link.state) == 0.0 and link.state.order_seq == -1


@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="this system has no hang-up")
def test_a_closed_terminal_leaves_the_robot_to_the_operators_side(link):
    os.kill(link.pid, signal.SIGHUP)
    set_moving(link)


def test_a_robot_process_that_is_killed_is_reported(link):
    os.kill(link.pid, getattr(signal, "SIGKILL", signal.SIGTERM))
    refusal(SourceError, "its process has ended", until, lambda: False, link.poll)


@pytest.mark.skipif(sys.platform == "win32", reason="Windows limits no files of a process")
def test_a_recording_that_fails_stops_the_robot_first(tmp_path, capfd):
    import resource

    pytest.importorskip("rosbags", reason="a recording needs the extra ros")
    plan = replace(PLAN, record=tmp_path / "robot.mcap")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    # for the process of the robot, a disk that is full after its first bytes
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, before[1]))
    try:
        made = RobotLink(plan)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    with closing(made):
        made.wait_ready()
        refusal(SourceError, "robot.mcap: cannot be written", set_moving, made, math.inf)
        assert speed(made.state) == 0.0 and made.state.order_seq == -1
    assert capfd.readouterr().err == ""


@pytest.mark.skipif(sys.platform == "win32", reason="Windows removes no file that is open")
def test_a_recording_whose_folder_is_removed_stops_the_robot(tmp_path):
    pytest.importorskip("rosbags", reason="a recording needs the extra ros")
    folder = tmp_path / "recorded"
    folder.mkdir()
    with closing(RobotLink(replace(PLAN, record=folder / "robot.mcap"))) as made:
        made.wait_ready()
        set_moving(made)
        shutil.rmtree(folder)
        refusal(InputError, "robot.mcap: the file is gone", set_moving, made, math.inf)
        assert speed(made.state) == 0.0 and made.state.order_seq == -1


def test_a_robot_that_cannot_be_driven_is_reported_in_one_line():
    with closing(RobotLink(RobotPlan(settings=TeleoperationSettings(), frames=("tool",)))) as made:
        refusal(ConfigError, "no site 'tool'", made.wait_ready)


def teleoperating(demo_session, *options):
    words = command(demo_session, "--deadman", "web", "--elsewhere", *options)
    running = Live(["teleoperate" if word == "live" else word for word in words])
    running.wait_for("READY")
    return running


@pytest.mark.realtime
def test_a_recording_of_the_session_that_is_lost_is_reported_and_a_failure(demo_session, tmp_path):
    folder = tmp_path / "recorded"
    folder.mkdir()
    running = teleoperating(demo_session, "--record", str(folder / "session.mcap"))
    (folder / "session.mcap").unlink()
    running.wait_for("the file is gone")
    running.process.send_signal(signal.SIGINT)
    figures, said = running.ended(1)
    assert figures["failed"] and "warning: record: " in said


@pytest.mark.realtime
def test_ctrl_c_ends_a_session_in_order_and_its_figures_are_printed(demo_session):
    running = teleoperating(demo_session)
    running.process.send_signal(signal.SIGINT)
    figures = running.figures()
    assert figures["stopped_by"] == "SIGINT" and figures["phases"] and not figures["failed"]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ("--command pose", "--command: needs --ros"),
        ("--cmd-vel /cmd_vel", "--cmd-vel: needs --command joints"),
        ("--cmd-vel /cmd_vel --ros --command pose", "--cmd-vel: needs --command joints"),
        ("--cmd-vel-twist --ros --command joints", "--cmd-vel-twist: needs --cmd-vel"),
        ("--controller /arm/commands --ros", "--controller: needs --command joints"),
        ("--base-frame base", "--base-frame: needs --command"),
        ("--view --ros --command pose", "--view: shows the simulated robot; RViz"),
        ("--robot arm.xml --ros --command pose", "--robot: --command pose knows no model"),
        ("--domain 5", "--domain 5: no source and no output is in ROS 2"),
    ],
)
def test_no_option_of_a_robot_is_ignored(options, words, demo_session, capsys):
    rig, source = str(demo_session / "rig.toml"), f"sim:{demo_session}"
    assert cli.main(["teleoperate", rig, "--source", source, "--deadman", "web", *options.split()]) == 1
    out, err = capsys.readouterr()
    assert out == "" and words in err and err.count("\n") == 1
