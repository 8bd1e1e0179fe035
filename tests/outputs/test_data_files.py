"""Outputs of numbers, each read back by a reader that is not ours where there is one."""

import csv
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import ezc3d
import numpy as np
import pytest
from built import arrays_of
from checks import refusal

from posefuse.core import InputError, Recording
from posefuse.core.poses import evenly_spaced
from posefuse.formats.c3d import read_c3d
from posefuse.formats.trc import read_trc
from posefuse.outputs.data_files import C3dSink, CsvSink, TrcSink

Make = Callable[..., Recording]


def test_trc(tmp_path: Path, make_recording: Make) -> None:
    recording = make_recording(people=(4, 9))
    paths = TrcSink().write(recording, tmp_path)
    assert [path.name for path in paths] == ["pose_person4.trc", "pose_person9.trc"]
    for n, path in enumerate(paths):
        data = read_trc(path)
        assert data.rate_hz == pytest.approx(25)
        np.testing.assert_allclose(data.t_s, recording.poses.t_ns / 1e9, atol=1e-6)
        np.testing.assert_allclose(data.xyz_world, recording.poses.xyz_world[:, n], atol=1e-7)


def test_c3d(tmp_path: Path, make_recording: Make) -> None:
    recording = make_recording()
    [path] = C3dSink().write(recording, tmp_path)
    data = read_c3d(path)
    np.testing.assert_allclose(data.xyz_world, recording.poses.xyz_world[:, 0], atol=1e-6)
    # root of the mean variance of 1, 4, 9 square centimetres
    np.testing.assert_allclose(data.sigma_m[0], np.sqrt(14e-4 / 3), atol=1e-4)
    assert ezc3d.c3d(str(path))["parameters"]["POINT"]["RATE"]["value"][0] == pytest.approx(25)


def test_c3d_refuses_uneven_times(tmp_path: Path, make_recording: Make) -> None:
    recording = make_recording()
    t_ns = recording.poses.t_ns.copy()
    t_ns[3:] += 20_000_000
    poses, observations = replace(recording.poses, t_ns=t_ns), replace(recording.observations, step_t_ns=t_ns)
    uneven = replace(recording, poses=poses, observations=observations)
    refusal(InputError, r"evenly spaced .* 0\.04 to 0\.06 s apart: set rate_hz", lambda: C3dSink().write(uneven, tmp_path))
    assert not list(tmp_path.iterdir())


def test_a_clock_that_was_set_makes_no_day_of_empty_frames(make_recording: Make) -> None:
    poses = make_recording().poses
    t_ns = poses.t_ns + np.where(np.arange(len(poses)) > 3, 86_400 * 10**9, 0)
    refusal(InputError, r"0\.04 to 8\.64e\+04 s apart", evenly_spaced, replace(poses, t_ns=t_ns))


def test_csv_is_tidy(tmp_path: Path, make_recording: Make) -> None:
    recording = make_recording(people=(4, 9))
    [path] = CsvSink().write(recording, tmp_path)
    rows = list(csv.DictReader(path.read_text().splitlines()))
    assert len(rows) == 7 * 2 * 5
    row = rows[(3 * 2 + 1) * 5 + 2]
    assert (row["t_s"], row["person"], row["keypoint"], row["kind"]) == ("2.12", "9", "right_shoulder", "fused")
    np.testing.assert_allclose([float(row[f"{axis}_m"]) for axis in "xyz"], recording.poses.xyz_world[3, 1, 2], atol=5.1e-7)
    numbers = [row[name] for row in rows for name in ("t_s", "x_m", "y_m", "z_m", "sigma_m", "reproj_px")]
    assert len(max(numbers, key=len)) <= len("-10.123456")
    gone = rows[3 * 2 * 5]
    assert (gone["x_m"], gone["sigma_m"], gone["reproj_px"], gone["n_views"], gone["kind"]) == ("", "", "", "0", "missing")


def test_one_time_step_is_enough(tmp_path: Path, make_recording: Make) -> None:
    recording = make_recording(times=1)
    for sink in (TrcSink(), C3dSink(), CsvSink()):
        path, *_ = sink.write(recording, tmp_path)
        assert path.stat().st_size > 0


def test_no_person_at_all(tmp_path: Path, make_recording: Make) -> None:
    full = make_recording()
    empty = replace(full.poses, person_id=[], **arrays_of(full.poses, lambda one: one[:, :0]))
    recording = Recording(rig=full.rig, poses=empty, observations=full.observations)
    assert TrcSink().write(recording, tmp_path) == []
    [path] = CsvSink().write(recording, tmp_path)
    assert len(path.read_text().splitlines()) == 1
