"""Views of one time step, or raw pixels of several calibrated cameras, to 3D points with covariance, by any weights.

Which views are rejected is decided in `kernels.robust`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any

import numpy as np

from posefuse.core import ConfigError, Detections2D, Kind, Pose3D, PoseSequence, Rig, ShapeError, Skeleton, Views, ViewSequence
from posefuse.core.arrays import Array
from posefuse.core.depth import keypoint_depth
from posefuse.core.errors import choices
from posefuse.core.lens import padded, slopes
from posefuse.core.rig import packed_rig
from posefuse.core.skeleton import LIMB_ENDS, SIDES, pick_keypoints

from .settings import WEIGHTS, FuseSettings, Weights

# Body segments of the paper and how squarely each camera sees them (the weight w_o).
#
# Segment Z axes run along the bone, proximally: forearm wrist -> elbow, upper arm elbow -> shoulder, shank ankle -> knee,
# thigh knee -> hip, trunk pelvis centre -> neck. Each keypoint belongs to one segment, see `SEGMENT_OF`: a joint to the
# segment that ends in it distally (wrist and hand to the forearm, elbow to the upper arm, ankle and foot to the shank,
# knee to the thigh); shoulders, hips, neck and mid-hip to the trunk. Face and head keypoints belong to none: a head is
# round, w_o = 1.

# segment -> (where its Z axis starts, where it points)
SEGMENTS: dict[str, tuple[str, str]] = {"trunk": ("mid_hip", "neck")} | {
    f"{side}_{limb}": (f"{side}_{lower}", f"{side}_{upper}") for side in SIDES for limb, (upper, lower) in LIMB_ENDS.items()
}

_MEMBERS = {
    "forearm": ("wrist", "wrist_lateral", "wrist_medial", "pinky", "index", "thumb"),
    "upper_arm": ("elbow", "elbow_lateral", "elbow_medial"),
    "shank": (
        "ankle", "ankle_lateral", "ankle_medial", "heel", "foot_index", "big_toe", "small_toe", "fifth_metatarsal", "toe_marker",
    ),
    "thigh": ("knee", "knee_lateral", "knee_medial"),
}  # fmt: skip
_OF_TRUNK = ("shoulder", "shoulder_marker", "hip", "asis", "psis")

# keypoint -> segment
SEGMENT_OF: dict[str, str] = dict.fromkeys(
    ("neck", "mid_hip", "sternum", "c7", "t6", "t11", "l2", *(f"{side}_{part}" for side in SIDES for part in _OF_TRUNK)), "trunk"
) | {f"{side}_{member}": f"{side}_{limb}" for side in SIDES for limb, members in _MEMBERS.items() for member in members}


@lru_cache(maxsize=16)
def _segment_index(skeleton: Skeleton) -> Array:
    names = list(SEGMENTS)
    return np.array([names.index(SEGMENT_OF[k]) if k in SEGMENT_OF else -1 for k in skeleton.keypoints])


def side_view(rig: Rig, skeleton: Skeleton, xyz_world: Array) -> Array:
    """The orthogonality index w_o = 1 - |o . z| of METHOD, (..., C, K), from a pose (..., K, 3).

    o is the camera's optical axis, z the Z axis of the keypoint's segment. 1 where the keypoint belongs to no segment;
    NaN where its segment is missing in the pose.
    """
    starts, ends = zip(*SEGMENTS.values(), strict=True)
    along = pick_keypoints(xyz_world, skeleton, ends) - pick_keypoints(xyz_world, skeleton, starts)
    length = np.linalg.norm(along, axis=-1, keepdims=True)
    axes = along / np.where(length > 1e-6, length, np.nan)
    optical = np.stack([camera.cam_from_world.matrix()[2] for camera in rig])
    seen = 1 - np.abs(np.einsum("ci,...si->...cs", optical, axes))
    index = _segment_index(skeleton)
    return np.asarray(np.where(index >= 0, seen[..., index], 1.0))


def score_weight(score: Array, settings: FuseSettings) -> Array:
    """w_s = score^2, and 0 below the threshold."""
    return np.where(score >= settings.score_threshold, score * score, 0.0)


def distance_weight(distance_m: Array, settings: FuseSettings) -> Array:
    """w_d: 1 between distance_min_m and distance_max_m, falling linearly to 0 over distance_fall_m outside."""
    near = (distance_m - settings.distance_min_m) / settings.distance_fall_m + 1
    far = (settings.distance_max_m - distance_m) / settings.distance_fall_m + 1
    return np.clip(np.minimum(near, far), 0.0, 1.0)


def full_weight(rig: Rig, skeleton: Skeleton, score: Array, xyz_world: Array, settings: FuseSettings) -> Array:
    """w = w_s (w_o + w_d) / 2, (..., C, K), about a pose (..., K, 3); w_s alone where the pose is missing."""
    distance = np.linalg.norm(xyz_world[..., None, :, :] - rig.centres_world()[:, None, :], axis=-1)
    w_d = distance_weight(distance, settings)
    w_o = side_view(rig, skeleton, xyz_world)
    placed = (np.where(np.isnan(w_o), w_d, w_o) + w_d) / 2
    return score_weight(score, settings) * np.where(np.isnan(placed), 1.0, placed)


# (G, C, K, 2) depths of keypoints and their standard deviations, m, of the keypoints as ideal points (G, C, K, 2)
DepthOf = Callable[[Array], Array]
_DEFAULTS = FuseSettings()
# coefficients of a lens that bends nothing
_NONE = np.zeros(14)
# nearer to a camera a point is behind it
_LEAST_DEPTH_M = 1e-6


@dataclass(frozen=True, eq=False)
class Triangulated:
    """Points in 3D; unpacks as ``xyz, cov, reproj = triangulate(...)``.

    Attributes:
        xyz: (..., K, 3) world metres; NaN where fewer than two usable views agree, or (``robust``) as many on another point. A
            single view is enough where it has depth and no other view sees the keypoint.
        cov: (..., K, 3, 3) square metres; NaN where missing.
        reproj: (..., K) rms distance in raw px of the used views to the reprojection.
        n_views: (..., K) uint8 views used; 0 where missing.
    """

    xyz: Array
    cov: Array
    reproj: Array
    n_views: Array

    def __iter__(self) -> Iterator[Array]:
        return iter((self.xyz, self.cov, self.reproj))


def triangulate(
    rig: Rig,
    xy_img: Any,
    score: Any = None,
    sigma_px: Any = None,
    weights: Weights | None = None,
    *,
    depth_m: Any = None,
    skeleton: Skeleton | None = None,
    settings: FuseSettings = _DEFAULTS,
) -> Triangulated:
    """Triangulate keypoints; each leading index is one person at one time step.

    Args:
        rig: C cameras.
        xy_img: (..., C, K, 2) raw distorted px; NaN where unseen.
        score: (..., C, K) in [0, 1]; None: 1 wherever xy_img is finite. NaN counts as 0, and 0 as unseen.
        sigma_px: (..., C, K) standard deviation of each image coordinate; where None or NaN it is taken from the extent of the
            K keypoints in that view and the score, see `FuseSettings.sigma_share`.
        weights: ``robust``, ``score``, ``none`` or ``all``, which needs `skeleton`; None: those of `settings`.
        depth_m: (..., C, K, 2) depth of each keypoint along the optical axis and its standard deviation, NaN where unknown; for
            ``robust`` only. A keypoint that a single view sees then has a place. `core.depth.keypoint_depth` makes it from the
            depth of the surface.
        skeleton: names axis K.
        settings: weights (by default ``robust``) and thresholds.

    Returns:
        Triangulated: see there.

    Raises:
        ShapeError: axes that do not fit the rig or each other.
        ConfigError: unknown `weights`, or ``all`` without `skeleton`.

    Examples:
        >>> import numpy as np, posefuse as pf
        >>> rig = pf.read_rig("examples/demo/rig.toml")
        >>> xyz, cov, _ = pf.triangulate(rig, rig.project(np.array([[0.1, -0.2, 1.0]])), sigma_px=np.full((4, 1), 2.0))
        >>> xyz.round(3).tolist(), (1000 * np.sqrt(np.diag(cov[0]))).round(1).tolist()  # m, standard deviations in mm
        ([[0.1, -0.2, 1.0]], [8.7, 8.8, 6.6])
    """
    weights = settings.weights if weights is None else weights
    if weights not in WEIGHTS:
        raise ConfigError(f"triangulate: weights: expected one of {choices(WEIGHTS)}, got {weights!r}")
    xy, score, sigma = _checked(rig, xy_img, score, sigma_px, settings)
    depth = None if depth_m is None else np.asarray(depth_m, np.float64)
    if depth is not None and depth.shape != xy.shape:
        raise ShapeError(f"triangulate: depth_m: expected (..., C, K, 2) = {xy.shape}, got shape {depth.shape}")
    lead = xy.shape[:-3]
    groups = math.prod(lead)
    xy, score, sigma = (part.reshape(groups, *part.shape[len(lead) :]) for part in (xy, score, sigma))
    depth_of = None if depth is None else lambda _: depth.reshape(xy.shape)
    solved = solved_by(weights, rig, xy, score, sigma, settings, depth_of=depth_of, skeleton=skeleton)
    return Triangulated(*(part.reshape(*lead, *part.shape[1:]) for part in vars(solved).values()))


def _checked(rig: Rig, xy_img: Any, score: Any, sigma_px: Any, settings: FuseSettings) -> tuple[Array, Array, Array]:
    """Float64 (..., C, K, 2), and (..., C, K) score and sigma."""
    xy = np.asarray(xy_img, np.float64)
    if xy.ndim < 3 or xy.shape[-1] != 2 or xy.shape[-3] != len(rig):
        raise ShapeError(f"triangulate: xy_img: expected (..., C, K, 2) with C = {len(rig)} cameras, got shape {xy.shape}")
    planes = []
    for name, value in (("score", score), ("sigma_px", sigma_px)):
        plane = np.full(xy.shape[:-1], np.nan) if value is None else np.asarray(value, np.float64)
        if plane.shape != xy.shape[:-1]:
            raise ShapeError(f"triangulate: {name}: expected (..., C, K) = {xy.shape[:-1]}, got shape {plane.shape}")
        planes.append(plane)
    filled = np.isfinite(xy[..., 0]).astype(np.float64) if score is None else planes[0]
    return xy, filled, stated_sigma(xy, filled, planes[1], settings)


def stated_sigma(xy_img: Array, score: Array, sigma_px: Array, settings: FuseSettings) -> Array:
    """sigma_px (..., C, K), and where it is NaN what `FuseSettings.sigma_share` makes of the body's size and the score."""
    unstated = np.isnan(sigma_px)
    if not unstated.any():
        return sigma_px
    full = sigma_of_size(xy_img, settings)
    with np.errstate(divide="ignore"):
        return np.where(unstated, full[..., None] / score, sigma_px)


