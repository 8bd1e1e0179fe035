"""A synthetic person in front of the cameras: the pipeline processes it beforehand, so that kernels are compiled in time."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from posefuse.core import Detections2D, Rig, Skeleton

_PERIOD_NS = 33_333_333
_STAGGER_NS = 3_000_000
_AT_ODDS_EVERY, _AT_ODDS_PX = 5, 150.0


def made_up_detections(rig: Rig, skeleton: Skeleton, instants: int, start_ns: int = 0) -> Iterator[list[Detections2D]]:
    """Per time step one detection of the person by each camera, at its own time within the time step.

    Now and then the first camera puts half of the keypoints elsewhere: the paths that settle conflicts have work too.
    """
    rng = np.random.default_rng(0)
    k = len(skeleton)
    middle = rig.centres_world().mean(axis=0) + np.mean([c.cam_from_world.matrix()[2] for c in rig], axis=0)
    person = middle + rng.normal(size=(k, 3)) * 0.4
    for i in range(instants):
        seen = rig.project(person + rng.normal(size=(k, 3)) * 0.02)
        sure = np.isfinite(seen[..., 0])
        if i % _AT_ODDS_EVERY == 1:
            seen[0, : k // 2] += _AT_ODDS_PX
        score, sigma = sure.astype(np.float32), np.where(sure, 2.0, np.nan)
        yield [
            Detections2D(
                camera=name, t_ns=start_ns + i * _PERIOD_NS + c * _STAGGER_NS, skeleton=skeleton,
                xy_img=seen[c][None], score=score[c][None], sigma_px=sigma[c][None], box_img=np.zeros((1, 4)),
            )
            for c, name in enumerate(rig.names)
        ]  # fmt: skip
