"""Which network a live session uses, and when it goes over to another one."""

from __future__ import annotations

import time

import pytest

from posefuse.core import ModelError
from posefuse.detection.build import DetectorChoice
from posefuse.detection.choosing import NetworkCost
from posefuse.health.cameras import CameraState
from posefuse.realtime.changeable_detector import ChangeableDetector
from posefuse.realtime.messages import Status
from posefuse.realtime.networks import NetworkChooser, fetch_networks, is_auto

COSTS = [NetworkCost("small", 0.002), NetworkCost("middle", 0.004), NetworkCost("large", 0.016)]
RATE_HZ, STATUS_S, CAMERAS = 30.0, 0.25, 4


class Machine:
    """Two camera processes of two cameras each, with a made-up speed.

    Args:
        speed: seconds of detection that the machine does per second and process; below 1 where others use it, too.
    """

    def __init__(self, chooser: NetworkChooser, speed: float = 1.0) -> None:
        self.chooser, self.speed, self.now_s = chooser, speed, 0.0
        self.used: list[str] = []
        self._captured, self._replaced, self._busy_s, self._searched = 0.0, 0.0, 0.0, 0

    def run(self, seconds: float, searching: bool = False) -> None:
        for _ in range(round(seconds / STATUS_S)):
            cost = next(cost for cost in COSTS if cost.name == self.chooser.name)
            self.now_s += STATUS_S
            frames = RATE_HZ * STATUS_S * CAMERAS / 2
            # two processes share the work, each with a core of its own: image_s is with both at work
            wanted_s = frames * 2 * cost.image_s / self.speed
            done = 0.05 if searching else min(1.0, STATUS_S / wanted_s)
            self._captured += frames
            self._replaced += frames * (1 - done)
            self._busy_s += STATUS_S if searching else min(wanted_s, STATUS_S)
            self._searched += searching
            for group in range(2):
                self.chooser.step(self._status(group, cost.name), self.now_s)
            self.used.append(self.chooser.name)

    def _status(self, group: int, network: str) -> Status:
        counts = {"captured": round(self._captured / 2), "replaced": round(self._replaced / 2), "used": 0, "missing": 0}
        cameras = tuple(CameraState(camera=f"{group}{i}", state="running", text="", **counts) for i in range(2))
        return Status(group, round(self.now_s * 1e9), cameras, network, self._searched, self._busy_s)


def test_a_network_that_is_too_slow_gives_way_within_seconds_and_what_fits_stays() -> None:
    machine = Machine(NetworkChooser(COSTS, "large"))
    machine.run(12)
    assert machine.chooser.name == "middle"
    machine.run(300)
    # the large one takes 96 % of the time by its cost: it is never tried
    assert set(machine.used[round(12 / STATUS_S) :]) == {"middle"}


def test_under_load_the_small_one_takes_over_and_a_larger_one_comes_back_after_it() -> None:
    machine = Machine(NetworkChooser(COSTS, "middle"), speed=0.35)
    machine.run(10)
    assert machine.chooser.name == "small"
    machine.speed = 1.0
    machine.run(60)
    assert machine.chooser.name == "middle"


def test_a_machine_at_its_limit_changes_ever_more_rarely() -> None:
    # so fast that the larger network seems to fit by the costs, and does not
    machine = Machine(NetworkChooser([COSTS[0], NetworkCost("middle", 0.0021)], "small"), speed=0.45)
    machine.run(3600)
    changes = [i for i in range(1, len(machine.used)) if machine.used[i] != machine.used[i - 1]]
    assert 4 <= len(changes) <= 20
    assert changes[-1] - changes[-3] > 4 * (changes[2] - changes[0])


def test_searches_of_whole_images_say_nothing_about_the_network() -> None:
    machine = Machine(NetworkChooser(COSTS, "middle"))
    machine.run(60, searching=True)
    assert set(machine.used) == {"middle"}


def test_a_process_that_began_again_counts_from_zero_and_changes_nothing() -> None:
    machine = Machine(NetworkChooser(COSTS, "middle"))
    machine.run(20)
    machine._captured = machine._replaced = machine._busy_s = 0.0
    machine.run(20)
    assert set(machine.used) == {"middle"}


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

    monkeypatch.setattr("posefuse.realtime.networks.downloading.fetch_networks", fetch)
    fetch_networks(DetectorChoice())
    with pytest.raises(ModelError, match="blazepose_lite"):
        fetch_networks(DetectorChoice(options={"landmarks": "blazepose_lite"}))
    there.clear()
    with pytest.raises(ModelError, match="blazepose_full"):
        fetch_networks(DetectorChoice())


def test_a_network_is_exchanged_between_two_frames_and_one_that_cannot_be_built_changes_nothing(
    ring_rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    def build(choice: DetectorChoice, _: object) -> str:
        if choice.options["landmarks"] == "broken":
            raise ModelError("cannot be built")
        return f"detector of {choice.options['landmarks']}"

    def exchanged_within(detector: ChangeableDetector, seconds: float) -> bool:
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s:
            if detector.exchanged():
                return True
            time.sleep(0.01)
        return False

    monkeypatch.setattr("posefuse.realtime.changeable_detector.build_detector", build)
    detector = ChangeableDetector(DetectorChoice(options={"landmarks": "small"}), ring_rig(2))
    detector.load("small")
    assert not detector.exchanged()
    detector.load("large")
    assert detector.now == "detector of small"
    assert exchanged_within(detector, 60)
    assert (detector.now, detector.network) == ("detector of large", "large")
    detector.load("broken")
    assert not exchanged_within(detector, 0.3)
    detector.load("small")
    assert exchanged_within(detector, 60)
    assert detector.network == "small"