def sigma_of_size(xy_img: Array, settings: FuseSettings) -> Array:
    """(...) what `FuseSettings.sigma_share` makes of a body with points (..., K, 2) for keypoints of score 1."""
    seen = np.isfinite(xy_img)
    extent = np.where(seen, xy_img, -np.inf).max(axis=-2) - np.where(seen, xy_img, np.inf).min(axis=-2)
    return np.asarray(np.maximum(settings.sigma_share * extent.max(axis=-1), settings.sigma_min_px))


def solved_by(
    weights: Weights,
    rig: Rig,
    xy_img: Array,
    score: Array,
    sigma: Array,
    settings: FuseSettings,
    *,
    depth_of: DepthOf | None = None,
    skeleton: Skeleton | None = None,
    previous_world: Array | None = None,
) -> Triangulated:
    """Groups (G, C, K, ...) to points by any weights; `depth_of` is of ``robust``, skeleton and previous points of ``all``."""
    if weights == "robust":
        return solve_robust(rig, xy_img, score, sigma, settings, depth_of)
    weight = (score > 0).astype(np.float64) if weights == "none" else score_weight(score, settings)
    if weights == "all":
        if skeleton is None:
            raise ConfigError("triangulate: weights 'all' looks at body segments: give skeleton= (one of core.SKELETONS)")
        # distances and segment axes from the previous points, else from a first pass by score
        about = solve_weighted(rig, xy_img, sigma, weight).xyz
        about = about if previous_world is None else np.where(np.isnan(previous_world), about, previous_world)
        weight = full_weight(rig, skeleton, score, about, settings)
    return solve_weighted(rig, xy_img, sigma, weight)


