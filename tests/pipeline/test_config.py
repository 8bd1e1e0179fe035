"""Settings: every default once, every wrong key or value one line that says what is allowed."""

from pathlib import Path
from typing import Any

import pytest
from checks import refusal

from posefuse.core import ConfigError
from posefuse.pipeline.config import TrackConfig, changed_config, changes_of, read_config, settings_by_key
from posefuse.pipeline.writing import build_sinks


def test_overrides_replace_values_of_the_file(tmp_path: Path) -> None:
    path = tmp_path / "posefuse.toml"
    path.write_text('start_s = 1.5\n[fuse]\nweights = "score"\n[cameras.left]\noffset_s = 0.02\n')
    config = read_config(path, changes_of(["fuse.score_threshold=0.3", "end_s=4", "cameras.right.video=a b.mp4"]))
    assert (config.start_s, config.end_s) == (1.5, 4.0)
    assert (config.fuse.weights, config.fuse.score_threshold) == ("score", 0.3)
    assert config.cameras["left"].offset_s == 0.02
    assert config.cameras["right"].video == "a b.mp4"
    assert read_config(None) == TrackConfig()


@pytest.mark.parametrize(
    ("overrides", "parts"),
    [
        (["colour=red"], ["unknown key 'colour'", "fuse"]),
        (["fuse.weight=all"], ["unknown key 'fuse.weight'", "weights", "score_threshold"]),
        (["fuse.weights=best"], ["fuse.weights", "'best'", "robust"]),
        (["cameras.left.vid=a"], ["unknown key 'cameras.left.vid'", "video"]),
        (["rate_hz=-5"], ["rate_hz", "greater than or equal to 0.001", "-5"]),
        (["rate_hz=1e9"], ["rate_hz"]),
        (["rate_hz=nan"], ["rate_hz"]),
        (["cameras.a.offset_s=1e12"], ["offset_s"]),
        (["end_s=inf"], ["end_s"]),
        (["rate_hz"], ["expected KEY=VALUE"]),
        (["start_s=1", "start_s.more=2"], ["start_s is a value"]),
    ],
)
def test_a_wrong_setting_names_itself_and_what_is_allowed(overrides: list[str], parts: list[str]) -> None:
    message = refusal(ConfigError, "", lambda: read_config(None, changes_of(overrides)))
    for part in parts:
        assert part in message


def test_a_broken_file_is_named(tmp_path: Path) -> None:
    path = tmp_path / "posefuse.toml"
    path.write_text("fuse = [")
    refusal(ConfigError, r"posefuse\.toml: cannot be parsed as TOML", read_config, path)
    refusal(ConfigError, "no such file", read_config, tmp_path / "none.toml")


def test_a_model_card_in_a_settings_file_lies_next_to_it(tmp_path: Path) -> None:
    path = tmp_path / "posefuse.toml"
    path.write_text('[detector]\nname = "onnx"\n[detector.options]\ncard = "rtmpose.toml"\n')
    assert read_config(path).detector.options["card"] == str(tmp_path / "rtmpose.toml")
    assert settings_by_key(path)["detector.options.card"] == str(tmp_path / "rtmpose.toml")
    assert read_config(None, {"detector.options.card": "a.toml"}).detector.options["card"] == "a.toml"


def test_an_output_takes_options_by_name_and_a_wrong_one_is_refused_before_work(tmp_path: Path) -> None:
    path = tmp_path / "posefuse.toml"
    path.write_text("[outputs.overlay]\nwidth_px = 320\n[outputs.trc]\n")
    csv_too = {"outputs": ("csv", "overlay")}

    def read(file: Path | None, changes: dict[str, Any] | None = None) -> dict[str, object]:
        return read_config(file, changes or {}).outputs

    width = {**read(None), "overlay": {"width_px": 320}}
    assert read(None, {"outputs.overlay.width_px": 320}) == width
    assert read(path) == {"overlay": {"width_px": 320}, "trc": {}}
    # one that the file describes keeps its description where the outputs are named again, and a key adds to it
    assert read(path, csv_too) == {"csv": {}, "overlay": {"width_px": 320}}
    assert read(path, {**csv_too, "outputs.overlay.height_px": 240})["overlay"] == {"width_px": 320, "height_px": 240}
    assert changed_config(TrackConfig(), {"outputs": ("trc",), "outputs.csv.x": 1}).outputs == {"trc": {}, "csv": {"x": 1}}
    sink = build_sinks(read(path, csv_too))[1]
    assert sink.width_px == 320
    for wrong, line in (
        ({"overlay": {"width": 3}}, "outputs overlay: unknown key 'width'; there are:"),
        ({"hight": {}}, "no plug-in 'hight' among outputs; there are:"),
    ):
        refusal(ConfigError, line, build_sinks, wrong)
