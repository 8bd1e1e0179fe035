"""The robot's side stops by itself, and hears only what is new, whole and in time."""

from dataclasses import replace
from types import SimpleNamespace

import commanded
import numpy as np
import pytest

from bench.rehearsal.robots import ExactRobot
from posefuse.core import SourceError
from posefuse_teleop.follower import Driver
from posefuse_teleop.gate import Pressed
from posefuse_teleop.session import run_control_loop
from posefuse_teleop.settings import TeleoperationSettings
from posefuse_teleop.values import Phase

SETTINGS = TeleoperationSettings()
TICK_NS = 10_000_000


def order(seq, now_ns, x=1.0, **changes):
    return replace(commanded.order(seq, now_ns, np.array([[x, 0.0, 0.8]]), np.array([[1.0, 0, 0, 0]])), **changes)


def moving(steps=60):
    driver, now_ns = Driver(ExactRobot([0.0, 0.0, 0.8]), SETTINGS), 10**12
    for k in range(steps):
        now_ns += TICK_NS
        driver.step([order(k, now_ns)], now_ns)
    assert np.linalg.norm(driver.follower.velocity) == pytest.approx(0.5, abs=1e-6)
    return driver, now_ns, steps


def seconds_to_stand(driver, now_ns, orders=lambda k, now_ns: [], link=True):
    for k in range(100):
        now_ns += TICK_NS
        driver.step(orders(k, now_ns), now_ns, link=link)
        if driver.follower.stands:
            return (k + 1) * 0.01
    return float("inf")


def test_silence_stops_the_robot_within_the_promised_time():
    for link, most_s in ((True, 0.35), (False, 0.25)):
        driver, now_ns, _ = moving()
        assert seconds_to_stand(driver, now_ns, link=link) <= most_s


def test_the_watchdog_counts_from_when_an_order_was_sent():
    """An order that waited in a queue does not keep the robot moving for longer."""
    driver, now_ns, seq = moving()
    now_ns += TICK_NS
    driver.step([order(seq, now_ns - 55_000_000)], now_ns)
    assert not driver.follower.limited
    driver.step([], now_ns + TICK_NS)
    assert driver.follower.limited.startswith("watchdog")


WRONG = {
    "repeated": lambda k, now_ns: order(5, now_ns),
    "old": lambda k, now_ns: order(1000 + k, now_ns - 61_000_000),
    "from the future": lambda k, now_ns: order(1000 + k, now_ns + 3600 * 10**9),
    "NaN": lambda k, now_ns: order(1000 + k, now_ns, x=np.nan),
    "infinite speed": lambda k, now_ns: order(1000 + k, now_ns, speed_mps=np.inf),
    "negative speed": lambda k, now_ns: order(1000 + k, now_ns, speed_mps=-1.0),
    "no rotation": lambda k, now_ns: order(1000 + k, now_ns, wxyz=np.zeros((1, 4))),
    "two hands": lambda k, now_ns: commanded.order(1000 + k, now_ns, np.zeros((2, 3)), np.tile([1.0, 0, 0, 0], (2, 1))),
    "hold": lambda k, now_ns: order(1000 + k, now_ns, phase=Phase.HOLD),
}


@pytest.mark.parametrize("what", WRONG)
def test_orders_that_do_not_count_stop_the_robot(what):
    driver, now_ns, _ = moving()
    assert seconds_to_stand(driver, now_ns, lambda k, t: [WRONG[what](k, t)]) <= 0.35


def test_good_orders_are_followed():
    driver, now_ns, seq = moving()
    assert seconds_to_stand(driver, now_ns, lambda k, t: [order(seq + k, t, x=100.0)]) == float("inf")


def test_the_orientation_turns_within_its_limits():
    driver, now_ns = Driver(ExactRobot([0.0, 0.0, 0.8]), SETTINGS), 10**12
    half = np.array([[np.cos(0.6), 0.0, 0.0, np.sin(0.6)]])
    rates = []
    for k in range(300):
        now_ns += TICK_NS
        driver.step([order(k, now_ns, x=0.0, wxyz=half)], now_ns)
        rates.append(driver.follower.turn_rate[0, 2])
    assert max(rates) <= 1.0 + 1e-9 and np.abs(np.diff(rates)).max() <= 5.0 * 0.01 + 1e-9
    assert np.abs(driver.follower.wxyz - half).max() < 2e-3


# --- the operator's loop with a robot that only answers


MS = 1_000_000
STILL = ExactRobot([0.0, 0.0, 0.0]).state()


def loop(*states, check=lambda: None, **options):
    """(robot, what the operator's loop gives) with a robot that answers these states whatever it receives, and no person."""
    robot = SimpleNamespace(left=list(states), state=None, send=lambda order: None)

    def poll():
        robot.state = robot.left.pop(0)
        return robot.state

    class NoPoses:
        """A live session that ends when the robot has answered."""

        ended = property(lambda _: not robot.left)
        wait_newer = newest = lambda self, *_: None

        def check(self):
            check()

    robot.poll = poll
    never = SimpleNamespace(hint="", poll=lambda now_ns, view: Pressed(), close=lambda: None)
    return robot, run_control_loop(NoPoses(), never, robot, SETTINGS, **options)


def test_a_request_to_end_leaves_the_figures():
    robot, done = loop(state(0, 0), state(0, 0), stopped=["SIGINT"])
    assert (done.stopped_by, done.fault, len(robot.left)) == ("SIGINT", "", 2)


def test_a_session_that_fails_is_a_fault():
    def check():
        raise SourceError("live: the session's process 7 ended by signal SIGKILL")

    assert "SIGKILL" in loop(state(0, 0), check=check)[1].fault


def state(sent_ms, image_ms, limited=""):
    return replace(STILL, sent_ns=sent_ms * MS, order_measured_ns=image_ms * MS, limited=limited)


@pytest.mark.parametrize(
    ("states", "latency_ms"),
    [
        ([state(130, 100), state(140, 100), state(165, 133), state(170, 133)], [30.0, 32.0]),
        ([state(130, 100, "hold"), state(300, 100), state(330, 300)], [30.0]),
    ],
    ids=["of the first command that used an image", "of no image that was new while the robot held"],
)
def test_the_latency_of_an_image(states, latency_ms):
    assert list(loop(*states)[1].latency_ms) == latency_ms
