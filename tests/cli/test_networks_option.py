"""`--networks` on every command that has it: a bundled network's name, or a model card."""

from pathlib import Path
from typing import Any

import pytest

from posefuse.api.outcome import network_shown
from posefuse.cli.command_line import parse
from posefuse.cli.main import main
from posefuse.detection.build import DetectorChoice
from posefuse.pipeline.config import TrackConfig, read_changed


def changes_of(*words: str) -> dict[str, Any]:
    found = parse(["live", "rig.toml", *words])
    assert found is not None
    found.bound.apply_defaults()
    changes: dict[str, Any] = found.bound.arguments["settings"].changes
    return changes


def test_a_name_or_an_ensemble_stays_with_the_default_detector_and_does_not_come_back(tmp_path: Path) -> None:
    (tmp_path / "both.toml").write_text('kind = "landmark_ensemble"\n')
    for name in ("blazepose_lite", str(tmp_path / "both.toml")):
        assert changes_of("--networks", name) == {"detector.options.landmarks": name}
    assert changes_of() == {}


def test_a_card_of_the_user_chooses_the_plug_in_for_it(tmp_path: Path) -> None:
    card = tmp_path / "mine.toml"
    card.write_text('kind = "simcc"\n')
    changes = changes_of("--set", "raw=true", "--networks", str(card), "--set", "detector.options.device=cuda")
    config = read_changed(None, changes, TrackConfig)
    assert config.raw and config.detector.name == "onnx"
    assert config.detector.options == {"card": str(card), "device": "cuda"}


def test_the_result_names_the_network_that_was_used() -> None:
    shown = [network_shown(DetectorChoice(options=options)) for options in ({}, {"landmarks": "blazepose_lite"})]
    assert shown == ["blazepose_full", "blazepose_lite"]
    assert network_shown(DetectorChoice(name="onnx", options={"card": "mine.toml"})) == "mine.toml"
    assert network_shown(DetectorChoice(name="oracle", options={"truth": "truth.npz"})) == "oracle"


@pytest.mark.parametrize(
    "command",
    ["track S --out R", "live rig.toml", "node camera rig.toml", "calibrate person a=a --intrinsics i --out o"],
)
def test_a_card_that_is_missing_is_one_line(command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*command.split(), "--networks", str(tmp_path / "absent.toml")]) == 1
    error = capsys.readouterr().err.strip()
    assert "absent.toml" in error and "\n" not in error
