"""A first, rough answer for cameras that watch a prop: where each is, with the planar ambiguity decided by votes.

Sarmadi et al. (2019): pairwise poses of markers seen together, then of cameras that see the prop together, each pair
settled by the candidate that agrees with most of the others, then the strongest paths through the two graphs.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from posefuse.calibration.solving.projection import Lenses
from posefuse.calibration.solving.rotations import Poses, stacked
from posefuse.calibration.targets.kinds import Target, scale_m, sides
from posefuse.core.arrays import Array

from .planar import PlanarViews
from .snapshots import Snapshots
from .voting import Edge, best_seed, seeds_of, tree, vote

_MARKER_ANGLE_RAD = np.deg2rad(8)
_MARKER_DISTANCE = 0.35
_AGREEING_MARKERS, _LEAST_SHARE = 4, 0.5
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
    steps = {i: np.unique(seen.time_step[seen.patch == i]) for i in placed}
    apart = [i for i in others if len(np.intersect1d(steps[i], steps[root])) < _LEAST_TOGETHER]
    return PropShape(placed, (root, *apart))


def prop_shape(views: PlanarViews, patch_count: int, side_m: float) -> PropShape:
    """Which markers sit on one rigid prop and where, from images that show two of them or more.

    Markers that move independently of those with most agreement are left out.
    """
    edges: dict[tuple[int, int], Edge] = {}
    for (i, j), (first, second) in _together(views.camera, views.time_step, views.patch, patch_count).items():
        candidates = _relative(views.cam_from_patch[first], views.cam_from_patch[second])
        edge = vote(candidates, _MARKER_ANGLE_RAD, np.full(len(first), _MARKER_DISTANCE * side_m))
        edges[(i, j)] = edge
    strong = {k: e for k, e in edges.items() if e.agreeing >= _AGREEING_MARKERS and e.share >= _LEAST_SHARE}
    most_seen = int(np.argmax(np.bincount(views.patch, minlength=patch_count)))
    root, placed = tree(patch_count, strong, None if strong else most_seen)
    return PropShape(placed, (root,))


def _together(camera: Array, time_step: Array, patch: Array, count: int) -> dict[tuple[int, int], tuple[Array, Array]]:
    """For each pair of patches i < j: the rows of both in images that show both."""
    image = time_step * (int(camera.max(initial=0)) + 1) + camera
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


_CAMERA_ANGLE_RAD = np.deg2rad(6)
_CAMERA_DISTANCE = 0.06
_LEAST_AGREEING, _LEAST_CAMERA_SHARE = 4, 0.3
_MOST_SEEDS = 64
_REPROJECTION_CUT_NORM = 0.02


@dataclass(frozen=True, eq=False)
class PropViews:
    """The prop in single images.

    Attributes:
        camera, time step: (V,). cam_from_prop: (V, 2) alternatives, the better first; NaN where there is none.
    """

    camera: Array
    time_step: Array
    cam_from_prop: Poses


def prop_views(seen: Snapshots, views: PlanarViews, shape: PropShape, corners: Array, lenses: Lenses) -> PropViews:
    """The prop's pose in every image, from the marker and solution that explains all its markers in that image best."""
    norm = lenses.norm_from_px(seen.camera, seen.xy_img)
    known = np.isin(views.patch, list(shape.prop_from_patch))
    order = np.flatnonzero(known)[np.lexsort((views.camera[known], views.time_step[known]))]
    key = np.stack([views.time_step[order], views.camera[order]])
    cuts = np.flatnonzero((np.diff(key, axis=1) != 0).any(axis=0)) + 1
    cameras, time_steps, R, t = [], [], [], []
    for rows in np.split(order, cuts) if len(order) else []:
        candidates = _candidates(views, shape, rows)
        xyz, xy = _image_points(seen, views, shape, corners, norm, rows)
        best = _best_two(candidates, xyz, xy, single=len(rows) == 1)
        cameras.append(views.camera[rows[0]])
        time_steps.append(views.time_step[rows[0]])
        R.append(best.R)
        t.append(best.t)
    if not R:
        return PropViews(np.zeros(0, np.int64), np.zeros(0, np.int64), Poses(np.zeros((0, 2, 3, 3)), np.zeros((0, 2, 3))))
    return PropViews(np.array(cameras), np.array(time_steps), Poses(np.stack(R), np.stack(t)))


def _candidates(views: PlanarViews, shape: PropShape, rows: Array) -> Poses:
    patch_from_prop = stacked([shape.prop_from_patch[int(p)] for p in views.patch[rows]]).inverse()
    cam_from_patch = views.cam_from_patch[rows]
    both = cam_from_patch @ Poses(patch_from_prop.R[:, None], patch_from_prop.t[:, None])
    flat = Poses(both.R.reshape(-1, 3, 3), both.t.reshape(-1, 3))
    return flat[np.isfinite(flat.t).all(axis=1)]


def _image_points(
    seen: Snapshots, views: PlanarViews, shape: PropShape, corners: Array, norm: Array, rows: Array
) -> tuple[Array, Array]:
    xyz, xy = [], []
    for row in rows:
        first, end = views.rows[row]
        patch = int(views.patch[row])
        xyz.append(shape.prop_from_patch[patch].move(corners[patch, seen.corner[first:end]]))
        xy.append(norm[first:end])
    return np.concatenate(xyz), np.concatenate(xy)


