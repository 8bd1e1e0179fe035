"""The gallery scripts run and their claims hold on the bundled clip."""

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest

import posefuse as pf

GALLERY = Path(__file__).resolve().parents[2] / "examples" / "gallery"


def script(name: str) -> ModuleType:
    path = GALLERY / f"{name}.py"
    if "matplotlib" in path.read_text(encoding="utf-8"):
        pytest.importorskip("matplotlib", reason="the extra data is not installed")
    spec = importlib.util.spec_from_file_location(f"gallery_{name}", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_script_has_a_test() -> None:
    named = Path(__file__).read_text(encoding="utf-8")
    assert not [path.stem for path in GALLERY.glob("*.py") if f'script("{path.stem}")' not in named]


def test_knee_angle(demo_session: Path, tmp_path: Path, models: None) -> None:
    script("knee_angle").main(demo_session, tmp_path)
    assert (tmp_path / "knee_angle.png").stat().st_size > 5000


def test_plan_rig_prefers_cameras_around(tmp_path: Path) -> None:
    medians = script("plan_rig").main(tmp_path)
    assert medians["around"] < medians["along a wall"]


def test_own_detector_finds_the_ball(demo_session: Path) -> None:
    assert script("own_detector").main(demo_session) < 3


def test_uncertainty_is_on_the_safe_side(demo_session: Path, tmp_path: Path, models: None) -> None:
    assert 0.9 < script("uncertainty").main(demo_session, tmp_path) <= 1


def test_compare_with_markers(demo_session: Path, tmp_path: Path, models: None) -> None:
    assert script("compare_with_markers").main(demo_session, tmp_path) < 20


@pytest.mark.slow
@pytest.mark.realtime
def test_live_poses(demo_session: Path, models: None) -> None:
    assert script("live_poses").main(demo_session, 3.0) > 20


@pytest.mark.slow
def test_calibrate_from_walk(demo_session: Path, tmp_path: Path, models: None) -> None:
    assert script("calibrate_from_walk").main(demo_session, tmp_path) < 8
    assert len(pf.read_rig(tmp_path / "rig.toml")) == 4


@pytest.mark.slow
def test_two_people_keep_their_ids(tmp_path: Path, models: None) -> None:
    people, seen = script("two_people").main(tmp_path, 3.0)
    assert people == 2
    assert seen > 0.95
