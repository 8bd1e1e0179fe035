"""Angle errors, and our angles against a gait laboratory's own."""

import dataclasses

import built
import numpy as np
import pytest

from bench.angle_errors import angle_errors, joints_from_lab, poses_from_lab
from posefuse.core import InputError
from posefuse.kinematics import joints_from_poses


def joints_of(angle_rad, names=("left_knee", "neck"), step_ns=10_000_000):
    kinds = (("flexion", "adduction", "internal_rotation"),) * len(names)
    t_ns, sigma_rad = np.arange(len(angle_rad)) * step_ns, np.full(angle_rad.shape, np.radians(2.0))
    return built.joint_angles(angle_rad, joints=names, t_ns=t_ns, angle_names=kinds, sigma_rad=sigma_rad)


def test_bias_spread_and_rmse_over_whole_turns_and_gaps():
    truth = np.random.default_rng(0).normal(size=(50, 1, 2, 3))
    estimate = truth + np.radians(3.0) + np.radians(4.0) * np.where(np.arange(50) % 2, 1, -1)[:, None, None, None] + 2 * np.pi
    estimate[:10, :, 0, 0] = np.nan
    rows = {(e.joint, e.angle): e for e in angle_errors(joints_of(estimate), joints_of(truth))}
    knee = rows["left_knee", "flexion"]
    assert (knee.bias_deg, knee.sd_deg, knee.rmse_deg) == pytest.approx((3, 4, 5))
    assert knee.defined == pytest.approx(0.8)
    assert knee.stated_deg == pytest.approx(2)
    assert len(rows) == 6


def test_time_steps_are_matched_by_time():
    truth = np.broadcast_to(np.arange(100.0)[:, None, None, None] * 0.01, (100, 1, 2, 3))
    every_second = joints_of(truth[::2], step_ns=20_000_000)
    assert angle_errors(every_second, joints_of(truth))[0].rmse_deg == pytest.approx(0, abs=1e-9)
    later = dataclasses.replace(every_second, t_ns=every_second.t_ns + 10**12)
    with pytest.raises(InputError, match="no time step in common"):
        angle_errors(later, joints_of(truth))


def test_other_joints_and_people_are_refused():
    angle = np.zeros((5, 1, 2, 3))
    with pytest.raises(InputError, match="no angle in common; the reference has jaw, tail"):
        angle_errors(joints_of(angle), joints_of(angle, ("jaw", "tail")))
    with pytest.raises(InputError, match="expected 1 people as in the reference, got 2"):
        angle_errors(joints_of(np.zeros((5, 2, 2, 3))), joints_of(angle))


def test_flexion_agrees_with_a_gait_laboratory(shared_data):
    path = shared_data / "btk" / "FunctionalWalk.c3d"
    rows = {(e.joint, e.angle): e for e in angle_errors(joints_from_poses(poses_from_lab(path)), joints_from_lab(path))}
    for side in ("left", "right"):
        assert rows[f"{side}_knee", "flexion"].sd_deg < 0.5
        assert abs(rows[f"{side}_knee", "flexion"].bias_deg) < 1.0
        assert rows[f"{side}_hip", "flexion"].rmse_deg < 0.1
        assert rows[f"{side}_hip", "adduction"].rmse_deg < 0.1
        assert rows[f"{side}_ankle", "dorsiflexion"].sd_deg < 2.5


def test_a_file_without_the_points_is_refused_with_a_list_of_its_points(tmp_path):
    from posefuse.formats.c3d import C3dData, write_c3d

    write_c3d(
        tmp_path / "a.c3d",
        C3dData(names=("RKNE", "LKNE"), xyz_world=np.zeros((4, 2, 3)), sigma_m=np.zeros((4, 2)), rate_hz=100.0),
    )
    with pytest.raises(InputError, match=r"no point PELP; there are: RKNE, LKNE"):
        poses_from_lab(tmp_path / "a.c3d")
    with pytest.raises(InputError, match="no angles LHipAngles"):
        joints_from_lab(tmp_path / "a.c3d")
