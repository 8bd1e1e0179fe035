"""Which network a live session uses."""

from __future__ import annotations

import pytest

from posefuse.core import ModelError
from posefuse.detection.build import DetectorChoice
from posefuse.realtime.networks import fetch_networks, is_auto


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


def test_of_the_networks_to_choose_from_one_is_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    there: set[str] = {"blazepose_full"}

    def fetch(choice: DetectorChoice, _: object) -> None:
        if choice.options["landmarks"] not in there:
            raise ModelError(f"cannot download {choice.options['landmarks']}")

    monkeypatch.setattr("posefuse.realtime.networks.build.fetch_networks", fetch)
    fetch_networks(DetectorChoice())
    with pytest.raises(ModelError, match="blazepose_lite"):
        fetch_networks(DetectorChoice(options={"landmarks": "blazepose_lite"}))
    there.clear()
    with pytest.raises(ModelError, match="blazepose_full"):
        fetch_networks(DetectorChoice())
