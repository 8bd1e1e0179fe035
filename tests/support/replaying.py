"""A recorded session through the same tracker again: the same views in the same order give the same poses."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from posefuse.core import Detections2D, Pose3D, Rig
from posefuse.messages import topics
from posefuse.messages.bags import Warn, read_mcap
from posefuse.messages.messages import detections_from_message, pose_from_message
from posefuse.realtime.config import LiveConfig
from posefuse.realtime.estimator import Estimator, centres_from_message, warmed_up
from posefuse.realtime.messages import Centres
from posefuse.realtime.provenance import read_provenance


def replayed(path: Path, rig: Rig, config: LiveConfig, warn: Warn | None = None) -> Any:
    """Pairs (recorded pose, pose of a new tracker at the same place of the same stream); `warn` as in `read_mcap`."""
    estimator: Estimator | None = None
    known: list[Centres] = []
    for entry in read_mcap(path, {topic.name for topic in (topics.JOINT_CENTRES, topics.DETECTIONS, topics.POSE)}, warn):
        if entry.topic == topics.JOINT_CENTRES.name:
            known.append(centres_from_message(entry.msg))
            continue
        value: Detections2D | Pose3D
        value, _ = (detections_from_message if entry.topic == topics.DETECTIONS.name else pose_from_message)(entry.msg)
        if estimator is None:
            estimator = warmed_up(rig, value.skeleton, config)
        while known:
            estimator.centring.learn(known.pop(0))
        if isinstance(value, Detections2D):
            estimator.add(value)
        else:
            pose = estimator.at(value.t_ns)
            # where the session did it, see `Fusion.run`
            estimator.check()
            yield value, pose


def difference_m(one: Pose3D, two: Pose3D) -> float:
    """Largest distance of a keypoint; infinite where only one of them has it."""
    if not np.array_equal(one.person_id, two.person_id):
        return float("inf")
    known = np.isfinite(one.xyz_world).all(axis=-1)
    if not np.array_equal(known, np.isfinite(two.xyz_world).all(axis=-1)):
        return float("inf")
    apart = np.linalg.norm(one.xyz_world[known] - two.xyz_world[known], axis=-1)
    return float(apart.max(initial=0.0))


def replay(path: Path, rig: Rig, warn: Warn | None = None) -> tuple[int, int]:
    """How many poses a recording has, and how many of them a new tracker with the recording's own settings repeats."""
    made = read_provenance(path)
    assert made is not None
    pairs = list(replayed(path, rig.only(made.cameras), made.config, warn))
    return len(pairs), sum(difference_m(recorded, again) == 0 for recorded, again in pairs)
