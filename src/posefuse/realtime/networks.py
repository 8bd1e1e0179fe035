"""The network of a live session: the largest that processes every frame, by measurement at the start."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from multiprocessing import get_context

from posefuse.core import ModelError, Progress, silent
from posefuse.detection import build
from posefuse.detection.blazepose import BlazePoseConfig
from posefuse.detection.build import DetectorChoice
from posefuse.detection.choosing import NetworkCost, largest_sustained, measured_costs
from posefuse.foundation.plugins import plugin_config
from posefuse.foundation.requests_to_end import children_ignore_requests, leave_requests_to_parent

AUTO = "auto"
# the networks that are downloaded to choose from; larger ones count where the user has them
DOWNLOADED = ("blazepose_lite", "blazepose_full")
# cameras are taken to have this rate
_RATE_HZ = 30.0


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
            build.fetch_networks(one, progress)
        except ModelError as error:
            failed.append(error)
    if len(failed) == len(choices):
        raise failed[-1]


def settled_network(choice: DetectorChoice, cameras: int, say: Callable[[str], None]) -> DetectorChoice:
    """The detector with the largest network that sustains so many cameras, announced; one with a named network is unchanged.

    Raises:
        ModelError: none of the networks to choose from is there.
    """
    if not is_auto(choice):
        return choice
    config: BlazePoseConfig = plugin_config("detectors", choice.name, choice.options)
    # in a separate process, which frees its memory at the end and does not heed Ctrl-C of the terminal
    with ProcessPoolExecutor(1, get_context("spawn"), initializer=leave_requests_to_parent) as other:
        with children_ignore_requests():
            measured = other.submit(measured_costs, config=config, until=partial(_too_slow, cameras))
        costs = measured.result()
    best = largest_sustained(costs, cameras, _RATE_HZ)
    every = "processes every frame of" if best.sustains(cameras, _RATE_HZ) else "the fastest for"
    say(f"network {best.name}: {every} {cameras} cameras at {_RATE_HZ:g} frames/s, {1000 * best.image_s:.1f} ms per image")
    return with_network(choice, best.name)


def _too_slow(cameras: int, cost: NetworkCost) -> bool:
    return not cost.sustains(cameras, _RATE_HZ)
