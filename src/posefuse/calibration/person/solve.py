"""Where the cameras are, from one walking person alone: 2D keypoints, intrinsics, and one known length for the scale.

A rough answer first (`person_start`), then one robust bundle adjustment over all cameras and keypoints. The same checks as
for a prop stand between this and a rig.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from posefuse.calibration.extrinsics import self_checks as checks
from posefuse.calibration.extrinsics.target import world_checks
from posefuse.calibration.extrinsics.world import FloorFromFeet, FloorUnderBody, triangulate
from posefuse.calibration.report import CalibrationReport, Check
from posefuse.calibration.solving.point_solve import PointFreedom, PointSolution, PointState, PointViews, solve_points
from posefuse.calibration.solving.rotations import Poses
from posefuse.core import SE3, CalibrationError, Camera, Rig, Skeleton
from posefuse.core.arrays import Array

from .start import first_poses, turned_inside_out
from .views import PersonViews

_SUBJECT = "extrinsics from a person"
_LEAST_SCORE = 0.35
_MOST_POINTS = 4000
_MOST_SIGMA_PX_PER_1000 = 12.0
_LEAST_INLIER_SHARE, _INLIER_SIGMA = 0.7, 4.0
# feet that spread less across their path than this do not tell where up is
_PLANE_M, _LEAST_WALK_SHARE = 0.15, 0.04
_HALVES_SHARE, _HALVES_RAD = 0.03, np.deg2rad(1.5)
# of people who can be asked to walk through a room
_STATURES_M = (0.8, 2.4)
_SAME_VIDEO_PX = 2.0
_FEET = ("left_heel", "right_heel", "left_big_toe", "right_big_toe", "left_ankle", "right_ankle")
_HEADS = ("head", "nose", "neck")
_HIPS = ("left_hip", "right_hip")

_LEAST_TRUE_SIDED, _NEARLY_AS_WELL = 0.5, 1.5
_LEFTWARDS = (("right_shoulder", "right_hip"), ("left_shoulder", "left_hip"))
_UPWARDS = (("left_hip", "right_hip"), ("left_shoulder", "right_shoulder"))
_FORWARDS = (
    (("left_ear", "right_ear"), ("nose",)),
    (("left_heel",), ("left_foot_index",)), (("right_heel",), ("right_foot_index",)),
    (("left_heel",), ("left_big_toe",)), (("right_heel",), ("right_big_toe",)),
)  # fmt: skip

# lengths of segments over stature (Drillis and Contini 1966, as tabled by Winter 2009)
STATURE_SHARES = {
    ("left_hip", "left_knee"): 0.245, ("right_hip", "right_knee"): 0.245,
    ("left_knee", "left_ankle"): 0.246, ("right_knee", "right_ankle"): 0.246,
    ("left_shoulder", "left_elbow"): 0.186, ("right_shoulder", "right_elbow"): 0.186,
    ("left_elbow", "left_wrist"): 0.146, ("right_elbow", "right_wrist"): 0.146,
}  # fmt: skip


@dataclass(frozen=True)
class KnownLength:
    """What sets the scale: the person's stature, or the distance of two cameras, in metres; exactly one of them."""

    stature_m: float | None = None
    cameras: tuple[str, str] | None = None
    distance_m: float | None = None

    def __post_init__(self) -> None:
        if (self.stature_m is None) == (self.distance_m is None) or (self.cameras is None) != (self.distance_m is None):
            raise CalibrationError("scale: give either the person's stature, or two cameras and their distance")
        metres = self.distance_m if self.stature_m is None else self.stature_m
        if not (metres is not None and np.isfinite(metres) and metres > 0):
            raise CalibrationError(f"scale: expected a length > 0 m, got {metres}")
        least_m, most_m = _STATURES_M
        if self.stature_m is not None and not least_m <= self.stature_m <= most_m:
            centimetres = f"; did you mean {metres / 100:g} m?" if least_m <= metres / 100 <= most_m else ""
            raise CalibrationError(f"height of the person: expected {least_m:g} to {most_m:g} m, got {metres:g}{centimetres}")


