"""Which cameras share a process: whichever process is lost, the other cameras should still locate people well."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations

import numpy as np

from posefuse.core import Rig
from posefuse.core.arrays import Array

# what is known of a person without any camera: in the room
_ROOM_M = 10.0
# variances that differ by less than this share of them count as equal
_SAME = 1e-6


def dealt(rig: Rig, cameras: Sequence[str], groups: int) -> list[list[str]]:
    """`cameras` shared among that many processes, as evenly as can be, in their order.

    An assignment is judged by its worst process: how unsure a point in the middle is from all other cameras of the rig (those of
    other machines included). Two opposite cameras add little depth: their rays are nearly one line. Assigned in turn
    first, then two cameras are exchanged as long as that helps. Of equally good assignments, the one whose names come first is
    taken.
    """
    information = dict(zip(rig.names, _information(rig), strict=True))
    best = [list(cameras[group::groups]) for group in range(groups)]
    while True:
        found = min([best, *_swaps(best)], key=lambda groups: _rank(groups, information))
        if _rank(found, information) == _rank(best, information):
            place = list(cameras).index
            return sorted((sorted(group, key=place) for group in best), key=lambda group: place(group[0]))
        best = found


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


def _rank(deal: Sequence[Sequence[str]], information: dict[str, Array]) -> tuple[tuple[int, ...], list[list[str]]]:
    """Least for the best. Variances count to a part in a million, so that how a processor rounds decides nothing; then names."""
    rounded = tuple(round(math.log(value) / _SAME) for value in _unsure(deal, information))
    return rounded, sorted(sorted(group) for group in deal)


def _swaps(deal: Sequence[Sequence[str]]) -> list[list[list[str]]]:
    """Every deal that exchanges two cameras of different groups."""
    found = []
    for a, b in combinations(range(len(deal)), 2):
        for one in deal[a]:
            for other in deal[b]:
                turn = {one: other, other: one}
                found.append([[turn.get(name, name) for name in group] for group in deal])
    return found
