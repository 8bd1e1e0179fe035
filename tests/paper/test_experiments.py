"""Experiments and comparisons as a user runs them."""

import json
from pathlib import Path

import numpy as np
import pytest
from checks import refusal
from commands import error, figures, tracked

from posefuse.core import InputError
from posefuse.evaluation.tracks import plain_name, read_tracks
from posefuse.formats.trc import TrcData, write_trc

NAMES = ("RShoulder", "LShoulder", "RWrist", "LWrist")


@pytest.mark.parametrize(
    ("theirs", "ours"),
    [
        ("RShoulder", "right_shoulder"), ("LBigToe", "left_big_toe"), ("jRightHip", "right_hip"), ("right hip", "right_hip"),
        ("Hip", "mid_hip"), ("left_foot_index", "left_big_toe"), ("model:LKnee", "left_knee"), ("ankle.left", "left_ankle"),
        ("Neck", "neck"),
    ],
)  # fmt: skip
def test_names_of_other_systems_are_understood(theirs: str, ours: str) -> None:
    assert plain_name(theirs) == ours


@pytest.fixture
def trc(tmp_path: Path) -> Path:
    t_s = np.arange(120) / 60
    xyz = np.random.default_rng(0).normal(size=(1, 4, 3)) + 0.3 * np.sin(3 * t_s[:, None, None] + np.arange(12).reshape(4, 3))
    write_trc(tmp_path / "a.trc", TrcData(names=NAMES, t_s=t_s, xyz_world=xyz, rate_hz=60.0))
    return tmp_path / "a.trc"


def test_a_file_compared_with_its_delayed_copy_of_another_kind(trc: Path, capsys, read_page) -> None:
    a = read_tracks(trc)
    assert "neck" in a.points and "mid_hip" not in a.points
    csv = trc.with_name("b.csv")
    lines = ["t_s," + ",".join(f"{name}_{axis}" for name in NAMES for axis in "xyz")]
    lines += [f"{t + 0.1:.6f}," + ",".join(f"{v:.7f}" for v in row[:4].ravel()) for t, row in zip(a.t_s, a.xyz_m, strict=True)]
    csv.write_text("\n".join(lines) + "\n")
    found = figures(capsys, "compare", trc, csv, "--out", trc.parent / "out")
    assert found["offset_s"] == pytest.approx(-0.1, abs=5e-4)
    assert found["mean_mm"] < 0.5
    assert json.loads((trc.parent / "out" / "compare.json").read_text())["mean_mm"] == found["mean_mm"]
    page = read_page(trc.parent / "out" / "compare.html")
    assert page.headings[0] == "b.csv compared with a.trc" and "right shoulder" in page.tables[1][-1] + page.tables[1][1]
    [one, other] = page.plot("right shoulder, x")["series"]
    np.testing.assert_allclose(one["y"][1:-1], other["y"][1:-1], atol=0.005)


def test_a_result_is_the_same_as_each_of_its_files(demo_session, tmp_path, capsys) -> None:
    result = tracked(demo_session, tmp_path / "result", "trc,c3d,csv", 1.0)
    for kind in ("trc", "c3d", "csv"):
        [file] = result.glob(f"*.{kind}")
        found = figures(capsys, "compare", result, file)
        assert found["mean_mm"] < 0.01 and abs(found["offset_s"]) < 1e-4 and len(found["points"]) > 12


def test_mvnx_segments_become_joints(tmp_path: Path) -> None:
    labels = ("Pelvis", "RightUpperLeg", "RightLowerLeg", "T8")
    places = [" ".join(str(i + j) for j in range(12)) for i in range(3)]
    frames = "".join(f'<frame time="{10 * i}" type="normal"><position>{one}</position></frame>' for i, one in enumerate(places))
    segments = "".join(f'<segment label="{label}" id="{i + 1}"/>' for i, label in enumerate(labels))
    path = tmp_path / "suit.mvnx"
    identity = '<frame type="identity"><position>0</position></frame>'
    body = f"<subject><segments>{segments}</segments><frames>{identity}{frames}</frames></subject>"
    path.write_text(f'<mvnx xmlns="http://www.xsens.com/mvn/mvnx">{body}</mvnx>')
    tracks = read_tracks(path)
    assert tracks.points == ("mid_hip", "right_hip", "right_knee")
    np.testing.assert_allclose(tracks.t_s, [0, 0.01, 0.02])
    np.testing.assert_allclose(tracks.xyz_m[1, 1], [4, 5, 6])
    path.write_text("<mvnx>")
    refusal(InputError, r"suit\.mvnx: not an MVNX file", read_tracks, path)


def test_what_cannot_be_compared_is_reported_in_one_line(trc: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other = trc.with_suffix(".xyz")
    other.write_text("?")
    assert "expected a posefuse result folder" in error(capsys, "compare", trc, other)
    assert "no such file" in error(capsys, "compare", trc, trc.with_name("none.trc"))
