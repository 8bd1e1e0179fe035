"""Tables of joint centres: what is written is read again, and a wrong table is refused in one line."""

from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from checks import refusal

from posefuse.core import ConfigError, JointCentres, ShapeError
from posefuse.detection.card import read_card
from posefuse.formats.joint_centres import joint_centres_from_mapping, read_joint_centres
from posefuse_sim.files import joint_centres_text

TABLE = JointCentres(
    made_by="a test",
    offsets={"hip": {"up": -0.02, "outward": 0.0051}, "nose": {"crown": 0.001}},
    lengths={"thigh": 0.4, "shank": 0.39},
    by_length={"hip": {"up": {"thigh": 0.125, "shank": -0.5}}},
)


def test_a_table_is_read_as_it_was_written(tmp_path: Path) -> None:
    path = tmp_path / "table.toml"
    path.write_text(joint_centres_text(TABLE))
    assert read_joint_centres(path) == TABLE
    assert joint_centres_from_mapping(asdict(TABLE), "a result") == TABLE


@pytest.mark.parametrize("card", ["blazepose_lite", "blazepose_full", "blazepose_heavy", "blazepose_best"])
def test_the_tables_of_the_package_are_as_the_fit_writes_them(card: str) -> None:
    path = read_card(card).joint_centres_file
    table = read_joint_centres(path)
    assert joint_centres_text(table) == path.read_text(encoding="utf-8")
    assert table.made_by.startswith(f"{card}, fitted to 40 simulated bodies") and len(table.made_by) < 70


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ('made_by = "x"\n[offsets.tail]\nup = 0.1\n', ["tail", "shoulder", "ankle"]),
        ('made_by = "x"\n[offsets.hip]\nsideways = 0.1\n', ["sideways", "outward", "offsets.hip"]),
        ('made_by = "x"\n[offsets.hip]\nup = "much"\n', ["offsets.hip.up", "much"]),
        ('made_by = "x"\n[offsets]\n[lengths]\nnose = 0.1\n', ["lengths", "nose", "thigh"]),
        ('made_by = "x"\n[offsets.hip]\nup = nan\n', ["offsets.hip.up", "nan"]),
        ('made_by = "x"\n[offsets]\n[slopes.hip.up]\nthigh = 0.1\n', ["slopes", "offsets", "by_length"]),
        ('made_by = "x"\n[offsets]\n[by_length.hip.up]\nthigh = 0.1\n', ["by_length.hip.up", "thigh"]),
    ],
)
def test_a_wrong_table_is_refused_in_one_line(tmp_path: Path, content: str, words: list[str]) -> None:
    path = tmp_path / "wrong.toml"
    path.write_text(content)
    message = refusal(ConfigError, "wrong.toml", read_joint_centres, path)
    assert all(word in message for word in words)


def test_the_value_itself_refuses_what_a_plug_in_may_get_wrong() -> None:
    with pytest.raises(ConfigError, match="offsets: no joint 'left_knee'; there are: shoulder, elbow"):
        JointCentres(made_by="x", offsets={"left_knee": {"thigh": 0.01}})
    wrong: list[dict[str, Any]] = [
        {"offsets": {"knee": {"thigh": np.inf}}},
        {"lengths": {"thigh": np.nan, "shank": 0.4}},
        {"by_length": {"knee": {"thigh": {"thigh": np.nan}}}},
    ]
    for change in wrong:
        refusal(ShapeError, f"{next(iter(change))}: expected finite numbers", replace, TABLE, **change)
    refusal(ShapeError, "offsets: expected an array", JointCentres, made_by="x", offsets={"knee": {"thigh": "a little"}})
