"""CSV as spreadsheets of any country save it."""

from pathlib import Path

import numpy as np
import pytest
from checks import refusal

from posefuse.core import InputError
from posefuse.evaluation.tracks import read_tracks
from posefuse.formats.named_points import read_points_csv

WIDE = "t_s,Knie_x,Knie_y,Knie_z\n0.0,1.5,2.5,-3.5\n0.1,1.6,,nan\n"
LONG = (
    "t_s,person,keypoint,x_m,y_m,z_m,kind\n"
    "0.0,4,hip,1.5,2,3,fused\n0.0,4,knee,4,5,6,fused\n"
    "0.0,7,hip,9,9,9,fused\n0.5,4,hip,,,,missing\n"
)


def german(text: str) -> str:
    return text.replace(",", ";").replace(".", ",")


@pytest.mark.parametrize(
    "text", [WIDE, german(WIDE), WIDE.replace(",", "\t"), german(WIDE).replace(";", "\t"), "# a comment\n" + WIDE]
)
def test_separators_and_decimals_of_any_country(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.csv").write_text(text)
    data = read_points_csv(tmp_path / "a.csv")
    assert data.names == ("Knie",)
    np.testing.assert_array_equal(data.t_s, [0, 0.1])
    np.testing.assert_array_equal(data.xyz_world, [[[1.5, 2.5, -3.5]], [[1.6, np.nan, np.nan]]])


def test_names_in_utf_8_alone(tmp_path: Path) -> None:
    named = german(WIDE).replace("Knie", "Hüfte")
    (tmp_path / "a.csv").write_bytes(named.encode("utf-8-sig"))
    assert read_points_csv(tmp_path / "a.csv").names == ("Hüfte",)
    (tmp_path / "a.csv").write_bytes(named.encode("latin-1"))
    refusal(InputError, r"a\.csv: cannot be read as text .*; save it as UTF-8", read_points_csv, tmp_path / "a.csv")


@pytest.mark.parametrize("text", [LONG, german(LONG)])
def test_long_tables(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.csv").write_text(text)
    data = read_points_csv(tmp_path / "a.csv")
    assert data.names == ("hip", "knee")
    np.testing.assert_array_equal(data.xyz_world[0], [[1.5, 2, 3], [4, 5, 6]])
    assert np.isnan(data.xyz_world[1]).all()
    np.testing.assert_array_equal(read_points_csv(tmp_path / "a.csv", 7).xyz_world, [[[9, 9, 9]]])


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "expected a header and rows"),
        ("a,b\n1,2\n", "expected columns t_s, NAME_x"),
        (WIDE.replace("1.5", "one"), r"row 2, column Knie_x: expected a number, got 'one'"),
        (WIDE.replace("0.1,", "-0.1,"), "t_s: expected increasing times"),
        (LONG.replace(",4,", ",x,"), "column person: expected a number"),
        (LONG, "no person 5; there are: 4, 7"),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, text: str, problem: str) -> None:
    (tmp_path / "a.csv").write_text(text)
    refusal(InputError, problem, read_points_csv, tmp_path / "a.csv", 5 if text == LONG else None)


def test_tracks_without_any_point_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("t_s,a_x,a_y,a_z\n0,,,\n1,,,\n")
    refusal(InputError, "no point is known at any time", read_tracks, tmp_path / "a.csv")
