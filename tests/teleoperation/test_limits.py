"""The limits hold whatever the target does, and a motion within them passes unchanged."""

import numpy as np
import pytest
from checks import refusal

from posefuse.core import ConfigError
from posefuse.foundation.settings import settings_from_mapping
from posefuse_teleop.limits import Bounds, Motion, brake, follow, norm
from posefuse_teleop.settings import TeleoperationSettings

DT_S = 0.01
BOUNDS = Bounds(speed=0.5, acceleration=2.5, jerk=60.0, low=(-0.3, -0.2, -0.1), high=(0.3, 0.2, 0.15))
OPEN = Bounds(speed=0.5, acceleration=2.5, jerk=60.0)


def followed(targets, bounds=OPEN, speed=0.5):
    motion, positions = Motion(position=targets[0]), []
    for target in targets:
        motion = follow(motion, target, bounds, speed, DT_S)
        positions.append(motion.position)
    return np.array(positions)


def rates(xyz):
    velocity = np.diff(xyz, axis=0) / DT_S
    return velocity, np.diff(velocity, axis=0) / DT_S


def smooth(speed_mps, period_s=4.0, seconds=10.0):
    t_s = np.arange(0, seconds, DT_S)
    ease = np.clip(t_s / 2, 0, 1) ** 3 * (10 - 15 * np.clip(t_s / 2, 0, 1) + 6 * np.clip(t_s / 2, 0, 1) ** 2)
    reach = speed_mps * period_s / (2 * np.pi)
    return np.stack([reach * ease * np.sin(2 * np.pi * t_s / period_s), 0.2 * reach * ease, 0 * t_s], axis=1)


def test_a_motion_within_the_limits_passes_unchanged():
    targets = smooth(0.3)
    assert np.abs(followed(targets) - targets).max() < 1e-12


@pytest.mark.parametrize("seed", range(6))
def test_random_targets_speed_limits_and_brakes_break_no_limit(seed):
    rng = np.random.default_rng(seed)
    motion, speed, target = Motion(), 0.5, np.zeros(3)
    low, high = np.array(BOUNDS.low), np.array(BOUNDS.high)
    for _ in range(2500):
        if rng.random() < 0.1:
            target = rng.normal(size=3) * 10.0 ** rng.uniform(-3, 1)
        if rng.random() < 0.05:
            speed = rng.uniform(0, 0.5) * (rng.random() < 0.8)
        dt_s = rng.uniform(0.002, 0.02)
        before, left_out = motion, 0
        if rng.random() < 0.2:
            left_out = int(rng.integers(0, 4))
            motion = brake(motion, BOUNDS, dt_s, left_out)
        else:
            motion = follow(motion, target, BOUNDS, speed, dt_s)
        change = np.subtract(motion.velocity, before.velocity)
        assert np.linalg.norm(change) <= BOUNDS.acceleration * (1 + left_out) * dt_s * (1 + 1e-9)
        # a limit that was lowered below the speed is reached by braking on
        assert motion.speed <= max(speed, before.speed - BOUNDS.acceleration * dt_s / np.sqrt(3)) + 1e-9
        assert (low <= motion.position).all() and (motion.position <= high).all()


def test_a_motion_into_a_corner_brakes_on_all_axes_at_once():
    corner = np.array(BOUNDS.high)
    # also where the limit of the speed is lowered on the way
    for then_mps in (0.05, 0.5):
        motion = Motion(position=np.array([-0.2, -0.1, -0.05]))
        for k in range(200):
            motion = follow(motion, 100 * corner, BOUNDS, 0.5 if k < 40 else then_mps, DT_S)
            assert (motion.position <= corner).all()
    assert np.abs(corner - motion.position).max() < 0.1


@pytest.mark.parametrize(("ahead_m", "end_m", "off_m"), [(0.3, 0.3, 1e-3), (0.01, 0.8, 2e-3)], ids=["a jump", "too fast"])
def test_a_jump_and_a_target_that_is_too_fast_are_met_without_overshoot_and_within_the_jerk_limit(ahead_m, end_m, off_m):
    targets = np.zeros((300, 3))
    targets[20:, 0] = np.clip(ahead_m * np.arange(1, 281), 0, end_m)
    xyz = followed(targets)
    velocity, acceleration = rates(xyz)
    jerk = np.diff(acceleration, axis=0) / DT_S
    assert xyz[:, 0].max() < end_m + 0.0005 and abs(xyz[-1, 0] - end_m) < off_m
    assert np.linalg.norm(velocity, axis=1).max() <= 0.5 + 1e-9
    # braking near the target keeps the jerk limit too; the guard of the walls does not come in here
    assert np.abs(jerk).max() <= 60.0 * (1 + 1e-6)


def test_noise_at_rest_is_not_made_larger():
    rng = np.random.default_rng(1)
    noise = 0.002 * rng.normal(size=(1500, 3))
    for k in range(1, len(noise)):
        noise[k] = 0.7 * noise[k - 1] + 0.71 * noise[k]
    assert followed(noise).std(axis=0).max() < noise.std(axis=0).max()


def test_turned_axes_change_nothing_without_walls():
    rng = np.random.default_rng(2)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    targets = np.cumsum(0.01 * rng.normal(size=(400, 3)), axis=0)
    assert np.abs(followed(targets @ turn.T) - followed(targets) @ turn.T).max() < 1e-9


@pytest.mark.parametrize("left_out", (0, 1, 4))
def test_braking_takes_the_time_that_the_acceleration_needs_and_a_late_process_no_longer(left_out):
    motion, periods = Motion(velocity=np.array([0.3, 0.4, 0.0])), 0
    while motion.speed > 1e-9:
        motion, periods = brake(motion, OPEN, DT_S, left_out), periods + 1 + left_out
    assert periods == 20 and norm(motion.position) <= 0.5**2 / (2 * 2.5)


@pytest.mark.parametrize("velocity", [(0.3, 0.3, 0.3), (-0.3, 0.3, -0.3), (0.3, 0.2, 0.0)])
def test_braking_beyond_a_wall_is_computed_without_a_warning(velocity):
    """All axes are braked alike there, so none has a way left to a lower speed."""
    bounds = Bounds(speed=0.5, acceleration=1.0, jerk=1e3, low=(-0.1,) * 3, high=(0.1,) * 3)
    motion = Motion(position=np.sign(velocity) * 0.2, velocity=np.array(velocity))
    with np.errstate(all="raise"):
        braked = brake(motion, bounds, 0.01)
    assert braked.speed < motion.speed


@pytest.mark.parametrize(
    ("part", "key", "in_thousandths"),
    [("limits", "speed_mps", 250), ("limits", "base_speed_mps", 300), ("robot", "watchdog_s", 60), ("gate", "pose_age_s", 120)],
)
def test_a_limit_that_is_meant_in_mm_or_ms_is_refused(part, key, in_thousandths):
    def made(value):
        return settings_from_mapping({part: {key: value}}, TeleoperationSettings, where="limits.toml")

    assert getattr(getattr(made(in_thousandths / 1000), part), key) == in_thousandths / 1000
    refusal(ConfigError, rf"{key}.*less than or equal", made, in_thousandths)
