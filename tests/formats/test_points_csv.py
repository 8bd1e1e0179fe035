"""CSV tables of named points, for comparisons with other systems."""

from pathlib import Path

import numpy as np
import pytest
from checks import refusal

from posefuse.core import InputError
from posefuse.evaluation.tracks import read_tracks
from posefuse.formats.named_points import read_points_csv

WIDE = "t_s,Knie_x,Knie_y,Knie_z\n0.0,1.5,2.5,-3.5\n0.1,1.6,,nan\n"


@pytest.mark.parametrize("text", [WIDE, WIDE.replace("t_s", '"t_s"'), WIDE.replace(",,nan", ""), WIDE + "\n\n"])
def test_columns_by_name_and_what_is_missing(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.csv").write_text(text)
    data = read_points_csv(tmp_path / "a.csv")
    assert data.names == ("Knie",)
    np.testing.assert_array_equal(data.t_s, [0, 0.1])
    np.testing.assert_array_equal(data.xyz_world, [[[1.5, 2.5, -3.5]], [[1.6, np.nan, np.nan]]])


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "expected rows of columns t_s, NAME_x"),
        (WIDE.splitlines()[0], "got 1 lines"),
        ("a,b\n1,2\n", "expected rows of columns t_s, NAME_x.*got 2 lines of 'a', 'b'"),
        (WIDE.replace(",", ";").replace(".", ","), "separated by commas"),
        ("t_s,person,keypoint,x_m,y_m,z_m\n0.0,4,hip,1.5,2,3\n", "of a result of posefuse, give its folder"),
        (WIDE.replace("1.5", "one"), "row 2: .*'one'"),
        (WIDE.replace("0.1,", "-0.1,"), "expected increasing times"),
        ("t_s,a_x,a_y,a_z\n0,,,\n1,,,\n", "no point is known at any time"),
    ],
)
def test_other_tables_are_one_line(tmp_path: Path, text: str, problem: str) -> None:
    (tmp_path / "a.csv").write_text(text)
    refusal(InputError, problem, read_tracks, tmp_path / "a.csv")


def test_names_in_utf_8_alone(tmp_path: Path) -> None:
    table = "t_s,Hüfte_x,Hüfte_y,Hüfte_z\n0,1,2,3\n"
    (tmp_path / "a.csv").write_bytes(table.encode("utf-8-sig"))
    assert read_points_csv(tmp_path / "a.csv").names == ("Hüfte",)
    (tmp_path / "a.csv").write_bytes(table.encode("latin-1"))
    refusal(InputError, r"a\.csv: cannot be read as text .*; save it as UTF-8", read_points_csv, tmp_path / "a.csv")
