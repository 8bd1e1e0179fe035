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
from posefuse.realtime.gate import KeypointGate
from posefuse.realtime.joint_centres import Centring, centres_from_message
from posefuse.realtime.live_body import pose_for_output
from posefuse.realtime.provenance import read_provenance
from posefuse.realtime.session import ready_bodies, ready_tracker


def replayed(path: Path, rig: Rig, config: LiveConfig, warn: Warn | None = None) -> Any:
    """Pairs (recorded pose, pose of a new tracker at the same place of the same stream); `warn` as in `read_mcap`."""
    tracker, bodies = None, None
    centring, gate = Centring(rig.names, config.joint_centres), KeypointGate(config.gate)
    for entry in read_mcap(path, {topic.name for topic in (topics.JOINT_CENTRES, topics.DETECTIONS, topics.POSE)}, warn):
        if entry.topic == topics.JOINT_CENTRES.name:
            centring.learn(centres_from_message(entry.msg))
            continue
        value: Detections2D | Pose3D
        value, _ = (detections_from_message if entry.topic == topics.DETECTIONS.name else pose_from_message)(entry.msg)
        if tracker is None:
            tracker, bodies = ready_tracker(rig, value.skeleton, config), ready_bodies(rig, value.skeleton, config)
        if isinstance(value, Detections2D):
            tracker.add(value)
        else:
            pose = pose_for_output(tracker, tracker.at(value.t_ns), centring, bodies)
            # where the session did it, see `Fusion.run`
            tracker.check()
            yield value, gate.passed(pose)


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
