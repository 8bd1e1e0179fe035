"""The recorded run: a session folder to a Recording, in steps that can be run again."""

from typing import TYPE_CHECKING

from posefuse.foundation.lazy_names import lazy_names

if TYPE_CHECKING:
    from .clock import StageClock
    from .config import CameraInput, TrackConfig, read_config
    from .opening import build_source
    from .run import Tracked, track_session
    from .second_pass import poses_over_time
    from .session import Session, find_session

_HOMES = {
    "CameraInput": "config",
    "Session": "session",
    "StageClock": "clock",
    "TrackConfig": "config",
    "Tracked": "run",
    "build_source": "opening",
    "find_session": "session",
    "poses_over_time": "second_pass",
    "read_config": "config",
    "track_session": "run",
}
__all__ = [
    "CameraInput",
    "Session",
    "StageClock",
    "TrackConfig",
    "Tracked",
    "build_source",
    "find_session",
    "poses_over_time",
    "read_config",
    "track_session",
]
__getattr__ = lazy_names(__name__, _HOMES)
