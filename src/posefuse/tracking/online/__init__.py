"""People followed live, from views of different cameras, times and ages."""

from __future__ import annotations

from typing import TYPE_CHECKING

from posefuse.core.extras import lazy_names
from posefuse.tracking.settings import MOTION, LiveMotion, LiveSettings, MotionModel

if TYPE_CHECKING:
    from posefuse.core import Rig, Skeleton

    from .contract import CameraStatistics, Fuse, Solve, Tracker
    from .person import Evidence

__getattr__ = lazy_names(__name__, __file__)


def build_tracker(
    rig: Rig, skeleton: Skeleton, settings: LiveSettings, solve: Solve, fuse: Fuse, motion: LiveMotion = MOTION
) -> Tracker:
    """A tracker with no person in it yet.

    Args:
        rig: the cameras. skeleton: of every view.
        settings: how it judges.
        solve: association and fusion of one time step, from one view of every camera (empty for those that have none) and the
            pose before. New people come from it.
        fuse: fusion of one time step alone, of views that are known to show the same people.
        motion: how people move.
    """
    from .asynchronous import AsynchronousTracker
    from .person import Model

    return AsynchronousTracker(Model(rig, skeleton, settings, motion), solve, fuse)
