"""TRC: round trips, real files of others, and files that are wrong."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from checks import assert_same, refusal
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from posefuse.core import InputError, ShapeError
from posefuse.formats.trc import METRES, TrcData, read_trc, write_trc

GOLDEN = Path(__file__).resolve().parents[1] / "golden" / "files" / "pose.trc"


def some_points(times: int = 5, markers: int = 3, seed: int = 0) -> TrcData:
    rng = np.random.default_rng(seed)
    xyz = rng.normal(size=(times, markers, 3)) * [1, 2, 3]
    xyz[times // 2, 0] = np.nan
    names = tuple(f"marker {k}" for k in range(markers))
    return TrcData(names=names, t_s=np.arange(times) / 120 + 0.5, xyz_world=xyz, rate_hz=120.0)


@given(times=st.integers(1, 6), markers=st.integers(1, 12), seed=st.integers(0, 10**6), units=st.sampled_from(["m", "cm", "mm"]))
@hypothesis_settings(max_examples=30, deadline=None)
def test_round_trip(tmp_path_factory: pytest.TempPathFactory, times: int, markers: int, seed: int, units: str) -> None:
    data = some_points(times, markers, seed)
    path = tmp_path_factory.mktemp("trc") / "a.trc"
    write_trc(path, replace(data, xyz_world=data.xyz_world / METRES[units]))
    path.write_text(path.read_text().replace("\tm\t", f"\t{units}\t", 1))
    assert_same(read_trc(path), data, atol=1e-6)


def test_the_header_is_opensims(tmp_path: Path) -> None:
    write_trc(tmp_path / "a.trc", some_points())
    lines = (tmp_path / "a.trc").read_text().splitlines()
    assert lines[0] == "PathFileType\t4\t(X/Y/Z)\ta.trc"
    assert lines[2].split("\t") == ["120", "120", "5", "3", "m", "120", "1", "5"]
    assert lines[3] == "Frame#\tTime\tmarker 0\t\t\tmarker 1\t\t\tmarker 2\t\t"
    assert lines[4] == "\t\tX1\tY1\tZ1\tX2\tY2\tZ2\tX3\tY3\tZ3"
    assert lines[5] == ""
    assert lines[8].split("\t")[2:5] == ["nan", "nan", "nan"]


def test_real_references(shared_data: Path, tmp_path: Path) -> None:
    files = sorted((shared_data / "pose2sim_single" / "reference").glob("*.trc"))
    assert len(files) == 3
    for path in files:
        data = read_trc(path)
        assert data.rate_hz == 60
        assert data.xyz_world.shape == (100, len(data.names), 3)
        heights = data.xyz_world[:, data.names.index("Nose"), 2]
        assert 1.0 < heights.min() < heights.max() < 2.0
        write_trc(tmp_path / "a.trc", data)
        np.testing.assert_allclose(read_trc(tmp_path / "a.trc").xyz_world, data.xyz_world, atol=1e-7)


def test_golden() -> None:
    data = read_trc(GOLDEN)
    assert data.names == ("left_hip", "right_hip")
    np.testing.assert_array_equal(data.xyz_world[2, 1], [1.875, 2.0, 2.125])
    assert np.isnan(data.xyz_world[1, 0]).all()


def test_tabs_of_other_writers(tmp_path: Path) -> None:
    write_trc(tmp_path / "a.trc", some_points())
    lines = (tmp_path / "a.trc").read_text().splitlines()
    odd = [*lines[:3], lines[3] + "\t\t\t", lines[4] + "\t", *[line + "\t\t" for line in lines[6:]], "", ""]
    (tmp_path / "b.trc").write_bytes("\r\n".join(odd).encode())
    np.testing.assert_array_equal(read_trc(tmp_path / "b.trc").xyz_world, read_trc(tmp_path / "a.trc").xyz_world)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("PathFileType", "Path", "not a TRC file"),
        ("\tm\t", "\tinch\t", "line 3: Units: expected one of m, mm, cm, got 'inch'; correct it in the file"),
        ("DataRate", "Rate", "line 2: DataRate is missing"),
        ("\t3\tm", "\t4\tm", "line 4: expected NumMarkers = 4 names, got 3"),
        ("\n120\t", "\nfast\t", "DataRate: expected a number of Hz > 0, got 'fast'"),
        ("\n2\t", "\n2\tx", "line 8: could not convert"),
        ("\n2\t", "\n2\t1\t1\t", "line 8: expected 11 cells, got 13"),
        ("\n2\t0.508333", "\n2\t", "line 8: expected a time, got ''"),
    ],
)
def test_bad_files(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = tmp_path / "a.trc"
    write_trc(path, some_points())
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    line = refusal(InputError, message, read_trc, path)
    assert str(path) in line


@pytest.mark.parametrize(("true", "stated"), [("mm", "m"), ("m", "mm")])
def test_units_that_cannot_be(tmp_path: Path, true: str, stated: str) -> None:
    path, data = tmp_path / "a.trc", some_points()
    write_trc(path, replace(data, xyz_world=data.xyz_world / METRES[true]))
    text = path.read_text()
    path.write_text(text.replace("\tm\t", f"\t{stated}\t", 1))
    refusal(InputError, rf"line 3: Units {stated} give .* to {true} perhaps", read_trc, path)
    path.write_text(text.replace("\tm\t", f"\t{true}\t", 1))
    assert_same(read_trc(path), data, atol=1e-6)


def test_names_and_shapes(tmp_path: Path) -> None:
    one = {"t_s": np.zeros(1), "xyz_world": np.zeros((1, 1, 3)), "rate_hz": 60.0}
    refusal(ShapeError, "2 names for 1 points", TrcData, names=("a", "b"), **one)
    refusal(InputError, "must not be empty or hold tabs", write_trc, tmp_path / "a.trc", TrcData(names=("a\tb",), **one))
    assert not list(tmp_path.iterdir())
