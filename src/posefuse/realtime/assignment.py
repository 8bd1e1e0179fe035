"""Which cameras share a process: whichever process is lost, the other cameras should still locate people well."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from posefuse.core import Rig
from posefuse.core.arrays import Array

# what is known of a person without any camera: in the room
_ROOM_M = 10.0
_WORTH_A_SWAP = 1e-6


def dealt(rig: Rig, cameras: Sequence[str], groups: int) -> list[list[str]]:
    """`cameras` shared among that many processes, as evenly as can be, in their order.

    A deal is judged by its worst process: how unsure a point in the middle is from all other cameras of the rig (those of
    other machines included). Two cameras opposite each other tell little, as their rays are one line. Dealt in turn
    first, then two cameras are exchanged as long as that helps.
    """
    deal = [list(cameras[group::groups]) for group in range(groups)]
    information = dict(zip(rig.names, _information(rig), strict=True))
    best = _unsure(deal, information)
    while True:
        swaps = _swaps(deal)
        tried = [_unsure(swapped, information) for swapped in swaps]
        least = min(tried, default=best)
        if not _clearly_less(least, best):
            place = list(cameras).index
            return sorted((sorted(group, key=place) for group in deal), key=lambda group: place(group[0]))
        deal, best = swaps[tried.index(least)], least


def _information(rig: Rig) -> Array:
    """(C, 3, 3) that one ray of each camera brings about a point where all look; pixels count alike."""
    axes = np.stack([camera.cam_from_world.matrix()[2] for camera in rig])
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    centres = rig.centres_world()
    # cameras that look the same way meet nowhere: then it is a metre ahead of their middle
    ahead, pull = (centres + axes).mean(axis=0), 1e-3
    middle = np.linalg.solve(
        across.sum(axis=0) + pull * np.eye(3), np.einsum("cij,cj->i", across, centres) + pull * ahead
    )  # fmt: skip
    rays = middle - centres
    away = np.linalg.norm(rays, axis=-1)
    unit = rays / away[:, None]
    focal = np.array([camera.K[0, 0] for camera in rig])
    return np.asarray((focal / away)[:, None, None] ** 2 * (np.eye(3) - unit[:, :, None] * unit[:, None, :]))


def _unsure(deal: Sequence[Sequence[str]], information: dict[str, Array]) -> tuple[float, float]:
    """Variance of the point when the worst process is lost, and its sum over all processes."""
    left = [
        float(
            np.trace(np.linalg.inv(sum((one for name, one in information.items() if name not in lost), np.eye(3) / _ROOM_M**2)))
        )
        for lost in deal
    ]
    return max(left), sum(left)


def _clearly_less(one: tuple[float, float], other: tuple[float, float]) -> bool:
    least = [(1 - _WORTH_A_SWAP) * value for value in other]
    return one[0] < least[0] or (one[0] <= other[0] and one[1] < least[1])


def _swaps(deal: Sequence[Sequence[str]]) -> list[list[list[str]]]:
    """Every deal that exchanges two cameras of different groups."""
    found = []
    for a, b in combinations(range(len(deal)), 2):
        for one in deal[a]:
            for other in deal[b]:
                turn = {one: other, other: one}
                found.append([[turn.get(name, name) for name in group] for group in deal])
    return found
