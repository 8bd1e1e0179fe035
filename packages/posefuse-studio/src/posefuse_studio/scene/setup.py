"""What stays in a scene: cameras, floor, bones and their colours, plots."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from posefuse.core import Rig, Skeleton
from posefuse.core.arrays import Array
from posefuse.core.palette import LEFT, RIGHT
from posefuse.outputs.drawing import bone_colours, keypoint_colours

from .messages import ellipsoid_factors

# how far in front of a camera its image is drawn
_FRUSTUM_M = 0.35
_TRAILS = ("left_wrist", "right_wrist", "left_ankle", "right_ankle")


def scene_setup(
    rig: Rig | None = None,
    skeleton: Skeleton | None = None,
    *,
    plots: Sequence[str] = (),
    faulty: Sequence[str] = (),
    centre_cov: Mapping[str, Array] | None = None,
) -> dict[str, Any]:
    """The setup message's content.

    Args:
        rig: cameras to draw. skeleton: of the poses to come. plots: names of the values to come. faulty: cameras drawn in red.
        centre_cov: (3, 3) covariance of camera centres in m^2, by name; drawn as ellipsoids.
    """
    return {
        "cameras": [_camera(camera, camera.name in faulty, (centre_cov or {}).get(camera.name)) for camera in rig or ()],
        "floor": _floor(rig),
        "plots": list(plots),
        **(_bones(skeleton) if skeleton is not None else {"bones": [], "bone_rgb": [], "keypoint_rgb": [], "trails": []}),
    }


def _bones(skeleton: Skeleton) -> dict[str, Any]:
    return {
        "bones": skeleton.bone_indices.tolist(),
        "bone_rgb": [list(colour) for colour in bone_colours(skeleton)],
        "sides": {"left": LEFT.on_dark, "right": RIGHT.on_dark},
        "keypoint_rgb": [list(colour) for colour in keypoint_colours(skeleton)],
        "trails": [skeleton.index(name) for name in _TRAILS if name in skeleton.keypoints],
    }


def _camera(camera: Any, faulty: bool, cov: Array | None) -> dict[str, Any]:
    width, height = camera.size_wh
    corners = np.array([[0, 0], [width - 1, 0], [width - 1, height - 1], [0, height - 1]], float)
    rays = np.asarray(camera.rays_world(corners), float)
    # all corners in one plane, as far as the middle of the image
    axis = camera.cam_from_world.matrix()[2]
    places = camera.centre_world + rays * (_FRUSTUM_M / (rays @ axis))[:, None]
    shape = None if cov is None else ellipsoid_factors(np.asarray(cov))
    return {
        "name": camera.name,
        "centre": np.round(camera.centre_world, 4).tolist(),
        "corners": np.round(places, 4).tolist(),
        "faulty": faulty,
        "ellipsoid": None if shape is None or not np.isfinite(shape).all() else shape.ravel().tolist(),
    }


def _floor(rig: Rig | None) -> dict[str, Any]:
    """A square of whole metres under the cameras, and where to look."""
    if rig is None or not len(rig):
        return {"centre": [0.0, 0.0], "half_m": 3.0}
    centres = rig.centres_world()
    low, high = centres.min(axis=0), centres.max(axis=0)
    half = float(np.ceil(np.clip(max(high[:2] - low[:2]) / 2 + 0.5, 1.5, 30.0)))
    return {"centre": np.round((low + high)[:2] / 2, 2).tolist(), "half_m": half}
