"""Clock offsets of cameras on several machines, from what the oracle sees of a walking person."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from posefuse.calibration.clocks.person_tracks import limb_keypoints
from posefuse.core import Truth
from posefuse.core.view_sequences import ViewSequence
from posefuse.detection import OracleNoise, oracle_views
from posefuse.formats.truth import read_truth
from posefuse.health.clock_finding import ClockFinder

MACHINES_S = np.array([0.0, 0.05, 0.0, 0.05])
RATE_HZ = 30.0
Offsets = np.ndarray | Callable[[float], np.ndarray]


@pytest.fixture(scope="module")
def truth(demo_session: Path) -> Truth:
    return read_truth(demo_session / "truth" / "truth.npz")


@pytest.fixture(scope="module")
def views(truth: Truth) -> ViewSequence:
    """As the default network errs: 1.2 px again in every frame, 4 px that stay with a camera and keypoint; and some wild ones."""
    return oracle_views(truth, OracleNoise(sigma_px=1.2, bias_px=4.0, outlier_share=0.03), seed=4)


def fed(
    truth: Truth,
    views: ViewSequence,
    offset_s: np.ndarray | Callable[[float], np.ndarray],
    rate_hz: float,
    seconds: float,
    seed: int,
) -> np.ndarray | None:
    """(C,) s found after some seconds of the clip, played again and again from any moment, with frames lost at random.

    Offsets in s, or what they are at a time in s.
    """
    finder, limbs, rng = ClockFinder(truth.rig), limb_keypoints(truth.skeleton.keypoints), np.random.default_rng(seed)
    frames, found = len(truth.t_ns), None
    begin = int(rng.integers(frames))
    for step in range(round(seconds * RATE_HZ)):
        for c, name in enumerate(truth.rig.names):
            if rng.random() < rate_hz / RATE_HZ:
                f, t_s = (begin + step) % frames, step / RATE_HZ
                t_s += (offset_s(t_s) if callable(offset_s) else offset_s)[c]
                finder.add(name, 10**15 + round(t_s * 1e9), views.xy_img[f, 0, c][limbs], views.score[f, 0, c][limbs])
        if step % 30 == 29:
            found = finder.find() or found
    return found and np.array([found[name] for name in truth.rig.names])


@pytest.mark.parametrize("rate_hz", [30.0, 8.0])
def test_two_machines_clocks_are_found_even_when_most_frames_are_lost(truth: Truth, views: ViewSequence, rate_hz: float) -> None:
    off_ms = []
    for seed in range(3):
        late_s = fed(truth, views, MACHINES_S, rate_hz, 16.0, seed)
        off_ms.append(1000 * (late_s[[1, 3]].mean() - late_s[[0, 2]].mean() - 0.05))
    assert np.abs(off_ms).max() < 5.0


def test_every_camera_has_its_own_and_their_mean_is_zero(truth: Truth, views: ViewSequence) -> None:
    offset_s = np.array([0.0, 0.25, -0.02, 0.13])
    late_s = fed(truth, views, offset_s, RATE_HZ, 16.0, 0)
    np.testing.assert_allclose(late_s, offset_s - offset_s.mean(), atol=0.005)
    assert abs(late_s.mean()) < 1e-6


def test_what_cannot_be_known_is_not_reported(truth: Truth, views: ViewSequence) -> None:
    assert fed(truth, views, MACHINES_S, RATE_HZ, 2.0, 0) is None
    planes = ("xy_img", "score", "sigma_px")
    still = replace(views, **{name: np.broadcast_to(getattr(views, name)[:1], getattr(views, name).shape) for name in planes})
    assert fed(truth, still, MACHINES_S, RATE_HZ, 8.0, 0) is None
    alone = ClockFinder(truth.rig)
    for i in range(100):
        alone.add("cam00", i * 33_000_000, views.xy_img[i, 0, 0], views.score[i, 0, 0])
    assert alone.find() is None


def test_a_clock_that_is_set_is_followed(truth: Truth, views: ViewSequence) -> None:
    late_s = fed(truth, views, lambda t_s: 0.03 * np.eye(4)[2] * (t_s > 20), RATE_HZ, 50.0, 0)
    assert late_s[2] - late_s[[0, 1, 3]].mean() == pytest.approx(0.03, abs=0.012)
