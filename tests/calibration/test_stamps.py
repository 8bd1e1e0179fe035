"""Frames that are stamped wrongly are found one by one, and their pattern is named."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from posefuse.calibration.extrinsics.causes import FrameTimes
from posefuse.calibration.extrinsics.pipeline import Options
from posefuse.calibration.extrinsics.self_checks import camera_differences
from posefuse.calibration.extrinsics.target import calibrate_extrinsics
from posefuse.calibration.report import RefusedCalibration
from posefuse.calibration.solving.rotations import poses_of

PERIOD_S = 1 / 30


def frames(late_periods: np.ndarray, noise_periods: float = 0.0) -> FrameTimes:
    number = np.arange(len(late_periods))
    random = np.random.default_rng(0)
    found_s = (late_periods + noise_periods * random.normal(size=len(number))) * PERIOD_S
    stamps_s = (number + late_periods) * PERIOD_S
    seen = random.random(len(number)) > 0.1
    return FrameTimes(
        "cam02", np.round(stamps_s[seen] * 1e9).astype(np.int64), np.where(number % 17 == 5, np.nan, found_s)[seen], 0.0, PERIOD_S
    )


@pytest.mark.parametrize("length", [2, 3, 8])
def test_stamps_that_are_late_now_and_then_are_irregular(length: int) -> None:
    late = np.where(np.arange(400) % length == 1, 0.9, 0.0)
    said = frames(late, 0.05).story(0)[0]
    assert "time stamps of cam02 are irregular" in said and said.endswith(f"usually {0.9e3 * PERIOD_S:.0f} ms late")
    assert frames(-late, 0.05).story(0)[0].endswith("early")


@pytest.mark.parametrize("most", [1, -1])
def test_stamps_that_are_late_from_a_frame_on_are_a_clock_that_jumps(most: int) -> None:
    """Also where more frames lie after it, which are then the usual ones."""
    late = np.where(np.arange(400) >= 200 + 60 * most, 0.9, 0.0)
    found = frames(late - 0.9 * (most < 0), 0.05)
    assert found.story(0)[0] == f"the clock of cam02 jumps by +{0.9e3 * PERIOD_S:.0f} ms at {(200 + 60 * most) * PERIOD_S:.0f} s"


def test_even_stamps_are_right() -> None:
    assert not frames(np.zeros(400), 0.05).wrong.any()


@pytest.mark.slow
def test_a_third_of_a_cameras_frames_stamped_late_does_not_move_the_rig(lab: Any) -> None:
    seen = lab.watch()
    period_ns = round(1e9 / lab.motion.rate_hz)
    late = (seen.camera == 2) & (np.round(seen.t_ns / period_ns).astype(np.int64) % 3 == 0)
    wrong = replace(seen, t_ns=seen.t_ns + np.where(late, period_ns * 19 // 10, 0))
    found = calibrate_extrinsics(wrong, lab.rig.cameras, lab.target, Options(time_steps=100, clocks="together"))
    true, got = (poses_of(rig) for rig in (lab.rig, found.rig))
    assert camera_differences(true, got)[0].max() < 3e-3


@pytest.mark.slow
@pytest.mark.parametrize("camera", [0, 3])
def test_frames_with_the_time_of_the_next_one_which_is_lost_are_named(lab: Any, camera: int) -> None:
    """A video has no two frames of one time: the second is left out, and half of those that remain are a period late."""
    seen = lab.watch()
    period_ns = round(1e9 / lab.motion.rate_hz)
    number = np.round(seen.t_ns / period_ns).astype(np.int64)
    kept = seen.rows((seen.camera != camera) | (number % 3 != 1))
    first = (kept.camera == camera) & (np.round(kept.t_ns / period_ns).astype(np.int64) % 3 == 0)
    late = replace(kept, t_ns=kept.t_ns + np.where(first, period_ns, 0))
    with pytest.raises(RefusedCalibration, match=f"time stamps of cam0{camera} are irregular"):
        calibrate_extrinsics(late, lab.rig.cameras, lab.target, Options(clocks="auto"))
