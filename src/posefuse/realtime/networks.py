"""The network of a live session: the best one that processes every frame, by measurement at the start."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from posefuse.core import ModelError, PosefuseError, Progress, silent
from posefuse.detection import build
from posefuse.detection.build import DetectorChoice, with_network
from posefuse.detection.choosing import NetworkCost, best_sustained, installed_networks, measured_costs
from posefuse.detection.device import device_of, is_listed
from posefuse.foundation.channel import Channel
from posefuse.foundation.worker import Worker

AUTO = "auto"
# the networks that are downloaded to choose from; others count where the user has them
DOWNLOADED = ("blazepose_lite", "blazepose_full")
# cameras are taken to have this rate
_RATE_HZ = 30.0
_MEASURED_S, _END_S = 300.0, 5.0


def is_auto(choice: DetectorChoice) -> bool:
    """Whether a network is to be chosen: the default detector without a network of its own."""
    return choice.name == DetectorChoice().name and choice.options.get("landmarks", AUTO) == AUTO


def devices_of(choice: DetectorChoice) -> list[str]:
    """The devices that camera groups run on, in turn: several stand in one setting, separated by commas."""
    return str(choice.options.get("device", AUTO)).split(",")


def on_device(choice: DetectorChoice, device: str) -> DetectorChoice:
    """The detector on this device."""
    return replace(choice, options={**choice.options, "device": device})


def fetch_networks(choice: DetectorChoice, progress: Progress = silent) -> None:
    """Download what the detector needs and does not have; of the networks to choose from, one is enough.

    Raises:
        ConfigError: options that the detector does not take. ModelError: a network cannot be downloaded.
    """
    build.check_device(choice)
    one = on_device(choice, devices_of(choice)[0]) if "device" in choice.options else choice
    # on other devices the user's networks are chosen from, and none is downloaded
    choices = (
        [one] if not is_auto(choice) else [] if _runs_elsewhere(choice) else [with_network(one, name) for name in DOWNLOADED]
    )
    failed: list[ModelError] = []
    for chosen in choices:
        try:
            build.fetch_networks(chosen, progress)
        except ModelError as error:
            failed.append(error)
    if failed and len(failed) == len(choices):
        raise failed[-1]


def settled_network(
    choice: DetectorChoice, cameras: int, say: Callable[[str], None], names: Sequence[str] | None = None
) -> DetectorChoice:
    """The detector with network and device settled, announced; unchanged where both were named.

    Args:
        choice: where it leaves the network open, the first of `names` that sustains so many cameras is taken.
        cameras: that share the devices. say: takes the news.
        names: networks to choose from, in the order of preference; None: all that are installed.

    Raises:
        PosefuseError: none of the networks to choose from runs on the device.
    """
    if not is_auto(choice):
        if not _device_is_open(choice):
            return choice
        names = (choice.options["card"],)
    devices = devices_of(choice)
    each = -(-cameras // len(devices))
    best = best_sustained(_costs(on_device(choice, devices[0]), names, each), each, _RATE_HZ)
    every = "processes every frame of" if best.sustains(each, _RATE_HZ) else "the fastest for"
    say(
        f"network {best.name} on {best.device}: {every} {each} cameras at {_RATE_HZ:g} frames/s, "
        f"{1000 * best.image_s:.1f} ms per image"
    )
    settled = with_network(choice, best.name)
    return settled if len(devices) > 1 else on_device(settled, best.device.partition(" ")[0])


def _device_is_open(choice: DetectorChoice) -> bool:
    """Whether `auto` may mean a graphics card; where it does, is known after the network ran there."""
    card = device_of("cuda")
    return choice.name == "onnx" and devices_of(choice) == [AUTO] and card is not None and is_listed(card)


def _runs_elsewhere(choice: DetectorChoice) -> bool:
    """Whether the devices are none that the default networks run on."""
    devices = [device_of(word) for word in devices_of(choice)]
    return any(device is not None and device.openvino is None for device in devices)


def _costs(choice: DetectorChoice, names: Sequence[str] | None, cameras: int) -> list[NetworkCost]:
    # in a separate process, which frees its memory at the end
    worker = Worker(_measure)
    costs = None
    try:
        worker.start(choice, names, cameras)
        worker.wait(_MEASURED_S)
        costs, trouble = worker.receive(), worker.trouble
    finally:
        # one that still measures after Ctrl-C is not waited for
        worker.end(0.0 if costs is None else _END_S)
    if isinstance(costs, PosefuseError):
        raise costs
    if costs is None:
        raise ModelError(f"no network could be chosen: {trouble or f'nothing was measured within {_MEASURED_S:g} s'}")
    return list(costs)


def _measure(channel: Channel, choice: DetectorChoice, names: Sequence[str] | None, cameras: int) -> None:
    found: list[NetworkCost] | PosefuseError
    try:
        wanted = installed_networks() if names is None else names
        found = measured_costs(wanted, choice, until=lambda cost: cost.sustains(cameras, _RATE_HZ))
    except PosefuseError as error:
        found = error
    channel.send(found, _END_S)
