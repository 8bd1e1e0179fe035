"""What a user may set about a live session; each default exists once, here or in the room it belongs to."""

from __future__ import annotations

from dataclasses import field
from typing import Annotated, Any, Literal

from annotated_types import Ge, Gt, Le

from posefuse.association.settings import AssociateSettings, PeopleNames
from posefuse.detection.build import DetectorChoice
from posefuse.foundation.settings import settings
from posefuse.fusion.settings import FuseSettings
from posefuse.kinematics.settings import BodySettings
from posefuse.tracking.settings import LiveSettings

# 32 years
_LONGEST_S = 1e9


@settings
class KeypointGateSettings:
    """What may be sent out.

    Attributes:
        sigma_m: a keypoint whose stated standard deviation, along the axis that is known worst, is larger is withheld.
            Below it, 0.01 % of hips of an overloaded session were impossible (docs/reference/messages.md).
        unmeasured_s: a keypoint that no view measured for this long is withheld, even if the prediction is certain.
    """

    sigma_m: Annotated[float, Gt(0)] = 0.15
    unmeasured_s: Annotated[float, Gt(0)] = 0.4


@settings
class LiveConfig:
    """All settings of `posefuse live` that can be in a file.

    Attributes:
        rate_hz: poses per second.
        names: names of the people in the order of their ids; for viewers, JSON datagrams and what is made of a recording.
        groups: number of camera processes; left out: one per two cameras, at most one per core.
        search_every_s: while fewer people are followed than requested, search the whole image of every camera this often.
        joint_centres: move keypoints to anatomical joint centres, if the detector has a table for it.
        body: fit one skeleton of constant segment lengths per person to the rays of all views; lengths are learnt on the way.
            ``auto`` does so where a table of joint centres was fitted to the detector.
        outputs: live outputs by name, each with its options, see `posefuse plugins`.
        gate: which keypoints are sent out.
        detector: which detector finds keypoints in images.
        track: how people are followed.
        associate: how new people are found.
        fuse: how views are fused.
        whole_body: how the skeleton of `body` may move.
    """

    rate_hz: Annotated[float, Gt(0), Le(1000)] = 100.0
    names: PeopleNames = ()
    groups: Annotated[int, Ge(1)] | None = None
    search_every_s: Annotated[float, Gt(0)] = 0.5
    joint_centres: bool = True
    body: Literal["auto", "on", "off"] = "auto"
    outputs: dict[str, dict[str, Any]] = field(default_factory=dict)
    gate: KeypointGateSettings = field(default_factory=KeypointGateSettings)
    detector: DetectorChoice = field(default_factory=DetectorChoice)
    track: LiveSettings = field(default_factory=LiveSettings)
    associate: AssociateSettings = field(default_factory=AssociateSettings)
    fuse: FuseSettings = field(default_factory=FuseSettings)
    whole_body: BodySettings = field(default_factory=BodySettings)


@settings
class RunOptions:
    """Options of one run that exist on the command line only.

    Attributes:
        duration_s: the session ends after this time. loop_s: recorded and simulated sources restart after this time.
    """

    duration_s: Annotated[float, Gt(0), Le(_LONGEST_S)] | None = None
    loop_s: Annotated[float, Gt(0), Le(_LONGEST_S)] | None = None
