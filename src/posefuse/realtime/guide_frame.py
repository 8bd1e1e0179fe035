"""What calibration guidance shows of one frame."""

from __future__ import annotations

from dataclasses import dataclass

from posefuse.calibration.targets.detection import Corners
from posefuse.calibration.targets.guidance import Guidance
from posefuse.core import Frame


@dataclass(frozen=True, eq=False)
class GuideFrame:
    """One frame in which the target was looked for.

    Attributes:
        camera: its number. t_ns: time of exposure since the session's zero. frame: the image.
        corners: what of the target is in it. state: what is covered, this frame included.
    """

    camera: int
    t_ns: int
    frame: Frame
    corners: Corners
    state: Guidance
