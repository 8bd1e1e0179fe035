"""One time step: Views to Pose3D."""

from __future__ import annotations

import numpy as np

from posefuse.core import Kind, Pose3D, Rig, ShapeError, Views
from posefuse.core.arrays import Array
from posefuse.core.depth import keypoint_depth
from posefuse.core.errors import choices

from .settings import FuseSettings
from .triangulation import solved_by, stated_sigma


def fuse(views: Views, rig: Rig, settings: FuseSettings, previous: Pose3D | None = None) -> Pose3D:
    """3D pose of everybody in `views`, each keypoint from this time step's views alone.

    Args:
        views: C cameras named as in `rig`, in its order.
        rig: the cameras.
        settings: weights and thresholds.
        previous: the pose one time step before, where there is one: gives ``all`` its segment axes. Matched by person_id.

    Returns:
        Pose3D: kind FUSED, or MISSING (NaN) where fewer than two usable views agree. Views with depth (``robust`` only) count
            more, and one of them is enough where no other view sees the keypoint.

    Raises:
        ShapeError: cameras that are not the rig's.
    """
    if views.camera_names != rig.names:
        raise ShapeError(f"fuse: views come from cameras {choices(views.camera_names)}, the rig has {choices(rig.names)}")
    xy = np.array(views.xy_img)
    score = np.nan_to_num(views.score)
    sigma = stated_sigma(xy, score, views.sigma_px, settings)
    depth = _depth(views, rig) if settings.weights == "robust" else None
    solved = solved_by(
        settings.weights, rig, xy, score, sigma, settings,
        depth=depth, skeleton=views.skeleton, previous_world=_matched(views, previous),
    )  # fmt: skip
    kind = np.where(solved.n_views > 0, np.uint8(Kind.FUSED), np.uint8(Kind.MISSING))
    return Pose3D(
        t_ns=views.t_ns,
        skeleton=views.skeleton,
        person_id=views.person_id,
        xyz_world=solved.xyz,
        cov_world=solved.cov,
        reproj_px=solved.reproj,
        n_views=solved.n_views,
        kind=kind,
    )


def _depth(views: Views, rig: Rig) -> Array | None:
    """(N, C, K, 2) depth of the keypoints and its standard deviation; None where nothing is known of any."""
    if views.depth_m is None or not np.isfinite(views.depth_m).all(axis=-1).any():
        return None
    norm = np.stack([camera.norm_from_px(views.xy_img[:, c]) for c, camera in enumerate(rig)], axis=1)
    return np.ascontiguousarray(keypoint_depth(views.depth_m, norm, views.skeleton))


def _matched(views: Views, previous: Pose3D | None) -> Array | None:
    """(N, K, 3) the previous points of the same people; NaN for newcomers."""
    if previous is None or previous.skeleton != views.skeleton:
        return None
    places = {int(person): i for i, person in enumerate(previous.person_id)}
    missing = np.full((len(views.skeleton), 3), np.nan)
    rows = [previous.xyz_world[places[int(p)]] if int(p) in places else missing for p in views.person_id]
    return np.array(rows).reshape(-1, len(views.skeleton), 3)