@dataclass(frozen=True, eq=False)
class PersonCalibration:
    """A rig from a person, which passed its checks. xyz_world: (T, K, 3) m."""

    rig: Rig
    report: CalibrationReport
    xyz_world: Array


def rough_rig(views: PersonViews, cameras: tuple[Camera, ...], length: KnownLength) -> Rig:
    """The rig in metres without a check and with the first camera as the world: to look again, not to be kept."""
    solution, rows = _solve(views, cameras)
    return _scaled(views, cameras, solution, rows, length)[0]


def calibrate_from_person(
    views: PersonViews, cameras: tuple[Camera, ...], length: KnownLength, upside_down: tuple[str, ...] = ()
) -> PersonCalibration:
    """Camera poses from a walking person; the floor is what the feet stand on.

    Raises:
        CalibrationError: input that cannot be used. RefusedCalibration (one of them, with the report): a check fails.
    """
    by_name = {camera.name: camera for camera in cameras}
    missing = [name for name in views.cameras if name not in by_name]
    if missing:
        raise CalibrationError(f"person: no intrinsics of {', '.join(missing)}; there are: {', '.join(by_name)}")
    cameras = tuple(by_name[name] for name in views.cameras)
    done = [_check_seen(views), _check_same_video(views)]
    CalibrationReport(_SUBJECT, tuple(done)).require()
    solution, rows = _solve(views, cameras)
    rig, xyz = _scaled(views, cameras, solution, rows, length)
    distance_m = float(np.nanmedian(np.linalg.norm(rig.cameras[0].cam_from_world @ xyz.reshape(-1, 3), axis=1)))
    feet, head = _feet_and_head(views.skeleton, xyz)
    hips = xyz[:, views.skeleton.indices(_HIPS)].mean(axis=1)
    done += [*_checks(views.skeleton, cameras, solution, rows, rig, xyz), _check_walk(hips, distance_m)]
    # halves take two more solves, which say nothing about a rig that already fails
    CalibrationReport(_SUBJECT, tuple(done)).require()
    done.append(_check_halves(views, cameras, distance_m, length))
    rule = FloorFromFeet(feet, head) if _spread_m(feet)[1] > _PLANE_M else FloorUnderBody(feet, head)
    new_from_old = rule.new_from_old(rig)
    residual = solution.residual_px[_inlier(solution)]
    rig = replace(rig.moved(new_from_old), world_set_by=rule.words, residual_px=float(np.sqrt((residual**2).sum(axis=1).mean())))
    done += world_checks(rig, rule.has_floor, upside_down)
    report = CalibrationReport(
        _SUBJECT, tuple(done),
        numbers={"sigma_px": solution.sigma_px, "points": float(rows.point_count), "residual_px": rig.residual_px},
    )  # fmt: skip
    report.require()
    return PersonCalibration(rig, report, (new_from_old @ xyz.reshape(-1, 3)).reshape(xyz.shape))


def _usable(views: PersonViews) -> Array:
    return np.isfinite(views.xy_img).all(axis=-1) & (views.score >= _LEAST_SCORE) & (views.sigma_px > 0)


def _check_seen(views: PersonViews) -> Check:
    seen = _usable(views).any(axis=2).sum(axis=1)
    blind = [f"{name} ({n} of {len(views.t_ns)} frames)" for name, n in zip(views.cameras, seen, strict=True) if n < 5]
    return Check("person seen", not blind, f"nobody found by {', '.join(blind)}" if blind else "every camera saw the person",
                 "walk where this camera looks, or leave it out")  # fmt: skip


