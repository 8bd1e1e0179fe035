"""The scale of noise that was not fitted is found from what cameras disagree on, and stated."""

from collections.abc import Callable
from pathlib import Path

import built
import numpy as np
import pytest

from posefuse.core import Observations, Rig
from posefuse.formats.recording import read_recording
from posefuse.fusion import FuseSettings
from posefuse.health import noise_scale as module
from posefuse.pipeline import track
from posefuse.pipeline.track import recorded_noise_scale

STATED_PX = 2.0
SETTINGS = FuseSettings()


def seen(rig: Rig, true_px: float, steps: int, wrong: float = 0.0) -> Observations:
    """A person who glides past, seen with errors of `true_px`; a share of the keypoints is elsewhere."""
    rng = np.random.default_rng(5)
    xyz = built.standing()[None, None] + np.linspace(-0.5, 0.5, steps)[:, None, None, None] * [1, 0.3, 0]
    xy = np.stack([camera.project(xyz) for camera in rig], axis=2)
    xy += true_px * rng.standard_normal(xy.shape)
    elsewhere = rng.random(xy.shape[:-1]) < wrong
    xy[elsewhere] += rng.uniform(-80, 80, (elsewhere.sum(), 2))
    shape = xy.shape[:-1]
    poses = built.poses(xyz, rate_hz=30.0)
    return built.recording_from_views(rig, poses, xy, np.full(shape, 0.9), np.full(shape, STATED_PX)).observations


# two cameras do not show which of them is wrong
@pytest.mark.parametrize(("cameras", "wrong"), [(2, 0.0), (4, 0.0), (4, 0.05), (7, 0.0), (7, 0.05)])
@pytest.mark.parametrize("factor", [0.7, 1.0, 2.0])
def test_the_true_factor_is_found(factor: float, cameras: int, wrong: float, ring_rig: Callable[..., Rig]) -> None:
    rig = ring_rig(cameras)
    assert recorded_noise_scale(seen(rig, factor * STATED_PX, 150, wrong), rig, SETTINGS) == pytest.approx(factor, rel=0.1)


def test_a_long_recording_is_judged_by_a_part_of_it(ring_rig: Callable[..., Rig], monkeypatch: pytest.MonkeyPatch) -> None:
    rig = ring_rig(4)
    monkeypatch.setattr(track, "_NOISE_TIME_STEPS", 50)
    assert recorded_noise_scale(seen(rig, 2 * STATED_PX, 151), rig, SETTINGS) == pytest.approx(2.0, rel=0.1)


def test_it_is_bounded_and_unknown_where_too_little_is_seen(ring_rig: Callable[..., Rig]) -> None:
    rig = ring_rig(4)
    assert recorded_noise_scale(seen(rig, 20.0, 60), rig, SETTINGS) == 3.0
    assert recorded_noise_scale(seen(rig, 0.1, 60), rig, SETTINGS) == 0.5
    # 12 limb joints
    assert recorded_noise_scale(seen(rig, 2.0, 16), rig, SETTINGS) is None
    assert recorded_noise_scale(seen(rig, 2.0, 17), rig, SETTINGS) is not None


def test_track_scales_and_states_it(ring_rig: Callable[..., Rig], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Exact discs by a network without a noise file: as far down as the limit, in the result and in what is stated of it."""
    discs = pytest.importorskip("discs", reason="the package onnx is not installed")
    from posefuse.cli.main import main
    from posefuse.formats.rig import write_rig

    rig = ring_rig(4, size_wh=(720, 560))
    discs.draw(rig, discs.true_xyz(), tmp_path / "session" / "images")
    write_rig(tmp_path / "session" / "rig.toml", rig)
    (tmp_path / "session" / "posefuse.toml").write_text(f"rate_hz = {discs.RATE_HZ}\n")
    card = str(discs.card_of("simcc", tmp_path))
    found = []
    for least in (10_000, 100):
        monkeypatch.setattr(module, "_LEAST_SEEN", least)
        out = tmp_path / f"out{least}"
        assert main(["track", str(tmp_path / "session"), "--out", str(out), "--networks", card, "--outputs", "trc", "--raw"]) == 0
        found.append(read_recording(out))
    before, after = found
    assert before.provenance["network"]["unknown"].startswith("noise not fitted, keypoints")
    assert after.provenance["network"]["unknown"].startswith("noise not fitted; scaled by 0.5 from this recording, keypoints")
    np.testing.assert_allclose(after.observations.sigma_px, before.observations.sigma_px / 2, rtol=1e-5)
    assert np.nanmedian(after.poses.cov_world / before.poses.cov_world) == pytest.approx(0.25, rel=0.1)
