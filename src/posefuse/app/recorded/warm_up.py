"""Compile the numeric kernels before the clock of the real work runs; they are kept on disk, so only the first run waits."""

from __future__ import annotations

import numpy as np

from posefuse.app.config import TrackConfig
from posefuse.associate import associate
from posefuse.core import Detections2D, PoseSequence, Rig, Skeleton
from posefuse.fuse import fuse
from posefuse.track import smooth

_INSTANTS = 12
_PERIOD_NS = 33_333_333


def warm_up(rig: Rig, skeleton: Skeleton, config: TrackConfig) -> None:
    """Run association, fusion and smoothing once on a made-up person in front of the cameras."""
    rng = np.random.default_rng(0)
    k = len(skeleton)
    middle = rig.centres_world().mean(axis=0) + np.mean([c.cam_from_world.matrix()[2] for c in rig], axis=0)
    person = middle + rng.normal(size=(k, 3)) * 0.4
    poses = []
    for i in range(_INSTANTS):
        seen = rig.project(person + rng.normal(size=(k, 3)) * 0.05)
        sure = np.isfinite(seen[..., 0]).astype(np.float32)
        seen[:1, : k // 2] += 200.0  # a view in conflict, so that the paths that settle conflicts are compiled too
        sigma = np.where(sure > 0, 2.0, np.nan)
        t_ns = i * _PERIOD_NS
        detections = [
            Detections2D(name, t_ns, skeleton, seen[c][None], sure[c][None], sigma[c][None], np.zeros((1, 4)))
            for c, name in enumerate(rig.names)
        ]
        views = associate(detections, rig, config.associate, poses[-1] if poses else None)
        poses.append(fuse(views, rig, config.fuse, poses[-1] if poses else None))
    people = [pose for pose in poses if len(pose.person_id) == len(poses[-1].person_id)]
    if len(people) > 2 and len(people[0].person_id):
        smooth(PoseSequence.from_poses(people), config.smooth)
