"""Clocks from what moves before known cameras: seconds apart, drifting, and what cannot be determined."""

import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from calibrating import run
from checks import refusal
from scipy.interpolate import CubicSpline
from studies import write_openpose

from posefuse.calibration.clocks.paths import at_times
from posefuse.calibration.clocks.person_tracks import PersonTrack
from posefuse.calibration.clocks.start import rough_clocks, rough_clocks_unplaced
from posefuse.calibration.clocks.sync import ClockEstimate, clocks_from_person, estimate_clocks
from posefuse.calibration.person.views import person_views
from posefuse.calibration.report import RefusedCalibration
from posefuse.core import SKELETONS, InputError, LookKind, Rig
from posefuse.formats.rig import write_rig
from posefuse.foundation.settings import read_settings
from posefuse.health.rig_monitor import RigFinding
from posefuse.pipeline import TrackConfig, find_session
from posefuse.pipeline.opening import open_session
from posefuse.pipeline.solve import finding_line

BODY = SKELETONS["coco17"]
SECONDS = 16.0


def body(t_s: np.ndarray, pace: float = 1.0, seed: int = 5) -> np.ndarray:
    """(T, 17, 3) points of a person who goes about at random and swings what he has."""
    random = np.random.default_rng(seed)
    knots = np.arange(-8.0, SECONDS + 20.0, 1.2)
    way = CubicSpline(knots, random.uniform(-1.2, 1.2, (len(knots), 2)))(pace * t_s)
    middle = np.concatenate([way, np.ones((len(t_s), 1))], axis=1)
    swing = 0.15 * np.sin(5.7 * pace * t_s[:, None] + random.uniform(0, 6, len(BODY)))
    still = np.stack([np.zeros(len(BODY)), random.normal(0, 0.2, len(BODY)), np.linspace(-0.9, 0.6, len(BODY))], axis=1)
    return np.asarray(middle[:, None] + still + swing[..., None] * [1.0, 0.6, 0.2])


def tracks_of(
    rig: Rig, offset_s: Sequence[float], drift: Sequence[float] = (0, 0, 0, 0), rates_hz: Sequence[float] = (15, 15, 15, 15),
    pace: float = 1.0, seconds: float = SECONDS, noise_px: float = 1.5,
) -> tuple[PersonTrack, ...]:  # fmt: skip
    """Every camera begins at another phase; each keypoint has an error of its own that stays."""
    random, tracks = np.random.default_rng(0), []
    for c, camera in enumerate(rig):
        taken = np.arange(round(seconds * rates_hz[c])) / rates_hz[c] + 0.013 * c
        xy = camera.project(body(taken, pace))
        xy = xy + random.normal(0, noise_px, xy.shape) + random.normal(0, 3, xy.shape[1:])
        stamps = (taken + offset_s[c] - drift[c] * SECONDS / 2) / (1 - drift[c])
        every = np.ones(xy.shape[:2])
        tracks.append(PersonTrack(camera.name, BODY, np.round(stamps * 1e9), xy, 0.9 * every, 2 * every))
    return tuple(tracks)


@pytest.fixture(scope="module")
def rig(ring_rig: Callable[..., Rig]) -> Rig:
    return ring_rig(4)


def test_clocks_seconds_apart_of_cameras_of_other_rates_are_found_to_milliseconds(rig: Rig) -> None:
    offset_s = (0.0, 3.7, -0.21, 0.113)
    found = clocks_from_person(rig, tracks_of(rig, offset_s, rates_hz=(15, 25, 12.5, 30)), most_s=5.0)
    np.testing.assert_allclose(found.clocks.offset_s, offset_s, atol=0.003)
    assert (np.abs(found.clocks.offset_s - offset_s) <= 4 * found.clocks.offset_sigma_s).all()
    assert found.clocks.offset_sigma_s[1:].max() < 0.003
    assert found.report.numbers["cam01_offset_ms"] == pytest.approx(3700, abs=3)


@pytest.mark.slow
def test_a_drift_is_found_and_one_that_is_not_asked_for_is_refused(rig: Rig) -> None:
    drift = (0.0, 2e-3, 0.0, -1e-3)
    tracks = tracks_of(rig, (0.0, 0.1, 0.0, 0.0), drift)
    start = ClockEstimate.known(np.zeros(4), SECONDS / 2)
    fit = estimate_clocks(rig, tracks, start, with_drift=True)
    np.testing.assert_allclose(fit.clocks.drift, drift, atol=4e-4)
    assert (np.abs(fit.clocks.drift - drift) <= 4 * fit.clocks.drift_sigma).all()
    with pytest.raises(RefusedCalibration, match=r"parts agree: cam01 runs \+.* ms later after .* try `drift=True`"):
        clocks_from_person(rig, tracks, most_s=1.0)


