"""Corners between the frames of a camera: a marker that turns must not shrink there, or the room comes out too large."""

from collections.abc import Callable

import numpy as np
import pytest

from bench.faults.waved_props import Faults, Waving, cube, observe_prop
from posefuse.calibration.extrinsics.pipeline import Options
from posefuse.calibration.extrinsics.self_checks import scale_of
from posefuse.calibration.extrinsics.snapshots import Snapshots, snapshots
from posefuse.calibration.extrinsics.target import calibrate_extrinsics
from posefuse.calibration.solving.rotations import poses_of
from posefuse.calibration.targets.corners import CornerObservations
from posefuse.calibration.targets.kinds import Markers
from posefuse.core import Rig


def one_corner(stamps_s: np.ndarray, xy: np.ndarray) -> CornerObservations:
    """The track (n, 2) of one corner in one camera."""
    zeros = np.zeros(len(stamps_s), np.int64)
    return CornerObservations(
        cameras=("cam0",),
        sizes_wh=((640, 480),),
        frame_count=(len(stamps_s),),
        camera=zeros,
        t_ns=np.round(stamps_s * 1e9).astype(np.int64),
        patch=zeros,
        corner=zeros,
        xy_img=xy,
        sharpness=np.full(len(xy), np.nan),
    )


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
