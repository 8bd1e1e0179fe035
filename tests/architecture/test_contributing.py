"""What CONTRIBUTING.md shows how to add is added, by its own blocks, and works."""

import re
from pathlib import Path

import numpy as np
import pytest

from bench.faults.verdict import RIGHT, verdict
from posefuse.core import SKELETONS

PAGE = Path(__file__).resolve().parents[2] / "CONTRIBUTING.md"


def block(part: str) -> dict[str, object]:
    """The names of the first Python block under a heading."""
    text = PAGE.read_text(encoding="utf-8").partition(f"### {part}\n")[2]
    [code] = re.findall(r"^```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL)[:1]
    names: dict[str, object] = {"__name__": "contributing"}
    exec(compile(code, f"{PAGE.name}, {part}", "exec"), names)
    return names


@pytest.mark.parametrize("seed", [0, 3])
def test_the_fault_of_a_calibration_is_refused_by_its_name(seed: int) -> None:
    case = block("A fault of a calibration")["CASE"]
    assert verdict(case, case.run(seed)) == RIGHT


def test_the_fault_is_what_is_refused() -> None:
    from bench.faults.file_cases import read_as_session
    from bench.faults.sessions import ring

    assert not read_as_session(ring(4, 0), lambda text: text).refused


def test_the_motion_bows_and_keeps_its_feet(monkeypatch: pytest.MonkeyPatch) -> None:
    from posefuse_sim.body import BodyShapeSettings, build_body
    from posefuse_sim.build import build_person
    from posefuse_sim.motion import standing
    from posefuse_sim.motion.settings import StandSettings

    monkeypatch.setitem(standing._STANCES, "bow", block("A motion")["bow"])
    monkeypatch.setitem(standing._USUAL_PERIOD_S, "bow", 4.0)
    person = build_person(build_body(BodyShapeSettings()), StandSettings(kind="bow"), 0)
    keypoints = person.at([0.0, 2.0]).keypoints_world
    moved = keypoints[1] - keypoints[0]
    nose, *ankles = (moved[SKELETONS["anatomical23"].index(name)] for name in ("nose", "left_ankle", "right_ankle"))
    assert np.allclose(ankles, 0)
    # heading 0 is along +X
    assert nose[2] < -0.1 and nose[0] > 0.2
