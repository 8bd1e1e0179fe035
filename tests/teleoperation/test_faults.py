"""Random fault sequences break nothing, and the judge sees it when a guard is taken away."""

from dataclasses import replace

import pytest

from bench.rehearsal.faults import FAULTS, engaged_world, rehearsal_settings, run_many, run_sequence, tick
from posefuse.teleoperation.values import Phase

SETTINGS = rehearsal_settings()
# the full number is a bench: python bench/teleoperation.py faults
SEQUENCES = 40


def test_no_sequence_breaks_a_limit_and_the_robot_moves():
    breaches, moved = run_many(0, SEQUENCES, SETTINGS)
    assert not breaches and moved == SEQUENCES


@pytest.mark.parametrize("sequence", (70348, 85917))
def test_a_robot_process_that_loses_half_of_its_steps_stands_as_soon(sequence):
    """Found by 100,000 sequences: braking step by step took twice as long there."""
    breaches, moved = run_sequence(engaged_world(SETTINGS, sequence % 32), sequence)
    assert moved and not breaches


GUARDS = {
    "separation": {"robot": replace(SETTINGS.robot, shared=False)},
    "watchdog": {"robot": replace(SETTINGS.robot, watchdog_s=100.0)},
    "velocity": {"limits": replace(SETTINGS.limits, speed_mps=0.7)},
    "acceleration": {"limits": replace(SETTINGS.limits, acceleration_mps2=3.0)},
    "box": {"limits": replace(SETTINGS.limits, box_high_m=(2.1, 0.1, 1.1))},
}


@pytest.mark.slow
@pytest.mark.parametrize("guard", GUARDS)
def test_a_guard_that_is_taken_away_is_missed(guard):
    breaches, _ = run_many(0, 250, replace(SETTINGS, **GUARDS[guard]), SETTINGS)
    assert guard in {breach.what.split()[0].rstrip(":") for breach in breaches}


def test_the_judge_sees_limits_that_are_too_wide():
    for guard in ("velocity", "acceleration", "box"):
        breaches, _ = run_many(0, 12, replace(SETTINGS, **GUARDS[guard]), SETTINGS)
        assert guard in {breach.what.split()[0] for breach in breaches}, guard


# these leave enough that is good to continue now and then
SOMETIMES = {"late network", "order not finite", "robot process late", "late heartbeats", "repeated heartbeats"}


@pytest.mark.parametrize("fault", sorted({*FAULTS} - SOMETIMES))
def test_every_fault_that_lasts_ends_engagement(fault):
    world = engaged_world(SETTINGS, 0)
    assert world.operator.gate.phase is Phase.ENGAGED
    phases = set()
    for _ in range(100 if fault == "operator walks" else 40):
        if fault == "gate clock jumps":
            world.clock_ns += 10**10
        tick(world, {fault})
        phases.add(world.operator.gate.phase)
    if fault in ("lost network", "gate stalls"):
        assert world.driver.follower.stands
    else:
        assert phases != {Phase.ENGAGED}
