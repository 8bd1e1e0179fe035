"""The largest network that keeps up: by costs, and costs that are measured."""

import itertools
from pathlib import Path

import pytest

from posefuse.core import ModelError
from posefuse.detection.choosing import NetworkCost, largest_sustained, measured_costs

COSTS = [NetworkCost("small", 0.003), NetworkCost("middle", 0.006), NetworkCost("large", 0.02)]


@pytest.mark.parametrize(
    ("cameras", "rate_hz", "expected"), [(1, 30, "large"), (2, 30, "middle"), (4, 30, "small"), (100, 60, "small")]
)
def test_the_largest_that_keeps_up_is_chosen_and_the_cheapest_where_none_does(cameras, rate_hz, expected):
    assert largest_sustained(COSTS, cameras, rate_hz).name == expected


def test_more_cameras_never_choose_a_larger_network():
    chosen = [COSTS.index(largest_sustained(COSTS, cameras, 30.0)) for cameras in range(1, 40)]
    assert all(later <= earlier for earlier, later in itertools.pairwise(chosen))


@pytest.mark.usefixtures("models")
def test_costs_are_seconds_per_image_by_the_clock_given():
    ticks = itertools.count()
    (cost,) = measured_costs(["blazepose_full"], clock_s=lambda: float(next(ticks)))
    images = 1 / cost.image_s
    assert cost.name == "blazepose_full" and images == int(images) and images % 2 == 0


def test_networks_that_are_not_there_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("POSEFUSE_CACHE", str(tmp_path))
    with pytest.raises(ModelError, match="blazepose_lite"):
        measured_costs()