def solve_robust(
    rig: Rig, xy_img: Array, score: Array, sigma: Array, settings: FuseSettings, depth_of: DepthOf | None = None
) -> Triangulated:
    """Robust fusion of groups (G, C, K, ...). Points that have a rival are missing: nothing decides which of the two is right."""
    from .kernels import robust

    ideal, white = whitened(rig, xy_img, _usable_sigma(score, sigma, settings))
    depth = None if depth_of is None else np.array(depth_of(ideal), order="C")
    # what is known of no view costs nothing
    depth = depth if depth is not None and np.isfinite(depth).all(axis=-1).any() else None
    points = (len(ideal), ideal.shape[2], 3)
    xyz, cov, used = np.empty(points), np.empty((*points, 3)), np.empty(sigma.shape, np.bool_)
    robust.solve_robust(packed_rig(rig), ideal, white, xyz, cov, used, depth)
    return _solved(rig, xy_img, xyz, cov, used)


def _usable_sigma(score: Array, sigma: Array, settings: FuseSettings) -> Array:
    """The standard deviations (...) of keypoints that robust fusion and live tracking use; NaN of the others."""
    return np.where((score >= settings.score_min) & (score > 0), sigma, np.nan)


# chosen, not fitted: a stated sigma near 0 would let one view outweigh all others; networks err by 1 px or more
_LEAST_SIGMA_PX = 0.3


