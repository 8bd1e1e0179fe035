"""The clutch: no step when it engages, no wind-up, displacement to scale."""

import numpy as np
import pytest

from posefuse.core.se3 import wxyz_from_rotvec
from posefuse_teleop.mapping import engaged, moved
from posefuse_teleop.settings import LimitSettings, MappingSettings

ROBOT_XYZ, ROBOT_WXYZ = np.array([[1.0, 0.5, 0.7]]), wxyz_from_rotvec(np.array([[0.3, -0.2, 0.4]]))
HAND = np.array([[0.3, -0.2, 1.1]])
FREE, ENGAGED = LimitSettings(), engaged(HAND, ROBOT_XYZ, ROBOT_WXYZ)


def stepped(clutch, hand, limits=FREE, **mapping):
    return moved(clutch, hand, ROBOT_XYZ, MappingSettings(**{"lead_m": 10.0, **mapping}), limits)


@pytest.mark.parametrize("scale", [0.01, 0.5, 1.0, 3.0, 10.0])
def test_engaging_moves_nothing_at_any_scale(scale):
    clutch = stepped(ENGAGED, HAND, scale=scale)
    assert np.abs(clutch.xyz - ROBOT_XYZ).max() < 1e-15
    assert np.array_equal(clutch.wxyz, ROBOT_WXYZ)


def test_the_orientation_stays_that_of_the_robot():
    assert np.array_equal(stepped(ENGAGED, HAND + [0.3, -0.2, 0.1], turn_deg=90.0).wxyz, ROBOT_WXYZ)


def test_the_displacement_counts_to_scale_and_turned_about_the_vertical():
    move = np.array([[0.1, 0.02, -0.05]])
    clutch = stepped(ENGAGED, HAND + move, scale=0.5, turn_deg=90.0)
    assert clutch.xyz - ROBOT_XYZ == pytest.approx(np.array([[-0.01, 0.05, -0.025]]), abs=1e-12)


def test_a_wall_holds_the_target_and_winds_nothing_up():
    limits = LimitSettings(box_low_m=(0.0, 0.0, 0.0), box_high_m=(1.2, 1.0, 1.0))
    clutch = ENGAGED
    for far in (0.1, 0.5, 0.9):
        clutch = stepped(clutch, HAND + [far, 0.0, 0.0], limits=limits)
        assert clutch.xyz[0, 0] <= 1.2
    # it follows at once when the hand turns round
    back = stepped(clutch, HAND + [0.85, 0.0, 0.0], limits=limits)
    assert back.xyz[0, 0] == pytest.approx(1.15)


def test_the_target_does_not_run_away_from_a_robot_that_is_slow():
    clutch = stepped(ENGAGED, HAND + [1.0, 0, 0], lead_m=0.15)
    assert np.linalg.norm(clutch.xyz - ROBOT_XYZ) == pytest.approx(0.15)
    assert stepped(clutch, HAND + [0.9, 0, 0], lead_m=0.15).xyz[0, 0] == pytest.approx(1.05)


def test_a_robot_outside_of_the_box_is_not_pulled_in_by_engaging():
    limits = LimitSettings(box_low_m=(0.0, 0.0, 0.0), box_high_m=(0.9, 1.0, 1.0))
    assert np.array_equal(stepped(ENGAGED, HAND, limits=limits).xyz, ROBOT_XYZ)


def test_two_hands_do_not_touch_each_other():
    hands, *robots = (np.vstack([one] * 2) for one in (HAND, ROBOT_XYZ, ROBOT_WXYZ))
    both = engaged(hands, *robots)
    after = moved(both, hands + [[0.0], [0.1]], both.xyz, MappingSettings(lead_m=1.0), FREE)
    assert np.array_equal(after.xyz[0], ROBOT_XYZ[0]) and after.xyz[1] == pytest.approx(ROBOT_XYZ[0] + 0.1)
