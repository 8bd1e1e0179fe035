"""A scene with exact truth to frames and detections.

A scene file (`read_scene`) becomes a session with videos and truth (`simulate`), its truth alone (`truth_of`), or frames
for a pipeline (`SimulatedSource`). Does not use `kinematics`: angles come from the body model itself.
"""

from typing import TYPE_CHECKING

from posefuse.core.extras import lazy_names

if TYPE_CHECKING:
    from .exact import truth_of
    from .oracle import OracleDetector, OracleNoise, oracle_views
    from .scene import Scene, read_scene
    from .session import SessionPaths, simulate


__getattr__ = lazy_names(__name__, __file__)
