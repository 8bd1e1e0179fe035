"""Where a person is expected, by the last measurements."""

import numpy as np
import pytest

from posefuse.association.memory import LastSeen

BODY_M_S = np.array([1.0, 0.0, 0.0])
WRIST_M_S = np.array([3.0, -2.0, 0.5])


@pytest.mark.parametrize(("age_s", "by_its_own_speed"), [(0.04, True), (0.1, True), (0.3, False)])
def test_a_keypoint_is_expected_by_its_own_speed_in_the_next_frame_and_later_with_the_body(
    age_s: float, by_its_own_speed: bool
) -> None:
    xyz = np.array([[0.0, 0.0, 1.0], [0.2, 0.3, 1.4]])
    last = LastSeen(person_id=0, t_ns=0, xyz_world=xyz, velocity_m_s=np.stack([BODY_M_S, WRIST_M_S]), body_velocity_m_s=BODY_M_S)
    t_ns = round(age_s * 1e9)
    wrist_m = last.moving_at(t_ns)[1] - xyz[1]
    expected_m = WRIST_M_S * age_s if by_its_own_speed else last.at(t_ns)[1] - xyz[1]
    np.testing.assert_allclose(wrist_m, expected_m)


def test_a_body_continues_at_its_speed_at_first_and_stops_within_a_step() -> None:
    last = LastSeen(person_id=0, t_ns=0, xyz_world=np.zeros((1, 3)), velocity_m_s=BODY_M_S[None], body_velocity_m_s=BODY_M_S)
    np.testing.assert_allclose(last.at(1_000_000)[0], 1e-3 * BODY_M_S, rtol=1e-2)
    assert 0.3 < np.linalg.norm(last.at(10_000_000_000)[0]) < 0.5
    np.testing.assert_array_equal(last.at(-1), last.xyz_world)