def _check_same_video(views: PersonViews) -> Check:
    """No two cameras have the person at the same pixels all the time."""
    alike = []
    for a, b in combinations(range(len(views.cameras)), 2):
        off = np.linalg.norm(views.xy_img[a] - views.xy_img[b], axis=-1)
        if np.isfinite(off).any() and float(np.nanmedian(off)) < _SAME_VIDEO_PX:
            alike.append(f"{views.cameras[a]} and {views.cameras[b]}")
    detail = f"{', '.join(alike)} show the same video" if alike else "no two cameras show the same"
    return Check("videos differ", not alike, detail, "give each camera its own video")


def _solve(views: PersonViews, cameras: tuple[Camera, ...]) -> tuple[PointSolution, PointViews]:
    """The solve; of the two ways to read a body seen from afar, the one in which it is no mirror image."""
    usable = _usable(views)
    usable &= usable.sum(axis=0) >= 2
    norm = np.stack([camera.norm_from_px(xy) for camera, xy in zip(cameras, views.xy_img, strict=True)])
    usable &= np.isfinite(norm).all(axis=-1)
    poses, (a, b) = first_poses(views.cameras, norm, usable, cameras)
    point_of = np.flatnonzero(usable.any(axis=0).ravel())
    if len(point_of) > _MOST_POINTS:
        # by chance, since every so manieth would be the same few keypoints again and again
        point_of = np.sort(np.random.default_rng(0).choice(point_of, _MOST_POINTS, replace=False))
    good, xyz = _start_points(views, cameras, usable, poses, point_of)
    point_of = point_of[good]
    rows = _rows(views, usable, point_of)
    freedom = PointFreedom(a, (b, int(np.argmax(np.abs(poses.t[b] - poses.t[a])))))
    solution = solve_points(rows, cameras, PointState(poses, xyz), freedom)
    if _true_sided(views.skeleton, _scattered(views, point_of, solution.state.xyz)) >= _LEAST_TRUE_SIDED:
        return solution, rows
    seen = np.where(usable[..., None], norm, np.nan).reshape(len(cameras), -1, 2)[:, point_of]
    focal = np.array([camera.K[0, 0] for camera in cameras])
    other = turned_inside_out(solution.state.cam_from_world, solution.state.xyz, seen, focal, a)
    if other is None:
        return solution, rows
    again = solve_points(rows, cameras, PointState(*other), freedom)
    share = _true_sided(views.skeleton, _scattered(views, point_of, again.state.xyz))
    better = share >= _LEAST_TRUE_SIDED and again.sigma_px < _NEARLY_AS_WELL * solution.sigma_px
    return (again if better else solution), rows


def _start_points(
    views: PersonViews, cameras: tuple[Camera, ...], usable: Array, poses: Poses, point_of: Array
) -> tuple[Array, Array]:
    """Which of the points (P,) the first poses place in front of all that see them, and where (n, 3)."""
    rig = Rig(tuple(replace(c, cam_from_world=poses[i].se3()) for i, c in enumerate(cameras)))
    xy = np.where(usable[..., None], views.xy_img, np.nan).reshape(len(cameras), -1, 2)[:, point_of]
    xyz = triangulate(rig, xy)
    in_front = np.stack([(camera.cam_from_world @ xyz)[:, 2] > 0.05 for camera in rig])
    good = np.asarray(np.isfinite(xyz).all(axis=1) & (in_front | ~np.isfinite(xy).all(axis=-1)).all(axis=0))
    return good, xyz[good]


def _scattered(views: PersonViews, point_of: Array, xyz: Array) -> Array:
    """(T, K, 3) of solved points; NaN elsewhere."""
    whole = np.full((*views.xy_img.shape[1:3], 3), np.nan)
    whole.reshape(-1, 3)[point_of] = xyz
    return whole