def whitened_view(view: Detections2D, rig: Rig, settings: FuseSettings) -> tuple[Array, Array, Array]:
    """For live tracking: `whitened` (P, K, ...) of a view of the only camera of a rig, and sigma (P, K) px of its keypoints."""
    planes = view.xy_img, np.nan_to_num(view.score), np.where(view.sigma_px > 0, view.sigma_px, np.nan)
    xy, score, stated = (plane.astype(np.float64) for plane in planes)
    sigma = np.maximum(_usable_sigma(score, stated_sigma(xy, score, stated, settings), settings), _LEAST_SIGMA_PX)
    ideal, white = whitened(rig, xy[:, None], sigma[:, None])
    return ideal[:, 0], white[:, 0], sigma


def whitened(rig: Rig, xy_img: Array, sigma: Array) -> tuple[Array, Array]:
    """Ideal points (G, C, K, 2), and what turns their errors into standard deviations (G, C, K, 2, 2); NaN where unusable."""
    from .kernels.lens import remove_lenses

    focal, inverse, centre, coefficients, others = _lenses(rig)
    ideal = (np.where(np.isfinite(xy_img), xy_img, np.nan) - centre[:, None]) @ inverse
    px_by_ideal = np.empty((*xy_img.shape, 2))
    remove_lenses(focal, coefficients, ideal, px_by_ideal)
    for c in others:
        camera = rig.cameras[c]
        ideal[:, c] = camera.norm_from_px(xy_img[:, c])
        px_by_ideal[:, c] = focal[c] @ slopes(ideal[:, c], camera.distortion, camera.model)
    return ideal, px_by_ideal / np.where((sigma > 0) & np.isfinite(sigma), sigma, np.nan)[..., None, None]


