"""The network of a live session: the largest that processes every frame, by measurement at the start, reconsidered under load."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing import get_context

from posefuse.core import ModelError, Progress, silent
from posefuse.detection import downloading
from posefuse.detection.blazepose import BlazePoseConfig
from posefuse.detection.build import DetectorChoice
from posefuse.detection.choosing import NetworkCost, largest_sustained, measured_costs
from posefuse.foundation.plugins import plugin_config
from posefuse.foundation.requests_to_end import leave_requests_to_parent

from .messages import Status

AUTO = "auto"
# the networks that are downloaded to choose from; larger ones count where the user has them
DOWNLOADED = ("blazepose_lite", "blazepose_full")
# cameras are taken to have this rate until their frames are counted
_RATE_HZ = 30.0
# frames are counted over so long; of these, more given up than the first share is too many, and less than the second none
_WINDOW_S = 3.0
_TOO_MANY, _NONE = 0.05, 0.01
# the busiest process may be predicted to detect for so much of the time with a larger network
_MOST_BUSY = 0.75
# a larger network that was too slow is tried again after so long, then after twice that, and so on
_FIRST_RETRY_S, _LONGEST_RETRY_S = 30.0, 960.0


def is_auto(choice: DetectorChoice) -> bool:
    """Whether a network is to be chosen: the default detector without a network of its own."""
    return choice.name == DetectorChoice().name and choice.options.get("landmarks", AUTO) == AUTO


def with_network(choice: DetectorChoice, name: str) -> DetectorChoice:
    """The detector with a bundled network."""
    return replace(choice, options={**choice.options, "landmarks": name})


def fetch_networks(choice: DetectorChoice, progress: Progress = silent) -> None:
    """Download what the detector needs and does not have; of the networks to choose from, one is enough.

    Raises:
        ModelError: a network cannot be downloaded.
    """
    choices = [with_network(choice, name) for name in DOWNLOADED] if is_auto(choice) else [choice]
    failed: list[ModelError] = []
    for one in choices:
        try:
            downloading.fetch_networks(one, progress)
        except ModelError as error:
            failed.append(error)
    if len(failed) == len(choices):
        raise failed[-1]


def settled_network(
    choice: DetectorChoice, cameras: int, say: Callable[[str], None]
) -> tuple[DetectorChoice, NetworkChooser | None]:
    """The detector with the largest network that sustains so many cameras, announced; and what reconsiders it.

    A detector with a named network is unchanged, without a chooser.

    Raises:
        ModelError: none of the networks to choose from is there.
    """
    if not is_auto(choice):
        return choice, None
    config: BlazePoseConfig = plugin_config("detectors", choice.name, choice.options)
    # in a separate process, which frees its memory at the end and does not heed Ctrl-C of the terminal
    with ProcessPoolExecutor(1, get_context("spawn"), initializer=leave_requests_to_parent) as other:
        costs = other.submit(measured_costs, config=config, until=partial(_too_slow, cameras)).result()
    best = largest_sustained(costs, cameras, _RATE_HZ)
    every = "processes every frame of" if best.sustains(cameras, _RATE_HZ) else "the fastest for"
    say(f"network {best.name}: {every} {cameras} cameras at {_RATE_HZ:g} frames/s, {1000 * best.image_s:.1f} ms per image")
    return with_network(choice, best.name), NetworkChooser(costs, best.name)


def _too_slow(cameras: int, cost: NetworkCost) -> bool:
    return not cost.sustains(cameras, _RATE_HZ)


@dataclass(frozen=True)
class _Counts:
    """Of all processes together: frames captured and given up, whole images searched; of the busiest, seconds of detection."""

    captured: int
    replaced: int
    searched: int
    busy_s: Mapping[int, float]


class NetworkChooser:
    """Goes over to a smaller network when frames are given up, and to a larger one when there is time. No clock inside.

    Searches of whole images take their time with every network, so that nothing is judged by the seconds in which there was one.

    Attributes:
        name: of the network that all processes should use. why: the last change, in words.
    """

    def __init__(self, costs: Sequence[NetworkCost], name: str) -> None:
        self.name, self.why = name, ""
        self._costs = list(costs)
        self._status: dict[int, Status] = {}
        self._begin: tuple[float, _Counts] | None = None
        self._retry_s, self._larger_from_s = _FIRST_RETRY_S, 0.0

    def step(self, status: Status, now_s: float) -> bool:
        """Take in the status of one process; whether `name` has changed."""
        self._status[status.group] = status
        if any(one.network != self.name for one in self._status.values()):
            self._begin = None
            return False
        counts = self._counted()
        if self._begin is None or counts.searched != self._begin[1].searched or counts.captured < self._begin[1].captured:
            self._begin = now_s, counts
            return False
        if now_s - self._begin[0] < _WINDOW_S:
            return False
        (began_s, before), self._begin = self._begin, (now_s, counts)
        captured = counts.captured - before.captured
        share = (counts.replaced - before.replaced) / captured if captured else 0.0
        busy = max(counts.busy_s[group] - before.busy_s.get(group, 0.0) for group in counts.busy_s) / (now_s - began_s)
        return self._decided(share, busy, now_s)

    def _counted(self) -> _Counts:
        cameras = [camera for one in self._status.values() for camera in one.cameras]
        return _Counts(
            captured=sum(camera.captured for camera in cameras),
            replaced=sum(camera.replaced for camera in cameras),
            searched=sum(one.searched for one in self._status.values()),
            busy_s={group: one.busy_s for group, one in self._status.items()},
        )

    def _decided(self, share: float, busy: float, now_s: float) -> bool:
        place = [cost.name for cost in self._costs].index(self.name)
        if share > _TOO_MANY and place > 0:
            self._larger_from_s, self._retry_s = now_s + self._retry_s, min(2 * self._retry_s, _LONGEST_RETRY_S)
            self.name, self.why = self._costs[place - 1].name, f"{share:.0%} of the frames were given up"
            return True
        if share > _NONE or place + 1 == len(self._costs) or now_s < self._larger_from_s:
            return False
        larger = self._costs[place + 1]
        if busy * larger.image_s / self._costs[place].image_s > _MOST_BUSY:
            return False
        self.name, self.why = larger.name, f"detection takes {busy:.0%} of the time"
        return True
