"""People followed live, from views of different cameras, times and ages."""

from __future__ import annotations

from typing import TYPE_CHECKING

from posefuse.core.extras import lazy_names
from posefuse.tracking.settings import MOTION, LiveMotion, LiveSettings, MotionModel

if TYPE_CHECKING:
    from .admission import CameraStatistics
    from .person import Evidence, Model
    from .tracker import Tracker

__getattr__ = lazy_names(__name__, __file__)
