"""Which points a camera sees.

A joint lies inside the body, so the first surface on the line of sight is nearly always before it. A joint counts as
hidden when that surface is further before it than the flesh around the joint is thick (`FLESH_M`): then it belongs to
another limb, another person or a thing. Two ways to find the surface: the depth of the rendered image, which is
exact, and, without rendering, `hidden_by_shapes`: boxes exactly, people as capsules between their keypoints.
"""

from __future__ import annotations

import numpy as np

from posefuse.core import Camera
from posefuse.core.arrays import Array
from posefuse.core.skeleton import ANATOMICAL23

from .surroundings import Box

_FLESH_OF_JOINT_M = {
    "nose": 0.05, "eye": 0.05, "ear": 0.06, "shoulder": 0.12, "elbow": 0.08, "wrist": 0.07, "hip": 0.17, "knee": 0.10,
    "ankle": 0.08, "big_toe": 0.06, "small_toe": 0.06, "heel": 0.07,
}  # fmt: skip
FLESH_M = np.array([_FLESH_OF_JOINT_M[name.removeprefix("left_").removeprefix("right_")] for name in ANATOMICAL23.keypoints])

# ends of each capsule (the mean of the named keypoints) and its radius, for an adult
_SIDED_CAPSULES = (
    (("shoulder",), ("elbow",), 0.050),
    (("elbow",), ("wrist",), 0.038),
    (("hip",), ("knee",), 0.075),
    (("knee",), ("ankle",), 0.052),
    (("heel",), ("big_toe",), 0.025),
    (("shoulder",), ("hip",), 0.085),
)
_MIDDLE_CAPSULES = (
    (("left_shoulder", "right_shoulder"), ("left_hip", "right_hip"), 0.115),
    (("left_shoulder", "right_shoulder"), ("left_ear", "right_ear"), 0.060),
    (("left_ear", "right_ear"), ("left_ear", "right_ear"), 0.085),
)
_CAPSULES = (
    tuple(
        (tuple(f"{side}_{a}" for a in start), tuple(f"{side}_{b}" for b in end), radius)
        for side in ("left", "right")
        for start, end, radius in _SIDED_CAPSULES
    )
    + _MIDDLE_CAPSULES
)
_TINY = 1e-12


def in_image(camera: Camera, xy_img: Array) -> Array:
    """(...) whether pixels (..., 2) lie on the image; False for NaN."""
    return np.asarray((xy_img >= -0.5).all(axis=-1) & (xy_img < np.array(camera.size_wh) - 0.5).all(axis=-1))


def hidden_by_shapes(eye_world: Array, xyz_world: Array, flesh_m: Array, boxes: tuple[Box, ...], people: Array) -> Array:
    """(F, Q) whether points (F, Q, 3) are hidden from the eye (3,) by boxes or by people (F, N, 23, 3) as capsules.

    A surface less than `flesh_m` (Q,) before a point does not hide it.
    """
    hidden = np.zeros(xyz_world.shape[:-1], bool)
    for box in boxes:
        hidden |= box.between(eye_world, xyz_world)
    way = xyz_world - eye_world
    length = np.linalg.norm(way, axis=-1)
    free_m = length - flesh_m
    direction = way / np.maximum(length, _TINY)[..., None]
    for person in range(people.shape[1]):
        for start, end, radius in _CAPSULES:
            ends = [people[:, person, ANATOMICAL23.indices(names)].mean(axis=1) for names in (start, end)]
            hidden |= _enters_at(eye_world, direction, ends[0][:, None], ends[1][:, None], radius) < free_m
    return hidden


def _enters_at(eye: Array, direction: Array, start: Array, end: Array, radius: float) -> Array:
    """Distance from the eye at which unit directions (F, Q, 3) enter a capsule, infinity where they pass it."""
    axis = end - start
    offset = eye - start
    along_axis = (direction * axis).sum(-1)
    axis_square = np.maximum((axis * axis).sum(-1), _TINY)
    offset_axis, offset_ray = (offset * axis).sum(-1), (offset * direction).sum(-1)
    # nearest points of line and axis; the axis ends at its ends
    below = np.maximum(axis_square - along_axis**2, _TINY)
    share = np.clip((offset_axis - along_axis * offset_ray) / below, 0, 1)
    nearest = start + share[..., None] * axis
    to_nearest = nearest - eye
    at = (to_nearest * direction).sum(-1)
    miss_square = (to_nearest**2).sum(-1) - at**2
    depth = np.sqrt(np.maximum(radius**2 - miss_square, 0))
    return np.where((miss_square < radius**2) & (at > 0), at - depth, np.inf)