def _best_two(candidates: Poses, xyz: Array, xy: Array, single: bool) -> Poses:
    """The best candidate, and where one flat marker is all there is, its twin."""
    cost = _misfit(candidates, xyz, xy)
    order = np.argsort(cost, kind="stable")
    best = candidates[order[:1]]
    second = candidates[order[1:2]] if single and len(order) > 1 else Poses(np.full((1, 3, 3), np.nan), np.full((1, 3), np.nan))
    return Poses(np.concatenate([best.R, second.R]), np.concatenate([best.t, second.t]))


def _misfit(cam_from_prop: Poses, xyz: Array, xy: Array) -> Array:
    """(k,) sum of capped squares on the ideal image plane of points (n, 3) against (n, 2), for k poses."""
    moved = xyz @ np.swapaxes(cam_from_prop.R, -1, -2) + cam_from_prop.t[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        off = moved[..., :2] / moved[..., 2:] - xy
    square = np.where(moved[..., 2] > 0, (off**2).sum(axis=-1), np.inf)
    return np.asarray(np.minimum(square, _REPROJECTION_CUT_NORM**2).sum(axis=1))


def camera_edges(views: PropViews, camera_count: int, cam_from_prop: Poses | None = None) -> dict[tuple[int, int], Edge]:
    """Relative poses of cameras, from time steps at which two of them see the prop."""
    edges: dict[tuple[int, int], Edge] = {}
    poses = views.cam_from_prop if cam_from_prop is None else cam_from_prop
    time_steps, place = np.unique(views.time_step, return_inverse=True)
    row = np.full((len(time_steps), camera_count), -1, np.int64)
    row[place, views.camera] = np.arange(len(views.camera))
    for a in range(camera_count):
        for b in range(a + 1, camera_count):
            both = (row[:, a] >= 0) & (row[:, b] >= 0)
            if both.any():
                in_a, in_b = poses[row[both, a]], poses[row[both, b]]
                edges[(a, b)] = _camera_vote(in_a, in_b)
    return edges


def _camera_vote(a_from_prop: Poses, b_from_prop: Poses) -> Edge:
    """a_from_b of most agreement; two cameras agree where b's prop lands on a's, which is what is well known."""
    b_from_props = Poses(b_from_prop.R[:, None], b_from_prop.t[:, None])
    prop_from_b = b_from_props.inverse()
    candidates = Poses(a_from_prop.R[:, :, None], a_from_prop.t[:, :, None]) @ prop_from_b
    candidates = Poses(candidates.R.reshape(-1, 4, 3, 3), candidates.t.reshape(-1, 4, 3))
    seeds = seeds_of(candidates, _MOST_SEEDS)
    moved = Poses(seeds.R[:, None, None], seeds.t[:, None, None]) @ Poses(b_from_prop.R[None], b_from_prop.t[None])
    depth = np.maximum(a_from_prop.t[:, :1, 2], 1e-6)
    off = np.linalg.norm(moved.t[:, :, None] - a_from_prop.t[None, :, :, None], axis=-1) / (_CAMERA_DISTANCE * depth[..., None])
    cosine = (np.einsum("snkij,nhij->snhk", moved.R, a_from_prop.R) - 1) / 2
    turn = np.arccos(np.clip(cosine, -1, 1)) / (2 * _CAMERA_ANGLE_RAD)
    return best_seed(seeds, np.nan_to_num(off**2 + turn**2, nan=np.inf).min(axis=(2, 3)))


def strong_camera_edges(edges: dict[tuple[int, int], Edge]) -> dict[tuple[int, int], Edge]:
    """Pairs whose agreement can be built on."""
    return {k: e for k, e in edges.items() if e.agreeing >= _LEAST_AGREEING and e.share >= _LEAST_CAMERA_SHARE}


def prop_track(
    seen: Snapshots, views: PropViews, shape: PropShape, corners: Array, lenses: Lenses, cam_from_world: Poses
) -> Poses:
    """world_from_prop (T,): at each time step the single view's pose that all cameras' corners agree with; NaN where unseen."""
    norm = lenses.norm_from_px(seen.camera, seen.xy_img)
    patch_pose = stacked([shape.prop_from_patch.get(i, Poses(np.eye(3), np.full(3, np.nan))) for i in range(len(seen.patches))])
    xyz_prop = patch_pose[seen.patch].move(corners[seen.patch, seen.corner])
    count = len(seen.t_s)
    R, t = np.tile(np.eye(3), (count, 1, 1)), np.full((count, 3), np.nan)
    first_row = np.searchsorted(seen.time_step, np.arange(count + 1))
    for k in np.unique(views.time_step):
        mine = views.time_step == k
        world_from_cam = cam_from_world[views.camera[mine]].inverse()
        both = Poses(world_from_cam.R[:, None], world_from_cam.t[:, None]) @ views.cam_from_prop[mine]
        flat = Poses(both.R.reshape(-1, 3, 3), both.t.reshape(-1, 3))
        flat = flat[np.isfinite(flat.t).all(axis=1)]
        rows = np.arange(first_row[k], first_row[k + 1])
        rows = rows[np.isfinite(xyz_prop[rows]).all(axis=1)]
        cost = np.zeros(len(flat))
        for c in np.unique(seen.camera[rows]):
            some = rows[seen.camera[rows] == c]
            in_cam = Poses(cam_from_world.R[c][None], cam_from_world.t[c][None]) @ flat
            cost += _misfit(in_cam, xyz_prop[some], norm[some])
        best = int(np.argmin(cost))
        R[k], t[k] = flat.R[best], flat.t[best]
    return Poses(R, t)