@lru_cache(maxsize=32)
def _lenses(rig: Rig) -> tuple[Array, Array, Array, Array, list[int]]:
    """Focal part of the intrinsic matrices (C, 2, 2), its inverse transposed (C, 2, 2), principal points (C, 2),
    coefficients (C, 14) of pinhole lenses, and the cameras whose lenses are of another kind: fisheye, or a tilted sensor.
    """
    others = [c for c, camera in enumerate(rig) if camera.model != "pinhole" or len(camera.distortion) == len(_NONE)]
    coefficients = np.stack([_NONE if c in others else padded(camera.distortion) for c, camera in enumerate(rig)])
    K = np.stack([camera.K[:2] for camera in rig])
    inverse = np.swapaxes(np.linalg.inv(K[:, :, :2]), -1, -2)
    return np.ascontiguousarray(K[..., :2]), inverse, np.ascontiguousarray(K[..., 2]), coefficients, others


def _solved(rig: Rig, xy_img: Array, xyz: Array, cov: Array, used: Array) -> Triangulated:
    """Points with the distance in px from the views (G, C, K) that are used."""
    from .kernels import lens

    focal, _, centre, coefficients, others = _lenses(rig)
    px = np.empty(xy_img.shape)
    lens.project(packed_rig(rig), focal, centre, coefficients, xyz, px)
    for c in others:
        px[:, c] = rig.cameras[c].project(xyz)
    off_px = px - xy_img
    n_views = used.sum(axis=1)
    square = np.where(used, (off_px**2).sum(axis=-1), 0.0).sum(axis=1)
    reproj = np.sqrt(square / np.where(n_views > 0, n_views, np.nan))
    return Triangulated(xyz, cov, reproj, n_views.astype(np.uint8))


def solve_weighted(rig: Rig, xy_img: Array, sigma: Array, weight: Array) -> Triangulated:
    """Groups (G, C, K, ...) to points by the paper's weighted least squares with given weights (G, C, K).

    Its rows are (u m3 - m1), (v m3 - m2) in undistorted px. The covariance is propagated from the pixel noise. The sum of
    squared whitened residuals is expected to be 2n - 3 for the best weights, more for others.
    """
    from .kernels.robust import inflate

    ideal, white = whitened(rig, xy_img, sigma)
    used = (weight > 0) & np.isfinite(ideal).all(axis=-1) & np.isfinite(white).all(axis=(-1, -2))
    pose, focal = packed_rig(rig)[:, :12].reshape(-1, 1, 3, 4), _lenses(rig)[0][:, None]
    rows = np.where(used[..., None, None], ideal[..., None] * pose[:, :, 2:] - pose[:, :, :2], 0.0)
    white = np.where(used[..., None, None], white, np.eye(2))
    in_px = focal @ rows
    slope = np.swapaxes(in_px[..., :3], -1, -2)
    system = (np.where(used, weight, 0.0)[..., None, None] * slope @ in_px).sum(axis=1)
    known = (used.sum(axis=1) > 1) & _well_posed(system[..., :3])
    inverse = np.linalg.inv(np.where(known[..., None, None], system[..., :3], np.eye(3)))
    xyz = -(inverse @ system[..., 3:])[..., 0]
    depth = (pose[:, :, 2:, :3] @ xyz[:, None, ..., None])[..., 0, 0] + pose[:, :, 2, 3]
    known &= ((depth > _LEAST_DEPTH_M) | ~used).all(axis=1)
    depth = np.where(used & known[:, None], depth, 1.0)[..., None, None]
    # noise of the two rows: that of the pixels, undistorted, by the depth
    pushed = slope @ (np.where(used, weight, 0.0)[..., None, None] * depth * focal @ np.linalg.inv(white))
    cov = inverse @ (pushed @ np.swapaxes(pushed, -1, -2)).sum(axis=1) @ inverse
    best = white @ rows / depth
    residual = (best[..., :3] @ xyz[:, None, ..., None])[..., 0] + best[..., 3]
    information = (np.swapaxes(best[..., :3], -1, -2) @ best[..., :3]).sum(axis=1)
    freedom = 2.0 * used.sum(axis=1) - 6 + np.trace(information @ cov, axis1=-2, axis2=-1)
    for one, square, free in zip(cov, (residual**2).sum(axis=(1, -1)) * known, freedom * known, strict=True):
        inflate(one, square, free, 1.0)
    missing = ~known[..., None]
    return _solved(rig, xy_img, np.where(missing, np.nan, xyz), np.where(missing[..., None], np.nan, cov), used & known[:, None])


