"""Which of the networks on this machine keeps up with its cameras: measured on the chosen device, not guessed."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from posefuse.core import Detector, Frame, ModelError, PosefuseError, Region
from posefuse.foundation.platform import default_cache_dir, usable_cores
from posefuse.foundation.plugins import plugin_config

from .build import DetectorChoice, with_network
from .card import named_networks, needed_cards
from .files import model_path, status

# the default networks, from the smallest to the largest
BLAZEPOSE = ("blazepose_lite", "blazepose_full", "blazepose_heavy", "blazepose_best")
# of the time there is for an image, what decoding video, fusion and outputs leave to the network
_NETWORK_SHARE = 0.6
_IMAGE_WH = (640, 480)
_ROUNDS = 4


@dataclass(frozen=True)
class NetworkCost:
    """What a network costs on this machine.

    Attributes:
        name: of the network. device: on which it ran. image_s: wall-clock seconds per image of one followed person, with many
            images at once.
    """

    name: str
    device: str
    image_s: float

    def sustains(self, cameras: int, rate_hz: float) -> bool:
        """Whether it sustains so many cameras of this rate: every frame is processed, with time left for everything else."""
        return int(_NETWORK_SHARE / (self.image_s * rate_hz)) >= cameras


def installed_networks() -> list[str]:
    """Networks whose files are there, in the order of preference; hashes are checked.

    BlazePose before the others, of which none was measured to be more accurate; the larger before the smaller.
    """
    sizes = {name: size for name in named_networks() if (size := _installed_bytes(name))}
    others = sorted(sizes.keys() - set(BLAZEPOSE), key=lambda name: (-sizes[name], name))
    return [*(name for name in reversed(BLAZEPOSE) if name in sizes), *others]


def measured_costs(
    names: Sequence[str],
    choice: DetectorChoice,
    clock_s: Callable[[], float] = time.perf_counter,
    until: Callable[[NetworkCost], bool] = lambda _: False,
) -> list[NetworkCost]:
    """Cost of each network that runs on the device; measuring takes about a second each. Nothing is downloaded.

    Args:
        names: of networks, or TOML files of cards. choice: device and other options of the detector.
        clock_s: for tests.
        until: those after one for which this is true are not measured.

    Raises:
        PosefuseError: none of them runs; that of the last one.
    """
    costs: list[NetworkCost] = []
    problem: PosefuseError = ModelError(f"no network is in {default_cache_dir()}; fetch those you need: posefuse models NAME")
    for name in names:
        try:
            costs.append(_measured(name, choice, clock_s))
        except PosefuseError as error:
            problem = error
            continue
        if until(costs[-1]):
            break
    if not costs:
        raise problem
    return costs


def best_sustained(costs: Sequence[NetworkCost], cameras: int, rate_hz: float) -> NetworkCost:
    """The first network with which every frame of every camera is processed.

    Where none keeps up, the cheapest, of BlazePose if that runs: a machine that is busy meanwhile takes no worse network.

    Args:
        costs: in the order of preference.
        cameras, rate_hz: how many, and frames per second of each.
    """
    keeping_up = [cost for cost in costs if cost.sustains(cameras, rate_hz)]
    default = [cost for cost in costs if cost.name in BLAZEPOSE]
    return keeping_up[0] if keeping_up else min(default or costs, key=lambda cost: cost.image_s)


def _measured(name: str, choice: DetectorChoice, clock_s: Callable[[], float]) -> NetworkCost:
    chosen = with_network(choice, name)
    if not _installed_bytes(name):
        raise ModelError(f"network {name} is not in {default_cache_dir()}; fetch it with: posefuse models {name}")
    detector: Detector = plugin_config("detectors", chosen.name, chosen.options).build()
    # BlazePose states none: it runs on what it was given, and `auto` is the CPU
    given = chosen.options.get("device", "auto").replace("auto", "cpu")
    device = getattr(detector, "network", {}).get("device", given)
    return NetworkCost(name, device, _image_s(detector, clock_s))


def _installed_bytes(name: str) -> int:
    """Of all files that a network needs; 0 where one is missing or damaged."""
    cards, cache = needed_cards(name), default_cache_dir()
    if any(status(card, cache) != "ready" for card in cards):
        return 0
    return sum(model_path(card, cache).stat().st_size for card in cards)


def _image_s(detector: Detector, clock_s: Callable[[], float]) -> float:
    noise = np.random.default_rng(0).integers(0, 256, (_IMAGE_WH[1], _IMAGE_WH[0], 3), dtype=np.uint8)
    count = 2 * usable_cores()
    frames = [Frame(camera=f"cam{i}", seq=0, t_ns=0, received_ns=0, image=noise) for i in range(count)]
    regions: Sequence[Sequence[Region]] = [[Region(centre_img=np.array(_IMAGE_WH) / 2, side_px=float(_IMAGE_WH[1]))]] * count
    times = []
    for _ in range(_ROUNDS):
        began_s = clock_s()
        detector.detect(frames, regions)
        times.append((clock_s() - began_s) / count)
    # the first round warms up, and what else the machine does only ever adds
    return min(times[1:])
