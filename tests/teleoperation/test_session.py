"""The operator's loop with a robot that only answers."""

from dataclasses import replace

from bench.rehearsal.robots import ExactRobot
from posefuse_teleop.session import run_control_loop
from posefuse_teleop.settings import TeleoperationSettings
from posefuse_teleop.switches import Pressed

MS = 1_000_000
STILL = ExactRobot([0.0, 0.0, 0.0]).state()


class NoPoses:
    """A live session without people that ends when the robot has answered."""

    def __init__(self, robot):
        self._robot = robot

    @property
    def ended(self):
        return not self._robot.left

    def wait_newer(self, t_ns, timeout_s):
        pass

    def newest(self):
        return None


class NeverPressed:
    hint = ""

    def poll(self, now_ns, view):
        return Pressed()

    def close(self):
        pass


class Answers:
    """A robot that answers one state after the other, whatever it receives."""

    def __init__(self, *states):
        self.left, self.state = list(states), None

    def poll(self):
        self.state = self.left.pop(0)
        return self.state

    def send(self, order):
        pass


def latencies(*states):
    robot = Answers(*states)
    return list(run_control_loop(NoPoses(robot), NeverPressed(), robot, TeleoperationSettings()).latency_ms)


def state(sent_ms, image_ms, limited=""):
    return replace(STILL, sent_ns=sent_ms * MS, order_measured_ns=image_ms * MS, limited=limited)


def test_the_latency_of_an_image_is_that_of_the_first_command_that_used_it():
    assert latencies(state(130, 100), state(140, 100), state(165, 133), state(170, 133)) == [30.0, 32.0]


def test_an_image_that_was_new_while_the_robot_held_has_no_latency():
    assert latencies(state(130, 100, "hold"), state(300, 100), state(330, 300)) == [30.0]
