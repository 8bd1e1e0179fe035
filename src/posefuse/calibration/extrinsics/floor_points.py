"""Three points of the floor as a person marked them in the images: a TOML file that sets the world frame.

origin_to_x_m = 1.5        # measured, checks the scale; may be left out

[cameras.cam01]            # px in this camera's image; at least two cameras for each point
origin = [812, 640]        # where the world's origin is
x = [1033, 655]            # somewhere along +X
y = [790, 501]             # somewhere on the side of +Y
"""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Annotated

import numpy as np
from annotated_types import Gt

from posefuse.calibration.extrinsics.world import ThreePoints
from posefuse.core import ConfigError
from posefuse.foundation.settings import read_settings, settings

_LEAST_VIEWS = 2
_UNSEEN = (float("nan"), float("nan"))


@settings
class MarkedPoints:
    """Px (x, y) of the points one camera sees."""

    origin: tuple[float, float] = _UNSEEN
    x: tuple[float, float] = _UNSEEN
    y: tuple[float, float] = _UNSEEN


@settings
class FloorPoints:
    """The whole file, as above."""

    cameras: dict[str, MarkedPoints]
    origin_to_x_m: Annotated[float, Gt(0)] | None = None


def read_floor_points(path: Path) -> ThreePoints:
    """How the world is set by the file; raises ConfigError naming what is wrong in it."""
    file = read_settings(path, FloorPoints)
    marked = {name: np.array([points.origin, points.x, points.y]) for name, points in file.cameras.items()}
    for i, point in enumerate(fields(MarkedPoints)):
        views = sum(bool(np.isfinite(xy[i]).all()) for xy in marked.values())
        if views < _LEAST_VIEWS:
            raise ConfigError(f"{path}: {point.name}: expected to be marked in {_LEAST_VIEWS} cameras or more, got {views}")
    return ThreePoints(marked, file.origin_to_x_m)