def _true_sided(skeleton: Skeleton, xyz: Array) -> float:
    """Share of a body's keypoints (T, K, 3) over time in which left, front and up lie as they do in a body; NaN unknown.

    A body and a rig seen from afar fit the images nearly as well as their mirror images, whose left and right are exchanged.
    """

    def between(ends: tuple[tuple[str, ...], tuple[str, ...]]) -> Array:
        first, second = (xyz[:, skeleton.indices(names)].mean(axis=1) for names in ends)
        return np.asarray(second - first)

    left, up = between(_LEFTWARDS), between(_UPWARDS)
    ways = [between(ends) for ends in _FORWARDS if all(name in skeleton.keypoints for names in ends for name in names)]
    volume = np.array([np.einsum("ti,ti->t", way, np.cross(left, up)) for way in ways])
    known = np.isfinite(volume)
    return float((volume[known] > 0).mean()) if known.any() else float("nan")


def _rows(views: PersonViews, usable: Array, point_of: Array) -> PointViews:
    """Rows of the chosen points; `point_of` counts in the flattened (T, K)."""
    camera, point = np.nonzero(usable.reshape(len(usable), -1)[:, point_of])
    xy = views.xy_img.reshape(len(usable), -1, 2)[:, point_of][camera, point]
    sigma = views.sigma_px.reshape(len(usable), -1)[:, point_of][camera, point]
    return PointViews(camera, point, xy, len(point_of), sigma / np.median(sigma))


def _scaled(
    views: PersonViews, cameras: tuple[Camera, ...], solution: PointSolution, rows: PointViews, length: KnownLength
) -> tuple[Rig, Array]:
    """The rig in metres and the person's keypoints (T, K, 3) in it."""
    pose = solution.state.cam_from_world.se3()
    rig = Rig(tuple(replace(camera, cam_from_world=pose[i]) for i, camera in enumerate(cameras)))
    shape = views.xy_img.shape[1:3]
    xy = np.full(views.xy_img.shape, np.nan)
    good = _usable(views)
    xy[good] = views.xy_img[good]
    xyz = triangulate(rig, xy.reshape(len(cameras), -1, 2)).reshape(*shape, 3)
    if length.stature_m is not None:
        factor = length.stature_m / stature_m(views.skeleton, xyz)
    else:
        assert length.cameras is not None and length.distance_m is not None
        ends = [rig[name].centre_world for name in length.cameras]
        factor = length.distance_m / float(np.linalg.norm(ends[1] - ends[0]))
    scaled = tuple(
        replace(camera, cam_from_world=SE3(camera.cam_from_world.wxyz, camera.cam_from_world.xyz * factor)) for camera in rig
    )
    return Rig(scaled), xyz * factor


def stature_m(skeleton: Skeleton, xyz: Array) -> float:
    """A person's height from limb lengths (T, K, 3), to a few per cent; NaN when no limb is there."""
    parts = [
        (np.nanmedian(np.linalg.norm(xyz[:, skeleton.index(a)] - xyz[:, skeleton.index(b)], axis=1)), share)
        for (a, b), share in STATURE_SHARES.items()
        if a in skeleton.keypoints and b in skeleton.keypoints and np.isfinite(
            xyz[:, [skeleton.index(a), skeleton.index(b)]]).all(axis=(1, 2)).any()
    ]  # fmt: skip
    return float(sum(m for m, _ in parts) / sum(s for _, s in parts)) if parts else float("nan")


def _feet_and_head(skeleton: Skeleton, xyz: Array) -> tuple[Array, Array]:
    def of(names: Sequence[str]) -> Array:
        there = [skeleton.index(name) for name in names if name in skeleton.keypoints]
        return xyz[:, there].reshape(-1, 3)

    return of(_FEET), of(_HEADS)


def _spread_m(points: Array) -> Array:
    """(3,) standard deviations of points (N, 3) along their main directions, the widest first; strays left out."""
    known = points[np.isfinite(points).all(axis=1)]
    if len(known) == 0:
        return np.zeros(3)
    away = np.linalg.norm(known - np.median(known, axis=0), axis=1)
    near = known[away <= 3 * np.median(away)]
    return np.asarray(np.linalg.svd(near - near.mean(axis=0), compute_uv=False) / np.sqrt(len(near)))


