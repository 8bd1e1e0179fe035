"""Scenes of the simulation, out of the content of a scene file."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from posefuse.foundation.settings import settings_from_mapping
from posefuse_sim.props import Prop
from posefuse_sim.scene import Scene

PLAIN_ROOM = {"floor": "plain", "walls": "plain", "shadows": False}


def scene(**content: Any) -> Scene:
    """A second of four cameras in a ring, where nothing else is said."""
    return settings_from_mapping({"duration_s": 1.0, "cameras": {"kind": "ring"}} | content, Scene, where="scene")


def listed(*cameras: dict[str, Any]) -> dict[str, Any]:
    """Cameras at places of their own."""
    return {"kind": "list", "cameras": cameras}


def still(position_m: Sequence[float], **turned: float) -> dict[str, Any]:
    """The path of a prop that stays in its place."""
    return {"kind": "still", "position_m": position_m, **turned}


def chess_corners(prop: Prop) -> np.ndarray:
    """(Q, 3) inner chessboard corners of a ChArUco board in its own axes, in OpenCV's order."""
    return prop.points_prop[4 * len(prop.marker_id) :]
