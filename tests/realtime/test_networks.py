"""Which network a live session uses, and on which device."""

from __future__ import annotations

from pathlib import Path
from unittest.mock import Mock

import pytest
from checks import refusal

from posefuse.core import ConfigError, ModelError, PosefuseError
from posefuse.detection.build import DetectorChoice
from posefuse.detection.choosing import NetworkCost
from posefuse.realtime import networks
from posefuse.realtime.networks import fetch_networks, is_auto, settled_network


@pytest.mark.parametrize(
    ("choice", "auto"),
    [
        (DetectorChoice(), True),
        (DetectorChoice(options={"landmarks": "auto", "streams": 2}), True),
        (DetectorChoice(options={"landmarks": "blazepose_full"}), False),
        (DetectorChoice(name="oracle"), False),
    ],
)
def test_a_network_that_is_named_stays(choice: DetectorChoice, auto: bool) -> None:
    assert is_auto(choice) == auto
    if not auto:
        assert settled_network(choice, 4, pytest.fail) is choice


def test_of_the_networks_to_choose_from_one_is_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    there: set[str] = {"blazepose_full"}

    def fetch(choice: DetectorChoice, _: object) -> None:
        if choice.options["landmarks"] not in there:
            raise ModelError(f"cannot download {choice.options['landmarks']}")

    monkeypatch.setattr("posefuse.realtime.networks.build.fetch_networks", fetch)
    fetch_networks(DetectorChoice())
    refusal(ModelError, "blazepose_lite", lambda: fetch_networks(DetectorChoice(options={"landmarks": "blazepose_lite"})))
    there.clear()
    refusal(ModelError, "blazepose_full", lambda: fetch_networks(DetectorChoice()))
    # on a device that BlazePose does not run on, what the user has is chosen from
    fetch_networks(DetectorChoice(options={"device": "cuda:0,cuda:1"}))


def test_a_device_is_checked_before_anything_is_downloaded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("POSEFUSE_CACHE", str(tmp_path))
    gpu, full = {"device": "gpu"}, {"landmarks": "blazepose_full"}
    choices = [DetectorChoice(options=options) for options in (gpu, gpu | full, {"device": "cuda"} | full)]
    for choice in (*choices, DetectorChoice(name="onnx", options=gpu | {"card": "rtmpose_s"})):
        refusal(ConfigError, "device: ", fetch_networks, choice)
    assert not list(tmp_path.iterdir())


def test_of_constructed_networks_the_first_that_keeps_up_is_taken_on_its_device(tmp_path: Path) -> None:
    discs = pytest.importorskip("discs", reason="the package onnx is not installed")
    card = str(discs.card_of("rtmo", tmp_path))
    said: list[str] = []
    settled = settled_network(DetectorChoice(options={"precision": "f32"}), 1, said.append, ["blazepose_none", card])
    assert settled == DetectorChoice(name="onnx", options={"precision": "f32", "card": card, "device": "cpu"})
    assert len(said) == 1 and said[0].startswith(f"network {card} on cpu: ")


def test_where_none_runs_the_reason_is_given(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("POSEFUSE_CACHE", str(tmp_path))
    with pytest.raises(PosefuseError, match="fetch those you need: posefuse models NAME"):
        settled_network(DetectorChoice(options={"device": "cuda"}), 2, pytest.fail)


def test_ctrl_c_ends_the_process_that_measures_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """It measured on, on all cores, for as long as the program ran."""
    worker = Mock(**{"wait.side_effect": KeyboardInterrupt})
    monkeypatch.setattr(networks, "Worker", lambda _: worker)
    with pytest.raises(KeyboardInterrupt):
        settled_network(DetectorChoice(options={"landmarks": "auto"}), 2, pytest.fail)
    worker.end.assert_called_once_with(0.0)


def test_auto_is_a_graphics_card_where_the_network_ran_on_one(monkeypatch: pytest.MonkeyPatch) -> None:
    choice, asked = DetectorChoice(name="onnx", options={"card": "rtmpose_s"}), []
    ran_on = iter(("cuda:0", "cpu (driver 470 is too old)", "cuda:0"))

    def costs(choice: DetectorChoice, names: object, cameras: int) -> list[NetworkCost]:
        asked.append((names, cameras))
        return [NetworkCost("rtmpose_s", next(ran_on), 0.001)]

    monkeypatch.setattr(networks, "_costs", costs)
    monkeypatch.setattr(networks, "is_listed", lambda _: True)
    for expected in ("cuda:0", "cpu"):
        settled = settled_network(choice, 6, lambda _: None)
        assert settled.options == {"card": "rtmpose_s", "device": expected}
    monkeypatch.setattr(networks, "is_listed", lambda _: False)
    assert settled_network(choice, 6, pytest.fail) is choice
    # of several cards, each has its share of the cameras
    both = DetectorChoice(options={"device": "cuda:0,cuda:1"})
    assert settled_network(both, 5, lambda _: None).options == {"device": "cuda:0,cuda:1", "card": "rtmpose_s"}
    assert asked == [(("rtmpose_s",), 6), (("rtmpose_s",), 6), (None, 3)]
