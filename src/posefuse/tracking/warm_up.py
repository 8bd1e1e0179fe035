"""A synthetic person in front of the cameras: the pipeline processes it beforehand, so that kernels are compiled in time."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from posefuse.core import Detections2D, Rig, Skeleton
from posefuse.core.arrays import Array
from posefuse.core.skeleton import SIDES

_PERIOD_NS = 33_333_333
_STAGGER_NS = 3_000_000
_AT_ODDS_EVERY, _AT_ODDS_PX = 5, 150.0
# of an adult who stands, metres: forward, to the side, up
_STANDING = {
    "nose": (0.12, 0.0, 1.62), "eye": (0.10, 0.03, 1.65), "ear": (0.0, 0.08, 1.63), "neck": (0.0, 0.0, 1.45),
    "shoulder": (0.0, 0.19, 1.42), "elbow": (0.03, 0.27, 1.14), "wrist": (0.12, 0.28, 0.90), "mid_hip": (0.0, 0.0, 0.93),
    "hip": (0.0, 0.10, 0.93), "knee": (0.03, 0.11, 0.50), "ankle": (0.0, 0.11, 0.09), "heel": (-0.05, 0.11, 0.03),
    "big_toe": (0.18, 0.10, 0.03), "small_toe": (0.16, 0.15, 0.03), "foot_index": (0.18, 0.11, 0.03),
}  # fmt: skip
_ELSEWHERE, _ELSEWHERE_M = (0.0, 0.0, 1.2), 0.2


def made_up_person(skeleton: Skeleton) -> Array:
    """(K, 3) metres, z up: of human size, as two cameras take nothing else for a person; what has no place is near the trunk."""
    rng = np.random.default_rng(0)
    places = []
    for name in skeleton.keypoints:
        side, _, part = name.partition("_")
        place = _STANDING.get(part if side in SIDES else name)
        beside = -1 if side == "right" else 1
        loose = np.array(_ELSEWHERE) + rng.normal(size=3) * _ELSEWHERE_M
        places.append(loose if place is None else np.array(place) * (1, beside, 1))
    return np.array(places)


def made_up_detections(rig: Rig, skeleton: Skeleton, time_steps: int, start_ns: int = 0) -> Iterator[list[Detections2D]]:
    """Per time step one detection of the person by each camera, at its own time within the time step.

    Now and then the first camera puts half of the keypoints elsewhere: the paths that settle conflicts have work too.
    """
    rng = np.random.default_rng(0)
    k = len(skeleton)
    middle = rig.centres_world().mean(axis=0) + np.mean([c.cam_from_world.matrix()[2] for c in rig], axis=0)
    standing = made_up_person(skeleton)
    person = middle + standing - standing.mean(axis=0)
    for i in range(time_steps):
        seen = rig.project(person + rng.normal(size=(k, 3)) * 0.02)
        sure = np.isfinite(seen[..., 0])
        if i % _AT_ODDS_EVERY == 1:
            seen[0, : k // 2] += _AT_ODDS_PX
        t_ns, sigma = start_ns + i * _PERIOD_NS, np.where(sure, 2.0, np.nan)
        yield [
            Detections2D.of(name, t_ns + c * _STAGGER_NS, skeleton, seen[c], sure[c], sigma[c])
            for c, name in enumerate(rig.names)
        ]
