"""`--networks` on every command that has it: a bundled network's name, or a model card."""

import argparse
from pathlib import Path

import pytest

from posefuse.cli.commands.options import add_networks
from posefuse.cli.main import main
from posefuse.pipeline.config import TrackConfig, read_overridden


@pytest.fixture
def parse():
    parser = argparse.ArgumentParser(exit_on_error=False)
    parser.add_argument("--set", dest="overrides", action="append", default=[])
    add_networks(parser)
    return lambda *words: parser.parse_args(list(words)).overrides


def test_a_name_chooses_a_bundled_network(parse) -> None:
    config = read_overridden(None, parse("--networks", "blazepose_lite"), TrackConfig)
    assert (config.detector.name, config.detector.options) == ("blazepose", {"landmarks": "blazepose_lite"})


def test_a_card_of_the_user_chooses_the_plug_in_for_it(parse, tmp_path: Path) -> None:
    card = tmp_path / "mine.toml"
    card.write_text('kind = "simcc"\n')
    overrides = parse("--set", "raw=true", "--networks", str(card), "--set", "detector.options.engine=onnxruntime")
    config = read_overridden(None, overrides, TrackConfig)
    assert config.raw and config.detector.name == "onnx"
    assert config.detector.options == {"card": str(card), "engine": "onnxruntime"}


def test_an_ensemble_stays_with_the_default_detector(parse, tmp_path: Path) -> None:
    card = tmp_path / "both.toml"
    card.write_text('kind = "landmark_ensemble"\n')
    assert parse("--networks", str(card)) == [f"detector.options.landmarks={card}"]


def test_what_was_parsed_before_does_not_come_back(parse) -> None:
    assert parse("--networks", "a") == ["detector.options.landmarks=a"]
    assert parse() == []


@pytest.mark.parametrize("command", ["track", "live", "node", "calibrate person"])
def test_a_card_that_is_missing_is_one_line(command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main([*command.split(), "--networks", str(tmp_path / "absent.toml")])
    told = capsys.readouterr().err.strip()
    assert "absent.toml" in told and "\n" not in told
