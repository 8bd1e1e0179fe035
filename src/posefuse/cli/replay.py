"""A recorded session through the same tracker again: the same views in the same order give the same poses."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from posefuse.core import Detections2D, InputError, Pose3D, Rig
from posefuse.messages import topics
from posefuse.messages.bags import Warn, read_mcap
from posefuse.messages.messages import detections_from_message, pose_from_message
from posefuse.realtime.config import LiveConfig
from posefuse.realtime.estimator import Estimator, centres_from_message, warmed_up
from posefuse.realtime.messages import Centres
from posefuse.realtime.provenance import read_provenance

from .terminal import Terminal


def replay(path: Path, rig: Rig, config: LiveConfig | None, terminal: Terminal) -> Mapping[str, Any]:
    """Feed a recording's views to a new tracker and hold its poses against the recorded ones.

    Args:
        config: settings to try; None takes those the recording was made with.

    Raises:
        InputError: it holds no pose, or was made with another rig.
    """
    rig, config = _as_recorded(path, rig, config)
    poses = same = 0
    farthest_m = 0.0
    for recorded, again in replayed(path, rig, config, terminal.warn):
        poses += 1
        farthest = difference_m(recorded, again)
        same += farthest == 0
        farthest_m = max(farthest_m, farthest)
    if not poses:
        raise InputError(f"{path}: holds no pose; expected a recording of `posefuse live --record`")
    figures = {"poses": poses, "equal": same, "farthest_m": farthest_m}
    away = f"{farthest_m * 1000:.6f} mm away" if math.isfinite(farthest_m) else "there in only one of the two"
    terminal.facts("Replay", {"poses": poses, "equal": same, "farthest keypoint": away})
    return figures


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


def _as_recorded(path: Path, rig: Rig, config: LiveConfig | None) -> tuple[Rig, LiveConfig]:
    made = read_provenance(path)
    if made is None:
        return rig, config or LiveConfig()
    missing = [name for name in made.cameras if name not in rig.names]
    used = rig if missing else rig.only(made.cameras)
    if used.id != made.rig_id:
        raise InputError(f"{path}: was made with another rig ({made.rig_id}, cameras {', '.join(made.cameras)}), got {used.id}")
    return used, config or made.config


def difference_m(one: Pose3D, two: Pose3D) -> float:
    """Largest distance of a keypoint; infinite where only one of them has it."""
    if not np.array_equal(one.person_id, two.person_id):
        return float("inf")
    known = np.isfinite(one.xyz_world).all(axis=-1)
    if not np.array_equal(known, np.isfinite(two.xyz_world).all(axis=-1)):
        return float("inf")
    apart = np.linalg.norm(one.xyz_world[known] - two.xyz_world[known], axis=-1)
    return float(apart.max(initial=0.0))
