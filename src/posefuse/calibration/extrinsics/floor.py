"""What sets the world coordinates of a target calibration: a marker or three points of the floor, and their file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from annotated_types import Gt

from posefuse.calibration.targets.corners import CornerObservations
from posefuse.calibration.targets.kinds import Markers, Target
from posefuse.core import Camera, ConfigError, InputError
from posefuse.foundation.settings import read_settings, settings

from .world import FloorTile, ThreePoints, WorldRule

# a board that gives the focal length to a per cent gives k1 and k2 to about this
_LENS_PER_PERCENT = 0.02


@dataclass(frozen=True)
class FloorMarker:
    """A marker that lies on the floor, face up, in the same recordings.

    Attributes:
        id: its number in the dictionary of the target. side_m: edge of its black square; None: as the target's markers.
    """

    id: int
    side_m: float | None = None


def check_floor(floor: FloorMarker | ThreePoints | None, target: Target) -> None:
    """Raise InputError where the floor needs another target, ConfigError where the dictionary has no such marker."""
    if isinstance(floor, FloorMarker) and not isinstance(target, Markers):
        raise InputError("a marker on the floor needs a target of markers, of the same dictionary")
    if isinstance(floor, FloorMarker) and isinstance(target, Markers):
        _tile(floor, target)


def with_floor(target: Target, floor: FloorMarker | ThreePoints | None) -> Target:
    """What to look for in the images: the target, and the marker on the floor where the target has markers of its own only."""
    if not isinstance(floor, FloorMarker) or not isinstance(target, Markers):
        return target
    if not target.ids or floor.id in target.ids:
        return target
    return replace(target, ids=(*target.ids, floor.id))


def world_rule(
    floor: FloorMarker | ThreePoints | None, observations: CornerObservations, target: Target
) -> tuple[CornerObservations, WorldRule | None]:
    """The observations of the moving target alone, and what sets the world; None estimates up from the cameras."""
    if not isinstance(floor, FloorMarker) or not isinstance(target, Markers):
        return observations, floor if isinstance(floor, ThreePoints) else None
    world = FloorTile(observations.of_patches([floor.id]), _tile(floor, target), floor.id)
    return observations.rows(observations.patch != floor.id), world


def _tile(floor: FloorMarker, target: Markers) -> Markers:
    return replace(target, side_m=floor.side_m or target.side_m, ids=(floor.id,))


def lens_sigma(percent: float | None, cameras: Sequence[Camera]) -> tuple[float, ...] | None:
    """Standard errors of fx, fy, cx, cy (px), k1, k2 for intrinsics whose focal length is known to `percent`; None keeps them.

    Raises:
        InputError: a percentage that is not above 0.
    """
    if percent is None:
        return None
    if not percent > 0:
        raise InputError(f"`focal_known_to_percent={percent:g}`: expected > 0 percent, got {percent:g}")
    focal_px = percent / 100 * float(np.mean([camera.K[0, 0] for camera in cameras]))
    return (focal_px,) * 4 + (_LENS_PER_PERCENT * percent,) * 2


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
