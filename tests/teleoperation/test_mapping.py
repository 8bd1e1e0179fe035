"""The clutch: no step when it engages, no wind-up, displacement to scale."""

import numpy as np
import pytest

from posefuse.core.se3 import SE3, wxyz_from_rotvec
from posefuse_teleop.mapping import engaged, moved, rotvec_between
from posefuse_teleop.settings import LimitSettings, MappingSettings

ROBOT_XYZ, ROBOT_WXYZ = np.array([[1.0, 0.5, 0.7]]), wxyz_from_rotvec(np.array([[0.3, -0.2, 0.4]]))
HAND, FOREARM = np.array([[0.3, -0.2, 1.1]]), SE3.from_rotvec([0.2, 0.1, -0.3], np.zeros(3)).matrix()[None]
FREE, ENGAGED = LimitSettings(), engaged(HAND, FOREARM, ROBOT_XYZ, ROBOT_WXYZ)


def stepped(clutch, hand, rotation=FOREARM, robot=ROBOT_XYZ, limits=FREE, **mapping):
    settings = MappingSettings(**{"lead_m": 10.0, **mapping})
    return moved(clutch, hand, rotation, robot, ROBOT_WXYZ, mapping=settings, limits=limits)


@pytest.mark.parametrize("scale", [0.01, 0.5, 1.0, 3.0, 10.0])
@pytest.mark.parametrize("orientation", ["none", "forearm"])
def test_engaging_moves_nothing_at_any_scale(scale, orientation):
    clutch = stepped(ENGAGED, HAND, scale=scale, orientation=orientation)
    assert np.abs(clutch.xyz - ROBOT_XYZ).max() < 1e-15
    assert np.linalg.norm(rotvec_between(ROBOT_WXYZ[0], clutch.wxyz[0])) < 1e-9


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


def test_the_end_effector_turns_as_the_forearm_does():
    turn = np.array([0.1, -0.2, 0.15])
    rotation = SE3.from_rotvec(turn, np.zeros(3)).matrix()[None] @ FOREARM
    clutch = stepped(ENGAGED, HAND, rotation, orientation="forearm")
    assert rotvec_between(ROBOT_WXYZ[0], clutch.wxyz[0]) == pytest.approx(turn, abs=1e-9)
    assert np.array_equal(stepped(clutch, HAND, rotation).wxyz, clutch.wxyz)


def test_a_forearm_that_becomes_known_late_turns_nothing_at_first():
    missing = np.full((1, 3, 3), np.nan)
    clutch = engaged(HAND, missing, ROBOT_XYZ, ROBOT_WXYZ)
    for rotation in (missing, FOREARM, missing, FOREARM):
        clutch = stepped(clutch, HAND, rotation, orientation="forearm")
        assert np.linalg.norm(rotvec_between(ROBOT_WXYZ[0], clutch.wxyz[0])) < 1e-9


def test_two_hands_do_not_touch_each_other():
    hands, forearms, *robots = (np.vstack([one] * 2) for one in (HAND, FOREARM, ROBOT_XYZ, ROBOT_WXYZ))
    both = engaged(hands, forearms, *robots)
    after = moved(both, hands + [[0.0], [0.1]], forearms, both.xyz, both.wxyz, mapping=MappingSettings(lead_m=1.0), limits=FREE)
    assert np.array_equal(after.xyz[0], ROBOT_XYZ[0]) and after.xyz[1] == pytest.approx(ROBOT_XYZ[0] + 0.1)
