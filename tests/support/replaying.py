"""A recorded session through the same tracker again: the same views in the same order give the same poses."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from posefuse.core import Detections2D, LiveJointCentres, Pose3D, Rig
from posefuse.foundation.settings import settings_from_mapping
from posefuse.realtime.config import LiveConfig
from posefuse.realtime.estimator import Estimator, warmed_up
from posefuse_ros import topics
from posefuse_ros.bags import Warn, read_mcap, read_notes
from posefuse_ros.camera_messages import joint_centres_from_message
from posefuse_ros.messages import detections_from_message, pose_from_message


def provenance_of(path: Path) -> tuple[tuple[str, ...], str, LiveConfig]:
    """What `notes_of` left in a recording: its cameras in their order, the rig's content hash, and all settings."""
    notes = read_notes(path)
    config = settings_from_mapping(json.loads(notes["settings"]), LiveConfig, where=str(path))
    return tuple(json.loads(notes["cameras"])), notes["rig_id"], config


def replayed(path: Path, rig: Rig, config: LiveConfig, warn: Warn | None = None) -> Any:
    """Pairs (recorded pose, pose of a new tracker at the same place of the same stream); `warn` as in `read_mcap`."""
    estimator: Estimator | None = None
    known: list[LiveJointCentres] = []
    for entry in read_mcap(path, {topic.name for topic in (topics.JOINT_CENTRES, topics.DETECTIONS, topics.POSE)}, warn):
        if entry.topic == topics.JOINT_CENTRES.name:
            known.append(joint_centres_from_message(entry.msg))
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
    known = [np.isfinite(pose.xyz_world).all(axis=-1) for pose in (one, two)]
    if not (np.array_equal(one.person_id, two.person_id) and np.array_equal(*known)):
        return float("inf")
    return float(np.linalg.norm(one.xyz_world[known[0]] - two.xyz_world[known[1]], axis=-1).max(initial=0.0))


def replay(path: Path, rig: Rig, warn: Warn | None = None) -> tuple[int, int]:
    """How many poses a recording has, and how many of them a new tracker with the recording's own settings repeats."""
    cameras, _, config = provenance_of(path)
    pairs = list(replayed(path, rig.only(cameras), config, warn))
    return len(pairs), sum(difference_m(recorded, again) == 0 for recorded, again in pairs)
