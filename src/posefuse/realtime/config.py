"""What a user may set about a live session; each default exists once, here or in the room it belongs to."""

from __future__ import annotations

from dataclasses import field
from typing import Annotated

from annotated_types import Ge, Gt, Le

from posefuse.association import AssociateSettings
from posefuse.foundation.settings import settings
from posefuse.fusion import FuseSettings
from posefuse.kinematics import JointSettings
from posefuse.pipeline.config import DetectorChoice
from posefuse.tracking.online import LiveSettings


@settings
class LiveConfig:
    """Everything `posefuse live` can be told in a file.

    Attributes:
        rate_hz: poses per second.
        groups: processes the cameras are shared among; 0: one per two cameras, at most one per core.
        search_every_s: while fewer people than asked for are followed, every camera's whole image is searched this often.
        preview_hz: pictures per second and camera for the viewer.
        joint_centres: move keypoints to anatomical joint centres, where the 2D estimator's model card knows how they lie.
        angles: joint angles and segment frames with every pose.
        detector: the 2D estimator. track, associate, fuse, joints: see the rooms.
    """

    rate_hz: Annotated[float, Gt(0), Le(1000)] = 100.0
    groups: Annotated[int, Ge(0)] = 0
    search_every_s: Annotated[float, Gt(0)] = 1.0
    preview_hz: Annotated[float, Ge(0)] = 8.0
    joint_centres: bool = True
    angles: bool = True
    detector: DetectorChoice = field(default_factory=DetectorChoice)
    track: LiveSettings = field(default_factory=LiveSettings)
    associate: AssociateSettings = field(default_factory=AssociateSettings)
    fuse: FuseSettings = field(default_factory=FuseSettings)
    joints: JointSettings = field(default_factory=JointSettings)
