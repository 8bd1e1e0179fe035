"""The network that keeps up: by costs, costs that are measured, and which networks there are to choose from."""

import itertools
from pathlib import Path

import numpy as np
import pytest
from checks import refusal

from posefuse.core import ConfigError, ModelError
from posefuse.detection.boxes import expected_shapes
from posefuse.detection.build import DetectorChoice
from posefuse.detection.card import OnnxCard, read_card
from posefuse.detection.choosing import (
    BLAZEPOSE,
    NetworkCost,
    best_sustained,
    installed_networks,
    measured_costs,
)
from posefuse.detection.files import model_path

COSTS = [NetworkCost("large", "cpu", 0.02), NetworkCost("middle", "cpu", 0.006), NetworkCost("small", "cpu", 0.003)]
ON_CPU = DetectorChoice(options={"device": "cpu"})


def test_the_first_that_keeps_up_is_chosen_and_the_cheapest_where_none_does():
    for cameras, rate_hz, expected in ((1, 30, "large"), (2, 30, "middle"), (4, 30, "small"), (100, 60, "small")):
        assert best_sustained(COSTS, cameras, rate_hz).name == expected


def test_where_none_keeps_up_the_default_networks_go_before_a_cheaper_one():
    lite, full = NetworkCost("blazepose_lite", "cpu", 0.02), NetworkCost("blazepose_full", "cpu", 0.03)
    other = NetworkCost("rtmpose_t", "cpu", 0.016)
    assert best_sustained([full, lite, other], 4, 30.0) is lite
    assert best_sustained([full, lite, other], 1, 30.0) is lite
    assert best_sustained([full, lite, NetworkCost("rtmpose_t", "cpu", 0.004)], 4, 30.0).name == "rtmpose_t"


@pytest.mark.usefixtures("models")
def test_costs_are_seconds_per_image_by_the_clock_given():
    ticks = itertools.count()
    (cost,) = measured_costs(["blazepose_full"], ON_CPU, clock_s=lambda: float(next(ticks)))
    images = 1 / cost.image_s
    assert cost.name == "blazepose_full" and images == int(images) and images % 2 == 0


@pytest.fixture
def empty_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("POSEFUSE_CACHE", str(tmp_path))
    return tmp_path


@pytest.fixture
def installed(empty_cache: Path):
    """Puts a constructed network where that of a card would be."""
    graphs = pytest.importorskip("graphs", reason="the package onnx is not installed")

    def put(name: str, more: int = 0) -> Path:
        card = read_card(name, OnnxCard)
        path = model_path(card, empty_cache)
        path.parent.mkdir(exist_ok=True)
        shapes = [[{"n": 3 + more}.get(part, part) for part in shape] for shape in expected_shapes(card)]
        outputs = {f"o{i}": np.zeros(shape, np.float32) for i, shape in enumerate(shapes)}
        graphs.constant_network(path, card.input.size_wh, outputs)
        return path

    return put


def test_a_network_that_is_not_there_is_named_and_not_fetched(empty_cache: Path):
    refusal(ModelError, r"blazepose_lite is not in .*posefuse models blazepose_lite", measured_costs, ["blazepose_lite"], ON_CPU)
    assert installed_networks() == [] and not list(empty_cache.iterdir())
    refusal(ModelError, "posefuse models NAME", lambda: measured_costs(installed_networks(), ON_CPU))


def test_every_installed_network_is_known_and_the_larger_comes_first(installed):
    installed("rtmo_s")
    assert installed_networks() == ["rtmo_s"]
    path = installed("rtmo_m", more=7)
    assert installed_networks() == ["rtmo_m", "rtmo_s"]
    path.unlink()
    assert installed_networks() == ["rtmo_s"]


@pytest.mark.usefixtures("models")
def test_blazepose_comes_before_networks_that_were_not_measured_to_be_better():
    found = installed_networks()
    assert "blazepose_full" in found
    assert found[: sum(name in BLAZEPOSE for name in found)] == [name for name in reversed(BLAZEPOSE) if name in found]


def test_networks_that_do_not_run_on_the_device_are_left_out(installed):
    installed("rtmo_s")
    (cost,) = measured_costs(["blazepose_full", "rtmo_s"], ON_CPU)
    assert (cost.name, cost.device) == ("rtmo_s", "cpu") and cost.image_s > 0
    refusal(ConfigError, "expected one of", lambda: measured_costs(["rtmo_s"], DetectorChoice(options={"device": "gpu"})))


def test_networks_after_one_that_suffices_are_not_measured(installed):
    for name in ("rtmo_s", "rtmo_m"):
        installed(name)
    assert [one.name for one in measured_costs(["rtmo_s", "rtmo_m"], ON_CPU, until=lambda _: True)] == ["rtmo_s"]
