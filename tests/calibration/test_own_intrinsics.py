"""Intrinsics and extrinsics from one recording of a moving target: near the truth, or refused where it cannot carry them."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from posefuse.api.calibrate import calibrate_extrinsics
from posefuse.calibration.extrinsics.own_intrinsics import in_a_plane, starting_cameras
from posefuse.calibration.report import RefusedCalibration
from posefuse.core import CalibrationError, InputError


@pytest.mark.slow
def test_one_recording_gives_intrinsics_and_poses(lab: Any) -> None:
    seen = lab.watch()
    start = starting_cameras(seen, lab.target)
    assert max(abs(one.K[0, 0] / true.K[0, 0] - 1) for one, true in zip(start, lab.rig, strict=True)) < 0.12
    found = calibrate_extrinsics(seen, target=lab.target, clocks="together")
    for camera in lab.rig:
        assert found.rig[camera.name].K[0, 0] == pytest.approx(camera.K[0, 0], rel=0.003)
    millimetres, degrees = lab.errors(found.rig)
    # with known intrinsics it is 2 mm and 0.03 deg
    assert millimetres.max() < 25
    assert degrees.max() < 0.25


def test_a_recording_that_does_not_carry_them_is_refused_by_name(lab: Any) -> None:
    here = replace(lab.motion, reach_m=(0.25, 0.25, 0.2))
    with pytest.raises(RefusedCalibration, match=r"recording carries the intrinsics: cam00: its image is covered by \d+% "):
        calibrate_extrinsics(lab.watch(motion=here), target=lab.target, clocks="together")
    few = lab.watch()
    few = few.rows((few.camera != 1) | (few.t_ns < np.unique(few.t_ns[few.camera == 1])[3]))
    with pytest.raises(CalibrationError, match=r"camera cam01: \d+ views of the target, its intrinsics need at least 12"):
        calibrate_extrinsics(few, target=lab.target, clocks="together")
    with pytest.raises(InputError, match="needs `intrinsics=FILE` to refine"):
        calibrate_extrinsics(lab.watch(), target=lab.target, focal_known_to_percent=1.0)


def test_corners_of_one_row_of_a_board_are_no_view() -> None:
    grid = np.array([[x, y, 0.0] for y in range(3) for x in range(4)]) * 0.054
    assert in_a_plane(grid) and in_a_plane(grid[[0, 1, 4, 5]])
    assert not in_a_plane(grid[:4]) and not in_a_plane(grid[[0, 5, 10]])