def _well_posed(information: Array) -> Array:
    """(...) whether information (..., 3, 3) defines a point: not where the rays are one ray."""
    from .kernels.point import RANK

    mean = np.trace(information, axis1=-2, axis2=-1) / 3
    return np.asarray(np.linalg.det(information) > RANK * mean**3)


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
    planes = _planes_of(views, rig, settings, _matched(views, previous))
    return Pose3D(t_ns=views.t_ns, skeleton=views.skeleton, person_id=views.person_id, **planes)


def fuse_over_time(views: ViewSequence, rig: Rig, settings: FuseSettings) -> PoseSequence:
    """`fuse` of several time steps together, none of which knows the pose before: several times as fast as one by one."""
    planes = _planes_of(views, rig, settings)
    return PoseSequence(t_ns=views.t_ns, skeleton=views.skeleton, person_id=views.person_id, **planes)


def _planes_of(
    views: Views | ViewSequence, rig: Rig, settings: FuseSettings, previous_world: Array | None = None
) -> dict[str, Array]:
    """The arrays of the poses in views (..., C, K)."""
    if views.camera_names != rig.names:
        raise ShapeError(f"fuse: views come from cameras {choices(views.camera_names)}, the rig has {choices(rig.names)}")
    lead, score = views.score.shape[:-2], np.where(np.isfinite(views.score), views.score, 0.0)
    planes = [views.xy_img, score, stated_sigma(views.xy_img, score, views.sigma_px, settings), views.depth_m]
    xy, score, sigma, *deep = (plane.reshape(-1, *plane.shape[len(lead) :]) for plane in planes if plane is not None)
    solved = solved_by(
        settings.weights, rig, xy, score, sigma, settings,
        depth_of=partial(keypoint_depth, deep[0], skeleton=views.skeleton) if deep else None,
        skeleton=views.skeleton, previous_world=previous_world,
    )  # fmt: skip
    found = {
        "xyz_world": solved.xyz,
        "cov_world": solved.cov,
        "reproj_px": solved.reproj,
        "n_views": solved.n_views,
        "kind": np.where(solved.n_views > 0, np.uint8(Kind.FUSED), np.uint8(Kind.MISSING)),
    }
    return {name: plane.reshape(*lead, *plane.shape[1:]) for name, plane in found.items()}


def _matched(views: Views, previous: Pose3D | None) -> Array | None:
    """(N, K, 3) the previous points of the same people; NaN for newcomers."""
    if previous is None or previous.skeleton != views.skeleton:
        return None
    places = {int(person): i for i, person in enumerate(previous.person_id)}
    missing = np.full((len(views.skeleton), 3), np.nan)
    rows = [previous.xyz_world[places[int(p)]] if int(p) in places else missing for p in views.person_id]
    return np.array(rows).reshape(-1, len(views.skeleton), 3)
