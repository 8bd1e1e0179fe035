"""The page of conventions says what the code does."""

import re
from pathlib import Path

from posefuse.kinematics import JOINTS

PAGE = Path(__file__).parents[2] / "docs" / "kinematics.md"


def test_every_joint_is_documented_with_its_sequence_and_angles():
    rows = dict(re.findall(r"^\| (\w+) \|[^|]*\| ([XYZ]-[XYZ]-[XYZ] \| [a-z_, ]+) \|", PAGE.read_text(), re.MULTILINE))
    expected = {
        j.name.removeprefix("left_").removeprefix("right_"): f"{'-'.join(j.sequence)} | {', '.join(j.angle_names)}"
        for j in JOINTS
    }
    assert rows == expected
