"""Which of the networks that come with us this machine keeps up with: measured, not guessed."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from posefuse.core import Frame, ModelError, Region
from posefuse.foundation.places import default_cache_dir
from posefuse.foundation.platform import usable_cores

from .blazepose import BlazePoseConfig
from .card import needed_cards
from .files import status

# from the smallest to the largest
BUNDLED = ("blazepose_lite", "blazepose_full", "blazepose_heavy", "blazepose_best")
# of the time there is for an image, what decoding video, fusion and outputs leave to the network
_NETWORK_SHARE = 0.6
_IMAGE_WH = (640, 480)
_ROUNDS = 4


@dataclass(frozen=True)
class NetworkCost:
    """What a network costs on this machine.

    Attributes:
        name: of the bundled network. image_s: wall-clock seconds per image of one followed person, with all cores at work.
    """

    name: str
    image_s: float

    def sustains(self, cameras: int, rate_hz: float) -> bool:
        """Whether every frame of every camera is processed, with time left for everything else."""
        return self.image_s * cameras * rate_hz <= _NETWORK_SHARE


def measured_costs(
    names: Sequence[str] = BUNDLED,
    config: BlazePoseConfig | None = None,
    clock_s: Callable[[], float] = time.perf_counter,
    until: Callable[[NetworkCost], bool] = lambda _: False,
) -> list[NetworkCost]:
    """Cost of each network whose files are present; measuring takes about a second each.

    Args:
        names: bundled networks, from the smallest to the largest. config: of the detector; its network does not count.
        clock_s: for tests.
        until: larger networks are not measured after one for which this is true.

    Raises:
        ModelError: none of them is there.
    """
    config, folder = config or BlazePoseConfig(), default_cache_dir()
    ready = [name for name in names if _is_ready(name, folder)]
    if not ready:
        raise ModelError(f"none of the networks {', '.join(names)} is in {folder}; fetch them with: posefuse models")
    costs: list[NetworkCost] = []
    for name in ready:
        costs.append(NetworkCost(name, _image_s(replace(config, landmarks=name), clock_s)))
        if until(costs[-1]):
            break
    return costs


def largest_sustained(costs: Sequence[NetworkCost], cameras: int, rate_hz: float) -> NetworkCost:
    """The largest network with which every frame of every camera is processed; the cheapest where none keeps up.

    Args:
        costs: from the smallest network to the largest.
        cameras, rate_hz: how many, and frames per second of each.
    """
    keeping_up = [cost for cost in costs if cost.sustains(cameras, rate_hz)]
    return keeping_up[-1] if keeping_up else min(costs, key=lambda cost: cost.image_s)


def _is_ready(name: str, cache: Path) -> bool:
    return all(status(card, cache) == "ready" for card in needed_cards(name))


def _image_s(config: BlazePoseConfig, clock_s: Callable[[], float]) -> float:
    detector = config.build()
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
