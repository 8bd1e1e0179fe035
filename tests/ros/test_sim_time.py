"""Simulated time against real time, whatever speed the simulator runs at."""

import time

import numpy as np
import pytest
from checks import refusal
from own_domain import own_domain

from posefuse.core import SourceError
from posefuse_ros.sim_time import SimulatedClock

S = 1_000_000_000


def heard(clock, rate, seconds, sim0_ns=0, real0_ns=10**18, jitter_ns=0, every_s=0.01, seed=0):
    rng = np.random.default_rng(seed)
    for i in range(round(seconds / every_s)):
        real_ns = real0_ns + round(i * every_s * S)
        clock.add(sim0_ns + round(i * every_s * S * rate), real_ns + round(rng.uniform(0, jitter_ns)))
    return real0_ns + round(seconds * S)


@pytest.mark.parametrize("rate", [0.1, 0.7, 1.0, 3.0])
def test_both_directions_undo_each_other_at_any_speed(rate):
    clock = SimulatedClock()
    end_ns = heard(clock, rate, 3.0)
    for real_ns in (end_ns - S // 3, end_ns, end_ns + S // 20):
        sim_ns = clock.sim_from_real(real_ns)
        assert sim_ns == pytest.approx((real_ns - 10**18) * rate, abs=2000)
        assert abs(clock.real_from_sim(sim_ns) - real_ns) <= 1000


def test_jitter_of_the_network_is_smoothed():
    clock = SimulatedClock()
    heard(clock, 0.5, 3.0, jitter_ns=4_000_000)
    off_ns = clock.real_from_sim(round(1.45 * S)) - (10**18 + round(2.9 * S))
    # on average a message is 2 ms late; one alone would be up to 4 ms
    assert 1_000_000 < off_ns < 3_000_000


def test_a_change_of_speed_is_followed_within_a_second():
    clock = SimulatedClock()
    end_ns = heard(clock, 1.0, 2.0)
    end_ns = heard(clock, 0.25, 1.2, sim0_ns=2 * S, real0_ns=end_ns)
    assert clock.sim_from_real(end_ns) == pytest.approx(2.3 * S, abs=1e6)


def test_a_simulation_that_pauses_or_restarts_is_followed_immediately():
    clock = SimulatedClock()
    end_ns = heard(clock, 0.5, 2.0)
    clock.add(clock.sim_from_real(end_ns - S // 100), end_ns)
    for i in range(20):
        clock.add(S, end_ns + i * S // 10)
    assert clock.sim_from_real(end_ns + 19 * S // 10) == S
    clock.add(0, end_ns + 2 * S)
    assert clock.restarts == 1
    assert clock.real_from_sim(0) == end_ns + 2 * S


def test_a_node_that_receives_no_clock_reports_it():
    pytest.importorskip("cyclonedds", reason="the extra `ros` is not installed")
    from posefuse_ros.dds import RosNode
    from posefuse_ros.dds_domain import Network
    from posefuse_ros.sim_time import ClockReader
    from posefuse_ros.topics import CLOCK
    from posefuse_ros.types import encode, message

    with RosNode("sim", Network(domain_id=own_domain(), local_only=True)) as node:
        reader = ClockReader(node)
        refusal(SourceError, "nothing came on /clock", reader.wait, 0.05)
        stamp = message("builtin_interfaces/msg/Time", sec=7, nanosec=5)
        raw = encode(message(CLOCK.type_name, clock=stamp))
        for _ in range(200):
            node.writer(CLOCK).write(raw)
            time.sleep(0.02)
            reader.update()
            if reader.clock.known:
                break
        sim_ns = reader.clock.sim_from_real(time.time_ns())
        assert 7 * S <= sim_ns < 9 * S
