"""Compile the numeric kernels before the clock of the real work runs; they are kept on disk, so only the first run waits."""

from __future__ import annotations

from posefuse.association import associate
from posefuse.core import Pose3D, PoseSequence, Rig, Skeleton
from posefuse.fusion import fuse
from posefuse.tracking import smooth
from posefuse.tracking.stand_in import made_up_detections

from .config import TrackConfig

_INSTANTS = 12


def warm_up(rig: Rig, skeleton: Skeleton, config: TrackConfig) -> None:
    """Run association, fusion and smoothing once on a made-up person in front of the cameras."""
    poses: list[Pose3D] = []
    for detections in made_up_detections(rig, skeleton, _INSTANTS):
        before = poses[-1] if poses else None
        poses.append(fuse(associate(detections, rig, config.associate, before), rig, config.fuse, before))
    people = [pose for pose in poses if len(pose.person_id) == len(poses[-1].person_id)]
    if len(people) > 2 and len(people[0].person_id):
        smooth(PoseSequence.from_poses(people), config.smooth)
