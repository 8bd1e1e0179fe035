"""The recorded run: a session folder to a Recording, in steps that can be run again."""

from typing import TYPE_CHECKING

from posefuse.core.extras import lazy_names

if TYPE_CHECKING:
    from .config import CameraInput, TrackConfig, changes_of, read_config
    from .opening import build_source
    from .second_pass import poses_over_time
    from .session import Session, find_session
    from .track import Tracked, track_session

__getattr__ = lazy_names(__name__, __file__)
