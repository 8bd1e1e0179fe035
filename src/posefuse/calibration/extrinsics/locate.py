"""Where a target is, seen by cameras that are already calibrated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from posefuse.calibration.solving.projection import LENS_PARAMETERS, Lenses
from posefuse.calibration.solving.rotations import Poses, poses_of
from posefuse.calibration.targets.corners import CornerObservations
from posefuse.calibration.targets.kinds import Target, patch_corners
from posefuse.core import SE3, CalibrationError, Rig
from posefuse.core.arrays import Array

from .bootstrap import one_patch, prop_track, prop_views
from .planar import planar_views
from .prop_solve import Freedom, PropState, solve_prop
from .snapshots import Snapshots, snapshots

_MOST_STILL_PX = 3.0
_MOST_STATIC_RMS_PX_PER_1000 = 4.0


def aligned(observations: CornerObservations, rig: Rig) -> CornerObservations:
    """Observations with the rig's cameras in the rig's order; raises CalibrationError for one the rig does not have."""
    unknown = [name for name in observations.cameras if name not in rig.names]
    if unknown:
        raise CalibrationError(
            f"observations of {', '.join(unknown)}: no such camera in the rig; there are: {', '.join(rig.names)}"
        )
    for name, size in zip(observations.cameras, observations.sizes_wh, strict=True):
        if tuple(size) != rig[name].size_wh:
            raise CalibrationError(
                f"camera {name}: images are {size[0]}x{size[1]} px, its calibration {rig[name].size_wh}, in other proportions:"
                " calibrate its intrinsics from images as these are"
            )
    place = np.array([rig.names.index(name) for name in observations.cameras], dtype=np.int64)
    frames = dict(zip(observations.cameras, observations.frame_count, strict=True))
    return replace(
        observations,
        cameras=rig.names,
        sizes_wh=tuple(camera.size_wh for camera in rig),
        frame_count=tuple(frames.get(name, 0) for name in rig.names),
        camera=place[observations.camera] if len(observations) else observations.camera,
    )


def locate_static(rig: Rig, observations: CornerObservations, target: Target, patch: int) -> SE3:
    """world_from_patch of a patch that lies still, from all frames of all cameras that see it.

    Raises:
        CalibrationError: no camera sees it, it moved, or the cameras disagree about where it is.
    """
    mine = aligned(observations, rig).of_patches([patch])
    if len(mine) == 0:
        raise CalibrationError(f"target {patch}: no camera sees it; seen are: {sorted(set(observations.patch.tolist()))}")
    still = _one_frame(mine, patch)
    world_from_patch, residual_px = _solve(rig, snapshots(still, np.zeros(1, np.int64), np.zeros((len(rig), 2))), target)
    width = max(max(camera.size_wh) for camera in rig)
    rms = float(np.sqrt((residual_px**2).mean()))
    limit = _MOST_STATIC_RMS_PX_PER_1000 * width / 1000
    if not rms <= limit:
        raise CalibrationError(
            f"target {patch}: cameras disagree about where it lies, {rms:.1f} px (limit {limit:.1f});"
            " was it moved, is its side right, did a camera move?"
        )
    return world_from_patch[0]


def _one_frame(mine: CornerObservations, patch: int) -> CornerObservations:
    """The median place of every corner in every camera, as one frame at time 0."""
    key = np.stack([mine.camera, mine.corner], axis=1)
    pairs, place = np.unique(key, axis=0, return_inverse=True)
    place = place.ravel()
    middle = np.stack([np.median(mine.xy_img[place == i], axis=0) for i in range(len(pairs))])
    off = np.abs(mine.xy_img - middle[place]).max(axis=1)
    loose = float(np.median(off))
    if loose > _MOST_STILL_PX:
        raise CalibrationError(f"target {patch}: it moves in the images (by {loose:.0f} px); lay it down still")
    n = len(pairs)
    return replace(
        mine, camera=pairs[:, 0], corner=pairs[:, 1], t_ns=np.zeros(n, np.int64), patch=np.full(n, patch), xy_img=middle,
        sharpness=np.full(n, np.nan),
    )  # fmt: skip


def patch_track(rig: Rig, seen: Snapshots, corners: Array) -> Poses:
    """world_from_patch (T,) of one patch as the cameras of the rig see it; NaN where none sees enough of its corners."""
    lenses, shape = Lenses(tuple(rig)), one_patch()
    in_images = prop_views(seen, planar_views(seen, corners, lenses), shape, corners, lenses)
    return prop_track(seen, in_images, shape, corners, lenses, poses_of(rig))


def rig_state(rig: Rig, track: Poses) -> PropState:
    """The start of a solve: the cameras and clocks as in the rig, the patch along its track (T,)."""
    nothing = np.zeros((len(rig), len(LENS_PARAMETERS)))
    return PropState(poses_of(rig), Poses(track.R, np.nan_to_num(track.t)), Poses.identity(1), np.zeros((len(rig), 2)), nothing)


def _solve(rig: Rig, seen: Snapshots, target: Target) -> tuple[SE3, Array]:
    """world_from_patch (T,), and residuals (N, 2) px, predicted minus observed."""
    corners = patch_corners(target, seen.patches)
    track = patch_track(rig, seen, corners)
    known = np.asarray(np.isfinite(track.t).all(axis=1))
    if not known.any():
        raise CalibrationError(f"target {int(seen.patches[0])}: no camera sees 4 of its corners")
    seen = seen.rows(known[seen.time_step])
    solution = solve_prop(seen, corners, tuple(rig), rig_state(rig, track), Freedom(reference=None, held_patches=None))
    poses = Poses(solution.state.world_from_prop.R, np.where(known[:, None], solution.state.world_from_prop.t, np.nan))
    return poses.se3(), solution.residual_px
