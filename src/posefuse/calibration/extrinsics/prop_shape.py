"""Which patches sit on the rigid prop, and where: from the target file, or by votes of the images that show two of them.

Votes: Sarmadi et al. (2019).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from posefuse.calibration.solving.rotations import Poses
from posefuse.calibration.targets.kinds import Target, scale_m, sides
from posefuse.core.arrays import Array

from .planar import PlanarViews
from .snapshots import Snapshots
from .voting import Edge, tree, vote

_MARKER_ANGLE_RAD = np.deg2rad(8)
_MARKER_DISTANCE = 0.35
_LEAST_AGREEING, _LEAST_SHARE = 4, 0.5
# the sides of a board locate each other where they are seen together in so many time steps
_LEAST_TOGETHER = 8


@dataclass(frozen=True, eq=False)
class PropShape:
    """Markers on the rigid prop.

    Attributes:
        prop_from_patch: by index of the patch; those that are not on the prop are left out.
        held: patches whose pose on the prop is held: the first one, and those that nothing links to it.
    """

    prop_from_patch: dict[int, Poses]
    held: tuple[int, ...]


def shape_of(target: Target, seen: Snapshots, views: PlanarViews) -> PropShape:
    """Where the patches of a target sit on its prop: from the target file, else from images that show several of them."""
    known = sides(target)
    if known:
        return known_shape(seen, {number: Poses.from_se3(pose) for number, pose in known.items()})
    return prop_shape(views, len(seen.patches), scale_m(target))


def one_patch() -> PropShape:
    """A prop of a single patch, number 0."""
    return PropShape({0: Poses(np.eye(3), np.zeros(3))}, (0,))


def known_shape(seen: Snapshots, prop_from_patch: Mapping[int, Poses]) -> PropShape:
    """A prop with the patch positions of the target file, such as the sides of a board; `prop_from_patch` by patch number.

    Sides that cameras see at the same time step locate each other better than the glue does, so they may move; a side that is
    never seen together with the first keeps its stated position.
    """
    placed = {i: prop_from_patch[int(number)] for i, number in enumerate(seen.patches)}
    root, *others = placed
    steps = {i: np.unique(seen.instant[seen.patch == i]) for i in placed}
    apart = [i for i in others if len(np.intersect1d(steps[i], steps[root])) < _LEAST_TOGETHER]
    return PropShape(placed, (root, *apart))


def prop_shape(views: PlanarViews, patch_count: int, side_m: float) -> PropShape:
    """Which markers sit on one rigid prop and where, from images that show two of them or more.

    Markers that move independently of those with most agreement are left out.
    """
    edges: dict[tuple[int, int], Edge] = {}
    for (i, j), (first, second) in _together(views.camera, views.instant, views.patch, patch_count).items():
        candidates = _relative(views.cam_from_patch[first], views.cam_from_patch[second])
        edge = vote(candidates, _MARKER_ANGLE_RAD, np.full(len(first), _MARKER_DISTANCE * side_m))
        edges[(i, j)] = edge
    strong = {k: e for k, e in edges.items() if e.agreeing >= _LEAST_AGREEING and e.share >= _LEAST_SHARE}
    most_seen = int(np.argmax(np.bincount(views.patch, minlength=patch_count)))
    root, placed = tree(patch_count, strong, None if strong else most_seen)
    return PropShape(placed, (root,))


def _together(camera: Array, instant: Array, patch: Array, count: int) -> dict[tuple[int, int], tuple[Array, Array]]:
    """For each pair of patches i < j: the rows of both in images that show both."""
    image = instant * (int(camera.max(initial=0)) + 1) + camera
    images, image_no = np.unique(image, return_inverse=True)
    row = np.full((len(images), count), -1, np.int64)
    row[image_no, patch] = np.arange(len(patch))
    pairs = {}
    for i in range(count):
        for j in range(i + 1, count):
            both = (row[:, i] >= 0) & (row[:, j] >= 0)
            if both.any():
                pairs[(i, j)] = (row[both, i], row[both, j])
    return pairs


def _relative(cam_from_a: Poses, cam_from_b: Poses) -> Poses:
    """(n, 4) a_from_b of all combinations of alternatives (n, 2) and (n, 2)."""
    a_from_cam = cam_from_a.inverse()
    left = Poses(a_from_cam.R[:, :, None], a_from_cam.t[:, :, None])
    right = Poses(cam_from_b.R[:, None], cam_from_b.t[:, None])
    both = left @ right
    return Poses(both.R.reshape(len(both.R), 4, 3, 3), both.t.reshape(len(both.t), 4, 3))