def _inlier(solution: PointSolution) -> Array:
    size = np.abs(solution.residual_px).max(axis=1)
    return np.asarray(size <= _INLIER_SIGMA * solution.sigma_px)


def _checks(
    skeleton: Skeleton, cameras: tuple[Camera, ...], solution: PointSolution, rows: PointViews, rig: Rig, xyz: Array
) -> list[Check]:
    limit = _MOST_SIGMA_PX_PER_1000 * max(max(camera.size_wh) for camera in cameras) / 1000
    inlier = _inlier(solution)
    share = np.array([inlier[rows.camera == c].mean() for c in range(len(cameras))])
    worst = int(np.argmin(share))
    return [
        Check("keypoints fit", solution.sigma_px <= limit, f"spread {solution.sigma_px:.1f} px (limit {limit:.1f})",
              "wrong intrinsics, cameras out of step, or different people in different cameras"),
        Check("cameras agree", bool(share[worst] >= _LEAST_INLIER_SHARE),
              f"{cameras[worst].name} agrees worst: {share[worst]:.0%} of its keypoints (needed {_LEAST_INLIER_SHARE:.0%})",
              "it follows another person, moved, or is out of step"),
        _check_mirror(skeleton, xyz),
        checks.check_apart(cameras, Poses.from_se3(SE3(np.stack([c.cam_from_world.wxyz for c in rig]),
                                                       np.stack([c.cam_from_world.xyz for c in rig])))),
    ]  # fmt: skip


def _check_walk(hips: Array, distance_m: float) -> Check:
    spread_m, least_m = float(_spread_m(hips)[0]), _LEAST_WALK_SHARE * distance_m
    return Check(
        "the person walks about", spread_m >= least_m,
        f"the hips spread over {spread_m:.2f} m about their middle (needed {least_m:.2f})",
        "walk over the whole floor: somebody who stays in one place does not tell where the cameras are",
    )  # fmt: skip


def _check_mirror(skeleton: Skeleton, xyz: Array) -> Check:
    share = _true_sided(skeleton, xyz)
    return Check(
        "nothing is mirrored", share >= _LEAST_TRUE_SIDED,
        f"the person has left, front and up where they belong {share:.0%} of the time (needed {_LEAST_TRUE_SIDED:.0%})",
        "mirrored videos; or somebody who stays in one place far away, which fits a mirrored room as well: walk about, come near",
    )  # fmt: skip


def _check_halves(views: PersonViews, cameras: tuple[Camera, ...], distance_m: float, length: KnownLength) -> Check:
    """Solve from even and odd stretches of a tenth of the recording."""
    stretch = np.arange(len(views.t_ns)) * 10 // len(views.t_ns) % 2
    found = []
    for half in (0, 1):
        part = views.at(stretch == half)
        solution, rows = _solve(part, cameras)
        one, _ = _scaled(part, cameras, solution, rows, length)
        found.append(Poses(np.stack([c.cam_from_world.matrix() for c in one]), np.stack([c.cam_from_world.xyz for c in one])))
    apart_m, turned = checks.camera_differences(found[0], found[1])
    limit = _HALVES_SHARE * distance_m
    worst = int(np.argmax(np.maximum(apart_m / limit, turned / _HALVES_RAD)))
    return Check(
        "halves agree", bool((apart_m <= limit).all() and (turned <= _HALVES_RAD).all()),
        f"from separate data {cameras[worst].name} comes out {apart_m[worst] * 1e3:.0f} mm and"
        f" {np.rad2deg(turned[worst]):.2f} deg"
        f" apart (limits {limit * 1e3:.0f} mm, {np.rad2deg(_HALVES_RAD):.1f} deg)",
        "walk longer and over the whole floor, arms and legs moving",
    )  # fmt: skip