def test_undetermined_offsets_are_refused_by_name(rig: Rig) -> None:
    good = tracks_of(rig, (0.0, 0.0, 0.0, 0.0))
    blind = replace(good[2], score=0 * good[2].score)
    stranger = replace(good[3], xy_img=rig.cameras[3].project(body(good[3].t_ns / 1e9, seed=9)))
    for tracks, words in (
        (tracks_of(rig, (0.0, 0.0, 0.0, 0.0), pace=0.0), r"one offset fits best: cam0\d fits 1\.0\d times as well"),
        (tracks_of(rig, (0.0, 7.0, 0.0, 0.0)), r"one offset fits best: cam01|cameras are linked.*cam01"),
        ((*good[:2], blind, good[3]), r"person seen: no person found by cam02 \(0 of 240 frames\)"),
        ((*good[:3], stranger), "cam03"),
    ):
        refusal(RefusedCalibration, words, clocks_from_person, rig, tracks, most_s=2.0)


def test_without_a_rig_the_path_over_the_floor_gives_offsets_to_about_a_frame(rig: Rig) -> None:
    offset_s = (0.0, 1.4, -0.5, 0.2)
    tracks = tracks_of(rig, offset_s)
    np.testing.assert_allclose(rough_clocks_unplaced(rig.cameras, tracks, 2.0).offset_s, offset_s, atol=0.1)
    np.testing.assert_allclose(rough_clocks(rig, tracks, 2.0).offset_s, offset_s, atol=0.07)


def test_views_at_found_clocks_lie_where_all_cameras_saw_the_person_at_once(rig: Rig) -> None:
    offset_s = np.array([0.0, 0.4, -0.1, 0.05])
    tracks = tracks_of(rig, offset_s.tolist(), noise_px=0.0)
    views = person_views(tracks, ClockEstimate.known(offset_s, 0.0))
    true = rig.project(body(views.t_ns / 1e9))
    stays = np.nanmedian(views.xy_img - true, axis=1, keepdims=True)
    off = np.linalg.norm(views.xy_img - true - stays, axis=-1)
    assert np.isfinite(off).mean() > 0.9
    assert np.nanquantile(off, 0.95) < 1.0
    assert (views.score[~np.isfinite(off)] == 0).all()


def test_clocks_of_a_session_are_found_written_and_read_by_track(rig: Rig, tmp_path: Path) -> None:
    rate_hz, late_frames = 20.0, (0.0, 7.4, -3.0, 0.5)
    write_rig(tmp_path / "rig.toml", rig)
    for camera, late in zip(rig, late_frames, strict=True):
        people = camera.project(body((np.arange(200) - late) / rate_hz))[:, None]
        write_openpose(tmp_path / "pose2d" / camera.name, dict(enumerate(people[:, : camera.name != "cam03"])))
    refusal(InputError, r"camera cam03: no person", run, "clocks", str(tmp_path), "--rate", "20")
    shutil.rmtree(tmp_path / "pose2d" / "cam03")
    refusal(InputError, "do not state their frame rate", run, "clocks", str(tmp_path))
    figures = run("clocks", str(tmp_path), "--rate", "20", "--most-s", "2")
    assert figures["cam01_offset_ms"] == pytest.approx(370, abs=3)
    assert figures["cam01_offset_sigma_ms"] < 5
    config = read_settings(Path(figures["settings"]), TrackConfig)
    assert config.cameras["cam02"].offset_s == pytest.approx(0.15, abs=0.003)
    session = find_session(tmp_path, replace(config, rate_hz=rate_hz))
    opened = open_session(session, replace(config, rate_hz=rate_hz))
    at = list(opened.steps())[100]
    for c, seen in enumerate(at.look(LookKind.SEARCH, None)):
        true = rig.cameras[c].project(body(np.array([seen.t_ns / 1e9])))
        np.testing.assert_allclose(seen.xy_img, true, atol=1.5)
        assert abs(seen.t_ns - at.t_ns) <= 0.5e9 / rate_hz + 1


def test_a_camera_unsynchronised_is_reported_with_the_command_that_helps() -> None:
    late = RigFinding(kind="unsynchronised", cameras=("cam01",), t_ns=12_000_000_000, detail="cam01 is late", displaced_m=0.1)
    line = finding_line(late, Path("trial"))
    assert line == "at 12.0 s: cam01 is late; `posefuse calibrate clocks trial` finds its offset"
    assert "posefuse" not in finding_line(replace(late, kind="moved"), Path("trial"))


def test_points_are_read_between_frames_but_not_across_gaps() -> None:
    t_s = np.array([0.0, 0.1, 0.2, 0.3, 0.9, 1.0])
    values = np.stack([t_s**2, 3 * t_s], axis=-1)
    got = at_times(t_s, values, np.array([0.1, 0.15, 0.25, 0.6, 1.0, 1.1, -0.01]))
    np.testing.assert_allclose(got[:2], [[0.01, 0.3], [0.0225, 0.45]], atol=1e-12)
    np.testing.assert_array_equal(got[4], values[-1])
    assert np.isnan(got[[3, 5, 6]]).all()
    values[1] = np.nan
    assert np.isfinite(at_times(t_s, values, np.array([0.25]))).all()
    assert np.isnan(at_times(t_s, values, np.array([0.15]))).all()
