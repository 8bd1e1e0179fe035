"""Where the cameras are, from a moving prop or board that nobody measured beyond the side of its squares."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from posefuse.core import CalibrationError, Camera
from posefuse.core.arrays import Array

from .bootstrap import (
    PropShape,
    PropViews,
    camera_edges,
    prop_shape,
    prop_track,
    prop_views,
    strong_camera_edges,
)
from .coverage import linked_groups
from .observations import Observations
from .planar import planar_views
from .projection import Lenses
from .prop_solve import Freedom, PropSolution, PropState, solve_prop
from .rotations import Poses, stacked
from .snapshots import Snapshots, pick_instants, snapshots
from .targets import Markers, Target
from .voting import tree

_LEAST_INSTANTS = 8


@dataclass(frozen=True)
class Options:
    """How to solve.

    Attributes:
        instants: key instants used at most.
        clocks: ``together`` (cameras are synchronised), ``offset`` or ``drift`` (estimate each camera's clock).
        most_offset_s: largest offset searched for.
        refine_lenses: let focal length, principal point and the first two radial terms move a little.
    """

    instants: int = 240
    clocks: str = "together"
    most_offset_s: float = 0.3
    refine_lenses: bool = False


@dataclass(frozen=True, eq=False)
class PropResult:
    """A solved rig before any check, in the frame of its reference camera."""

    seen: Snapshots
    solution: PropSolution
    shape: PropShape
    reference: int
    corners: Array
    notes: tuple[str, ...]


def target_corners(target: Target, patches: Array) -> Array:
    """(M, n, 3) corners of each patch in its own frame."""
    return np.stack([target.corners(int(patch)) for patch in patches])


def solve_extrinsics(observations: Observations, cameras: tuple[Camera, ...], target: Target, delay_s: Array, options: Options) -> PropResult:
    """Bootstrap and bundle adjustment at key instants, cameras' clocks starting from `delay_s` (C, 2)."""
    instants = pick_instants(observations, options.instants, delay_s, prefer_slow=options.clocks == "together")
    seen = snapshots(observations, instants, delay_s)
    corners = target_corners(target, seen.patches)
    lenses = Lenses(cameras)
    views = planar_views(seen, corners, lenses)
    side = target.side_m if isinstance(target, Markers) else 1.0
    shape = prop_shape(views, len(seen.patches), side)
    in_images = prop_views(seen, views, shape, corners, lenses)
    edges = camera_edges(in_images, len(cameras))
    reference, placed = tree(len(cameras), strong_camera_edges(edges))
    if len(placed) < len(cameras):
        missing = [observations.cameras[i] for i in range(len(cameras)) if i not in placed]
        raise CalibrationError(f"unlinked {missing} {[(k, e.agreeing, e.share) for k, e in edges.items()]}")
    cam_from_world = stacked([placed[i] for i in range(len(cameras))]).inverse()
    track = prop_track(seen, in_images, shape, corners, lenses, cam_from_world)
    used = np.isfinite(track.t).all(axis=1)
    keep = used[seen.instant] & np.isin(seen.patch, list(shape.prop_from_patch))
    seen = seen.rows(keep)
    patch = stacked([shape.prop_from_patch.get(i, Poses(np.eye(3), np.zeros(3))) for i in range(len(seen.patches))])
    start = PropState(cam_from_world, Poses(track.R, np.nan_to_num(track.t)), patch, delay_s, np.zeros((len(cameras), 6)))
    freedom = Freedom(reference, shape.root, options.clocks != "together", options.clocks == "drift", None)
    solution = solve_prop(seen, corners, cameras, start, freedom)
    return PropResult(seen, solution, shape, reference, corners, ())
