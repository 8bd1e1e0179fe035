"""A first, rough answer for cameras that watch a prop: where each is, with the planar ambiguity decided by votes.

Sarmadi et al. (2019): pairwise poses of markers seen together, then of cameras that see the prop together, each pair
settled by the candidate that agrees with most of the others, then the strongest paths through the two graphs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import combinations

import cv2
import numpy as np

from posefuse.calibration.clocks.start import STEP_S, EvenTrack, agreed_clocks
from posefuse.calibration.geometry import Lenses, Poses, nearest_rotation, stacked
from posefuse.calibration.targets.corners import CornerObservations
from posefuse.calibration.targets.kinds import Markers, Target, in_a_plane, patch_corners, scale_m
from posefuse.core import Camera
from posefuse.core.arrays import Array

from .snapshots import Snapshots, evenly, snapshots

_MOST_VOTING_SEEDS = 48
_CUT = 3.0


@dataclass(frozen=True, eq=False)
class Edge:
    """How two nodes lie to each other: a_from_b, the number of estimates that agree and their share."""

    a_from_b: Poses
    agreeing: int
    share: float
    score: float


def vote(candidates: Poses, angle_rad: float, distance_m: Array) -> Edge:
    """The transform most estimates agree with.

    Args:
        candidates: (n, h) estimates, h alternatives each, of which at most one is right; NaN where there is none.
        angle_rad: scale of what counts as agreeing.
        distance_m: (n,) likewise, for each estimate.
    """
    seeds = candidates[evenly(np.arange(len(candidates)), _MOST_VOTING_SEEDS)].listed
    cosine = (np.einsum("sij,nhij->snh", seeds.R, candidates.R) - 1) / 2
    angle = np.arccos(np.clip(cosine, -1, 1)) / angle_rad
    distance = np.linalg.norm(seeds.t[:, None, None] - candidates.t, axis=-1) / distance_m[:, None]
    return best_seed(seeds, np.nan_to_num(angle**2 + distance**2, nan=np.inf).min(axis=2))


def best_seed(seeds: Poses, square: Array) -> Edge:
    """The seed that fits most estimates. square: (seeds, n) squared distance of each estimate from each seed, in its scale."""
    gain = np.maximum(0, 1 - square / _CUT**2)
    best = int(np.argmax(gain.sum(axis=1)))
    agreeing = int((gain[best] > 0).sum())
    return Edge(seeds[best], agreeing, agreeing / square.shape[1], float(gain[best].sum()))


def tree(count: int, edges: Mapping[tuple[int, int], Edge], root: int | None = None) -> tuple[int, dict[int, Poses]]:
    """Follow the strongest edges (Prim 1957): the root and root_from_node of every node that can be reached.

    Without a root, the node with most agreement over its edges is taken.
    """
    strength = np.zeros(count)
    for (a, b), edge in edges.items():
        strength[a] += edge.score
        strength[b] += edge.score
    root = int(np.argmax(strength)) if root is None else root
    reached = {root: Poses(np.eye(3), np.zeros(3))}
    while True:
        front = [(e.score, -a, -b) for (a, b), e in edges.items() if (a in reached) != (b in reached)]
        if not front:
            return root, reached
        _, a, b = max(front)
        edge = edges[(-a, -b)]
        if -a in reached:
            reached[-b] = reached[-a] @ edge.a_from_b
        else:
            reached[-a] = reached[-b] @ edge.a_from_b.inverse()


_CLEAR_RATIO = 6.0
_LEAST_POINTS = 4


@dataclass(frozen=True, eq=False)
class PlanarViews:
    """One row per patch seen in an image.

    Attributes:
        camera, time step, patch: (D,).
        cam_from_patch: (D, 2), the better solution first; NaN where the second is ruled out by its error.
        rows: (D, 2) first and last + 1 row in the snapshots.
    """

    camera: Array
    time_step: Array
    patch: Array
    cam_from_patch: Poses
    rows: Array


def planar_views(seen: Snapshots, corners: Array, lenses: Lenses) -> PlanarViews:
    """Both poses of every patch in every image; patches with fewer than 4 corners there are left out."""
    starts = seen.group_starts()
    ends = np.append(starts[1:], len(seen.group))
    big = ends - starts >= _LEAST_POINTS
    starts, ends = starts[big], ends[big]
    norm = lenses.norm_from_px(seen.camera, seen.xy_img)
    R, t = np.full((len(starts), 2, 3, 3), np.nan), np.full((len(starts), 2, 3), np.nan)
    error, middle = np.full((len(starts), 2), np.inf), np.zeros((len(starts), 3))
    finite, shapes = np.asarray(np.isfinite(norm).all(axis=1)), _Shapes(corners)
    for d, (first, end) in enumerate(zip(starts, ends, strict=True)):
        flat, middle[d] = shapes.of(int(seen.patch[first]), seen.corner[first:end])
        if flat is not None and finite[first:end].all():
            for h, (rotation, shift, off) in enumerate(_two_poses(flat, norm[first:end])):
                R[d, h], t[d, h], error[d, h] = rotation, shift, off
    t -= (R @ middle[:, None, :, None])[..., 0]
    clear = error[:, 1] > _CLEAR_RATIO * error[:, 0]
    R[clear, 1], t[clear, 1] = np.nan, np.nan
    good = np.isfinite(error[:, 0])
    return PlanarViews(
        seen.camera[starts][good], seen.time_step[starts][good], seen.patch[starts][good], Poses(R[good], t[good]),
        np.stack([starts, ends], axis=1)[good],
    )  # fmt: skip


class _Shapes:
    """Corners about their middle, worked out once for every set of corners that is met; corners: (M, n, 3)."""

    def __init__(self, corners: Array) -> None:
        self._corners = corners
        self._known: dict[tuple[int, bytes], tuple[Array | None, Array]] = {}

    def of(self, patch: int, corner: Array) -> tuple[Array | None, Array]:
        """Corners (n, 3) of a patch about their middle, None where they lie on a line; and the middle (3,)."""
        key = patch, corner.tobytes()
        if key not in self._known:
            xyz = self._corners[patch, corner]
            middle = xyz.mean(axis=0)
            self._known[key] = (xyz - middle if in_a_plane(xyz) else None), middle
        return self._known[key]


def _two_poses(flat: Array, norm: Array) -> list[tuple[Array, Array, float]]:
    """Rotation, shift of the middle and rms of the poses that put all corners in front of the camera, the better first."""
    count, rotations, shifts, errors = cv2.solvePnPGeneric(flat, norm, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
    poses = []
    for i in range(min(count, 2)):
        rotation, shift = cv2.Rodrigues(rotations[i])[0], shifts[i].ravel()
        # a pose that is not finite is not in front either
        if (flat @ rotation[2]).min() + shift[2] > 0:
            poses.append((rotation, shift, float(np.ravel(errors[i])[0])))
    return poses


_MARKER_ANGLE_RAD = np.deg2rad(8)
_MARKER_DISTANCE = 0.35
_AGREEING_MARKERS, _LEAST_SHARE = 4, 0.5


@dataclass(frozen=True, eq=False)
class PropShape:
    """Markers on the rigid prop.

    Attributes:
        prop_from_patch: by index of the patch; those that are not on the prop are left out.
        held: the patch whose pose on the prop is held.
    """

    prop_from_patch: dict[int, Poses]
    held: tuple[int, ...]


def shape_of(target: Target, seen: Snapshots, views: PlanarViews) -> PropShape:
    """Where the patches of a target sit on its prop: a board is one patch, markers are placed by images that show several."""
    if not isinstance(target, Markers):
        return PropShape({0: Poses(np.eye(3), np.zeros(3))}, (0,))
    return prop_shape(views, len(seen.patches), scale_m(target))


def prop_shape(views: PlanarViews, patch_count: int, side_m: float) -> PropShape:
    """Which markers sit on one rigid prop and where, from images that show two of them or more.

    Markers that move independently of those with most agreement are left out.
    """
    edges: dict[tuple[int, int], Edge] = {}
    images = views.time_step * (int(views.camera.max(initial=0)) + 1) + views.camera
    for (i, j), (first, second) in _together(images, views.patch, patch_count).items():
        candidates = _relative(views.cam_from_patch[first], views.cam_from_patch[second])
        edge = vote(candidates, _MARKER_ANGLE_RAD, np.full(len(first), _MARKER_DISTANCE * side_m))
        edges[(i, j)] = edge
    strong = {k: e for k, e in edges.items() if e.agreeing >= _AGREEING_MARKERS and e.share >= _LEAST_SHARE}
    most_seen = int(np.argmax(np.bincount(views.patch, minlength=patch_count)))
    root, placed = tree(patch_count, strong, None if strong else most_seen)
    return PropShape(placed, (root,))


def _together(place: Array, item: Array, count: int) -> dict[tuple[int, int], tuple[Array, Array]]:
    """For each pair of items i < j of all `count`: the rows of both at places (N,), images or time steps, that have both."""
    places, number = np.unique(place, return_inverse=True)
    row = np.full((len(places), count), -1, np.int64)
    row[number, item] = np.arange(len(item))
    pairs = {}
    for i, j in combinations(range(count), 2):
        both = (row[:, i] >= 0) & (row[:, j] >= 0)
        if both.any():
            pairs[(i, j)] = (row[both, i], row[both, j])
    return pairs


def _relative(cam_from_a: Poses, cam_from_b: Poses) -> Poses:
    """(n, 4) a_from_b of all combinations of alternatives (n, 2) and (n, 2)."""
    both = cam_from_a.inverse()[:, :, None] @ cam_from_b[:, None]
    return Poses(both.R.reshape(-1, 4, 3, 3), both.t.reshape(-1, 4, 3))


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
    return (views.cam_from_patch[rows] @ patch_from_prop[:, None]).listed


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


def camera_edges(views: PropViews, camera_count: int) -> dict[tuple[int, int], Edge]:
    """Relative poses of cameras, from time steps at which two of them see the prop."""
    pairs = _together(views.time_step, views.camera, camera_count)
    return {pair: _camera_vote(*(views.cam_from_prop[rows] for rows in both)) for pair, both in pairs.items()}


def _camera_vote(a_from_prop: Poses, b_from_prop: Poses) -> Edge:
    """a_from_b of most agreement; two cameras agree where b's prop lands on a's, which is what is well known."""
    some = evenly(np.arange(len(a_from_prop)), _MOST_SEEDS)
    seeds = (a_from_prop[some][:, :, None] @ b_from_prop[some][:, None].inverse()).listed
    moved = seeds[:, None, None] @ b_from_prop[None]
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
        flat = (world_from_cam[:, None] @ views.cam_from_prop[mine]).listed
        rows = np.arange(first_row[k], first_row[k + 1])
        rows = rows[np.isfinite(xyz_prop[rows]).all(axis=1)]
        cost = np.zeros(len(flat))
        for c in np.unique(seen.camera[rows]):
            some = rows[seen.camera[rows] == c]
            cost += _misfit(cam_from_world[c : c + 1] @ flat, xyz_prop[some], norm[some])
        best = int(np.argmin(cost))
        R[k], t[k] = flat.R[best], flat.t[best]
    return Poses(R, t)


def prop_path(seen: Snapshots, shape: PropShape, corners: Array, lenses: Lenses, cam_from_world: Poses) -> Poses:
    """The same from the corners alone."""
    views = prop_views(seen, planar_views(seen, corners, lenses), shape, corners, lenses)
    return prop_track(seen, views, shape, corners, lenses, cam_from_world)


# two cameras' clocks may be so far apart
MOST_OFFSET_S = 2.0
_WINDOWS, _WINDOW_S = 4, 10.0


def rough_offsets(observations: CornerObservations, cameras: tuple[Camera, ...], target: Target) -> Array:
    """(C,) offset of each camera's clock in s against the first one that is linked, to about half a step of the search.

    NaN for cameras whose path overlaps with none of the others.
    """
    paths = _paths(observations, cameras, target)

    def misfit_m(a: int, b: int) -> Callable[[Array, Array], float]:
        return lambda rows_a, rows_b: _misfit_m(paths[a].xy[rows_a, 0], paths[b].xy[rows_b, 0])

    return agreed_clocks(paths, misfit_m, MOST_OFFSET_S).offset_s


def _paths(observations: CornerObservations, cameras: tuple[Camera, ...], target: Target) -> list[EvenTrack]:
    """Places of the prop in each camera's axes in m, in a few windows of the recording."""
    first = int(observations.t_ns.min())
    step, window = round(STEP_S * 1e9), round(_WINDOW_S / STEP_S)
    count = int(observations.t_ns.max() - first) // step + 1
    begins = np.linspace(0, max(count - window, 0), _WINDOWS).astype(np.int64)
    steps = np.unique(np.add.outer(begins, np.arange(window)).clip(0, count - 1))
    seen = snapshots(observations, first + steps * step, np.zeros((len(cameras), 2)))
    corners, lenses = patch_corners(target, seen.patches), Lenses(cameras)
    planar = planar_views(seen, corners, lenses)
    views = prop_views(seen, planar, shape_of(target, seen, planar), corners, lenses)
    xyz = np.full((len(cameras), count, 1, 3), np.nan)
    xyz[views.camera, steps[views.time_step], 0] = views.cam_from_prop.t[:, 0]
    return [EvenTrack(0, one) for one in xyz]


def _misfit_m(a: Array, b: Array) -> float:
    """Robust spread in m left between places a (n, 3) and b (n, 3) moved rigidly onto them."""
    weight = np.ones(len(a))
    for _ in range(4):
        off = np.linalg.norm(a - _fitted(a, b, weight), axis=1)
        scale = max(float(np.median(off)), 1e-6)
        weight = 1 / (1 + (off / scale) ** 2)
    return float(np.sqrt((weight * off**2).sum() / weight.sum()))


def _fitted(a: Array, b: Array, weight: Array) -> Array:
    """Points b (n, 3) moved rigidly onto a (n, 3)."""
    total = weight.sum()
    middle_a, middle_b = weight @ a / total, weight @ b / total
    rotation = nearest_rotation((weight[:, None] * (a - middle_a)).T @ (b - middle_b))
    return np.asarray((b - middle_b) @ rotation.T + middle_a)
