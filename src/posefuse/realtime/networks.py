"""The network of a live session: the largest that processes every frame, by measurement at the start."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from posefuse.core import ModelError, PosefuseError, Progress, silent
from posefuse.detection import build
from posefuse.detection.blazepose import BlazePoseConfig
from posefuse.detection.build import DetectorChoice
from posefuse.detection.choosing import NetworkCost, largest_sustained, measured_costs
from posefuse.foundation.channel import Channel
from posefuse.foundation.plugins import plugin_config
from posefuse.foundation.worker import Worker

AUTO = "auto"
# the networks that are downloaded to choose from; larger ones count where the user has them
DOWNLOADED = ("blazepose_lite", "blazepose_full")
# cameras are taken to have this rate
_RATE_HZ = 30.0
_MEASURED_S, _END_S = 300.0, 5.0


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
    # in a separate process, which frees its memory at the end
    worker = Worker(_measure)
    worker.start(config, cameras)
    worker.wait(_MEASURED_S)
    costs, trouble = worker.receive(), worker.trouble
    worker.end(_END_S)
    if isinstance(costs, PosefuseError):
        raise costs
    if costs is None:
        raise ModelError(f"no network could be chosen: {trouble or f'nothing was measured within {_MEASURED_S:g} s'}")
    best = largest_sustained(costs, cameras, _RATE_HZ)
    every = "processes every frame of" if best.sustains(cameras, _RATE_HZ) else "the fastest for"
    say(f"network {best.name}: {every} {cameras} cameras at {_RATE_HZ:g} frames/s, {1000 * best.image_s:.1f} ms per image")
    return with_network(choice, best.name)


def _measure(channel: Channel, config: BlazePoseConfig, cameras: int) -> None:
    found: list[NetworkCost] | PosefuseError
    try:
        found = measured_costs(config=config, until=lambda cost: not cost.sustains(cameras, _RATE_HZ))
    except PosefuseError as error:
        found = error
    channel.send(found, _END_S)
