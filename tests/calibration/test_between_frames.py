"""Corners between the frames of a camera: a marker that turns must not shrink there, or the room comes out too large."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from bench.faults.sessions import scale_of
from bench.faults.waved_props import Faults, Waving, cube, observe_prop
from posefuse.calibration.extrinsics.causes import FrameTimes
from posefuse.calibration.extrinsics.freedoms import camera_moves
from posefuse.calibration.extrinsics.pipeline import Options, RigTask, solve, starting_clocks
from posefuse.calibration.extrinsics.self_checks import check_agreeing
from posefuse.calibration.extrinsics.snapshots import Snapshots, snapshots
from posefuse.calibration.extrinsics.target import calibrate_extrinsics
from posefuse.calibration.geometry import poses_of
from posefuse.calibration.report import LIMITS, RefusedCalibration
from posefuse.calibration.targets.corners import CornerObservations
from posefuse.calibration.targets.kinds import Markers
from posefuse.core import SE3, Rig


def one_corner(stamps_s: np.ndarray, xy: np.ndarray) -> CornerObservations:
    """The track (n, 2) of one corner in one camera."""
    camera = {"cameras": ("cam0",), "sizes_wh": ((640, 480),), "frame_count": (len(stamps_s),)}
    same = dict.fromkeys(("camera", "patch", "corner"), np.zeros(len(stamps_s), np.int64))
    t_ns = np.round(stamps_s * 1e9).astype(np.int64)
    return CornerObservations(**camera, **same, t_ns=t_ns, xy_img=xy)


def read_between(stamps_s: np.ndarray, path: Callable[[np.ndarray], np.ndarray]) -> tuple[np.ndarray, Snapshots]:
    """Times (n,) s all over the track, and what is read there."""
    wanted_s = np.linspace(stamps_s[0], stamps_s[-1], 101)
    seen = one_corner(stamps_s, path(stamps_s))
    return wanted_s, snapshots(seen, np.round(wanted_s * 1e9).astype(np.int64), np.zeros((1, 2)))


@pytest.mark.parametrize(
    "stamps_s", [[0.0, 0.1, 0.2], [0.0, 0.1, 0.22], [0.0, 0.1, 0.3, 0.4, 0.52]], ids=["even", "uneven", "long"]
)
def test_an_accelerated_corner_is_read_exactly_up_to_the_ends_of_its_track(stamps_s: list[float]) -> None:
    start, speed, half = np.array([[300.0, 200.0]]), np.array([[90.0, -40.0]]), np.array([[-400.0, 250.0]])

    def path(t: np.ndarray) -> np.ndarray:
        return start + speed * t[:, None] + half * t[:, None] ** 2

    wanted_s, seen = read_between(np.array(stamps_s), path)
    assert len(seen.xy_img) == len(wanted_s)
    np.testing.assert_allclose(seen.xy_img, path(wanted_s), atol=1e-5)
    np.testing.assert_allclose(seen.velocity_px_s, speed + 2 * half * wanted_s[:, None], atol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_unsynchronised_cameras_make_the_room_no_larger(ring_rig: Callable[..., Rig], seed: int) -> None:
    """Slow cameras and a prop that turns quickly; hardly any noise, so what is left of the scale is what the reading bends."""
    rig = ring_rig(6)
    late_s = np.random.default_rng(seed).uniform(-0.1, 0.1, len(rig))
    motion = Waving(20.0, rate_hz=15.0, seed=seed)
    seen = observe_prop(rig, cube(0.36), Markers(0.27), motion, Faults(noise_px=0.02, seed=seed, delay_s=tuple(late_s)))
    found = calibrate_extrinsics(seen, rig.cameras, Markers(0.27), Options(clocks="offset")).rig
    true, got = (poses_of(one) for one in (rig, found))
    assert scale_of(true, got) == pytest.approx(1.0, abs=1e-4)


# --- frames that are stamped wrongly are found one by one, and their pattern is named


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


@dataclass(frozen=True)
class Hurried(Waving):
    """Held nearly still, waved quickly for six seconds, held again."""

    def pose(self, t_s: np.ndarray) -> SE3:
        return super().pose(np.interp(t_s, [0.0, 9.0, 15.0, 24.0], [0.0, 0.5, 15.0, 15.5]))


@pytest.mark.parametrize("clocks", ["together", "offset"])
def test_corners_sharper_than_stamps_are_right_show_no_camera_that_moved(lab: Any, clocks: str) -> None:
    """The stamps are off by 3 ms: up to 2 px of a corner that is right to 0.05 px."""
    seen = lab.watch(Faults(noise_px=0.05), Hurried(seconds=24.0, rate_hz=15.0))
    frame = np.round(seen.t_ns * 15e-9).astype(int) * len(lab.rig) + seen.camera
    off_ns = np.round(np.random.default_rng(0).normal(0, 3e6, frame.max() + 1)).astype(np.int64)
    task = RigTask(
        replace(seen, t_ns=seen.t_ns + off_ns[frame]), lab.rig.cameras, lab.target, Options(clocks=clocks, time_steps=80)
    )
    solved = solve(task, starting_clocks(task))
    assert solved.solution.sigma_px < 0.1
    assert check_agreeing(solved, LIMITS.agreeing_share, LIMITS.agreeing_parts, "").passed
    assert camera_moves(solved).check.passed


@pytest.mark.slow
def test_a_third_of_a_cameras_frames_stamped_late_does_not_move_the_rig(lab: Any) -> None:
    seen = lab.watch()
    period_ns = round(1e9 / lab.motion.rate_hz)
    late = (seen.camera == 2) & (np.round(seen.t_ns / period_ns).astype(np.int64) % 3 == 0)
    wrong = replace(seen, t_ns=seen.t_ns + np.where(late, period_ns * 19 // 10, 0))
    found = calibrate_extrinsics(wrong, lab.rig.cameras, lab.target, Options(time_steps=100, clocks="together"))
    assert lab.errors(found.rig)[0].max() < 3


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
