"""Where the cameras are, from one walking person alone: 2D keypoints, intrinsics, and one known length for the scale.

Two cameras first (essential matrix by five points and consensus, Nister 2004), the others by resection, then one robust
bundle adjustment over all cameras and keypoints. The same checks as for a prop stand between this and a rig.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from posefuse.core import SE3, CalibrationError, Camera, Detections2D, Rig, Skeleton
from posefuse.core.arrays import Array, check_axes, frozen

from . import checks
from .extrinsics import world_checks
from .point_solve import PointFreedom, PointSolution, PointState, PointViews, solve_points
from .report import CalibrationReport, Check
from .rotations import Poses, stacked
from .world import FloorFromFeet, triangulate

_LEAST_SCORE = 0.35
_MOST_POINTS = 4000
_EPIPOLAR_PX = 6.0
_RESECTION_PX = 12.0
_LEAST_SHARED = 60
_LEAST_RAYS_RAD = np.deg2rad(8)
_MOST_SIGMA_PX_PER_1000 = 12.0
_LEAST_INLIER_SHARE, _INLIER_SIGMA = 0.5, 4.0
_HALVES_SHARE, _HALVES_RAD = 0.05, np.deg2rad(2.5)
_FEET = ("left_heel", "right_heel", "left_big_toe", "right_big_toe", "left_ankle", "right_ankle")
_HEADS = ("head", "nose", "neck")

# lengths of segments over stature (Drillis and Contini 1966, as tabled by Winter 2009)
STATURE_SHARES = {
    ("left_hip", "left_knee"): 0.245, ("right_hip", "right_knee"): 0.245,
    ("left_knee", "left_ankle"): 0.246, ("right_knee", "right_ankle"): 0.246,
    ("left_shoulder", "left_elbow"): 0.186, ("right_shoulder", "right_elbow"): 0.186,
    ("left_elbow", "left_wrist"): 0.146, ("right_elbow", "right_wrist"): 0.146,
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class PersonViews:
    """One person in all cameras.

    Attributes:
        cameras: names. skeleton: names axis K. t_ns: (T,).
        xy_img: (C, T, K, 2) raw px, NaN where missing. score: (C, T, K).
    """

    cameras: tuple[str, ...]
    skeleton: Skeleton
    t_ns: Array
    xy_img: Array
    score: Array

    def __post_init__(self) -> None:
        for name, dtype in (("t_ns", np.int64), ("xy_img", np.float64), ("score", np.float64)):
            object.__setattr__(self, name, frozen(getattr(self, name), dtype, f"PersonViews.{name}"))
        check_axes("PersonViews", {"xy_img": (self.xy_img, "C T K 2"), "score": (self.score, "C T K"), "t_ns": (self.t_ns, "T")})


def person_views(detections: Mapping[str, Sequence[Detections2D]]) -> PersonViews:
    """The most prominent person of every camera, followed from frame to frame, at the times of the camera with most frames.

    Prominent is who is large and well scored; a bystander is let go because the one followed is the nearest to the last.
    """
    if len(detections) < 2 or not all(detections.values()):
        empty = [name for name, frames in detections.items() if not frames]
        raise CalibrationError(f"person: expected detections of at least 2 cameras, got {len(detections)}; empty: {empty}")
    names = tuple(detections)
    longest = max(names, key=lambda name: len(detections[name]))
    t_ns = np.array([frame.t_ns for frame in detections[longest]], dtype=np.int64)
    skeleton = detections[longest][0].skeleton
    period = int(np.median(np.diff(t_ns))) if len(t_ns) > 1 else 1
    xy = np.full((len(names), len(t_ns), len(skeleton), 2), np.nan)
    score = np.zeros(xy.shape[:3])
    for c, name in enumerate(names):
        frames = sorted(detections[name], key=lambda frame: frame.t_ns)
        if frames[0].skeleton != skeleton:
            raise CalibrationError(f"person: {name} has skeleton {frames[0].skeleton.name}, {longest} has {skeleton.name}")
        stamps = np.array([frame.t_ns for frame in frames])
        followed = _follow(frames)
        for i, t in enumerate(t_ns):
            k = int(np.argmin(np.abs(stamps - t)))
            person = followed[k]
            if person is not None and abs(int(stamps[k]) - int(t)) <= period // 2:
                xy[c, i], score[c, i] = frames[k].xy_img[person], frames[k].score[person]
    return PersonViews(names, skeleton, t_ns, xy, score)


def _follow(frames: Sequence[Detections2D]) -> list[int | None]:
    followed: list[int | None] = []
    last: Array | None = None
    for frame in frames:
        if len(frame) == 0:
            followed.append(None)
            continue
        middle = np.array([np.nanmedian(xy, axis=0) if np.isfinite(xy).any() else (np.nan, np.nan) for xy in frame.xy_img])
        size = np.array([np.linalg.norm(np.nanmax(xy, axis=0) - np.nanmin(xy, axis=0)) if np.isfinite(xy).any() else 0.0
                         for xy in frame.xy_img])  # fmt: skip
        worth = size * frame.score.mean(axis=1)
        if last is not None:
            worth = worth / (1 + np.nan_to_num(np.linalg.norm(middle - last, axis=1), nan=1e9) / np.maximum(size, 1))
        best = int(np.argmax(worth))
        followed.append(best)
        last = middle[best]
    return followed


@dataclass(frozen=True)
class KnownLength:
    """What sets the scale: the person's stature, or the distance of two cameras, in metres; exactly one of them."""

    stature_m: float | None = None
    cameras: tuple[str, str] | None = None
    distance_m: float | None = None

    def __post_init__(self) -> None:
        if (self.stature_m is None) == (self.distance_m is None) or (self.cameras is None) != (self.distance_m is None):
            raise CalibrationError("scale: give either the person's stature, or two cameras and their distance")


@dataclass(frozen=True, eq=False)
class PersonCalibration:
    """A rig from a person, which passed its checks. xyz_world (T, K, 3) m; late_s (C,) clocks as in `Calibration`."""

    rig: Rig
    report: CalibrationReport
    xyz_world: Array
    late_s: Array


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
    done = [_check_seen(views)]
    CalibrationReport("extrinsics from a person", tuple(done)).require()
    solution, rows = _solve(views, cameras)
    rig, xyz = _scaled(views, cameras, solution, rows, length)
    distance_m = float(np.nanmedian(np.linalg.norm(rig.cameras[0].cam_from_world @ xyz.reshape(-1, 3), axis=1)))
    done += _checks(views, cameras, solution, rows, rig, distance_m, length)
    feet, head = _feet_and_head(views.skeleton, xyz)
    rule = FloorFromFeet(feet, head)
    new_from_old = rule.new_from_old(rig)
    residual = solution.residual_px[_inlier(solution)]
    rig = replace(rig.moved(new_from_old), world_set_by=rule.words, residual_px=float(np.sqrt((residual**2).sum(axis=1).mean())))
    done += world_checks(rig, rule.has_floor, upside_down)
    report = CalibrationReport(
        "extrinsics from a person", tuple(done),
        numbers={"sigma_px": solution.sigma_px, "points": float(rows.point_count), "residual_px": rig.residual_px},
    )  # fmt: skip
    report.require()
    return PersonCalibration(rig, report, (new_from_old @ xyz.reshape(-1, 3)).reshape(xyz.shape), solution.state.late_s)


def _usable(views: PersonViews) -> Array:
    return np.isfinite(views.xy_img).all(axis=-1) & (views.score >= _LEAST_SCORE)


def _check_seen(views: PersonViews) -> Check:
    seen = _usable(views).any(axis=2).sum(axis=1)
    blind = [f"{name} ({n} of {len(views.t_ns)} frames)" for name, n in zip(views.cameras, seen, strict=True) if n < 5]
    return Check("person seen", not blind, f"nobody found by {', '.join(blind)}" if blind else "every camera saw the person",
                 "walk where this camera looks, or leave it out")  # fmt: skip


def _solve(views: PersonViews, cameras: tuple[Camera, ...]) -> tuple[PointSolution, PointViews]:
    usable = _usable(views)
    usable &= usable.sum(axis=0) >= 2
    norm = np.stack([camera.norm_from_px(xy) for camera, xy in zip(cameras, views.xy_img, strict=True)])
    usable &= np.isfinite(norm).all(axis=-1)
    poses, start_pair = _first_poses(views.cameras, norm, usable, cameras)
    point_of = np.flatnonzero(usable.sum(axis=0).ravel() >= 2)
    thin = max(1, len(point_of) // _MOST_POINTS)
    point_of = point_of[::thin]
    rows = _rows(views, usable, point_of)
    rig = Rig(tuple(replace(c, cam_from_world=poses[i].se3()) for i, c in enumerate(cameras)))
    xy = np.where(usable[..., None], views.xy_img, np.nan).reshape(len(cameras), -1, 2)[:, point_of]
    xyz = triangulate(rig, xy)
    in_front = np.stack([(camera.cam_from_world @ xyz)[:, 2] > 0.05 for camera in rig])
    seen = np.isfinite(xy).all(axis=-1)
    good = np.isfinite(xyz).all(axis=1) & (in_front | ~seen).all(axis=0)
    rows = _rows(views, usable, point_of[good])
    held = int(np.argmax(np.abs(poses.t[start_pair[1]] - poses.t[start_pair[0]])))
    start = PointState(poses, xyz[good], np.zeros(len(cameras)))
    return solve_points(rows, cameras, start, PointFreedom(start_pair[0], (start_pair[1], held))), rows


def _rows(views: PersonViews, usable: Array, point_of: Array) -> PointViews:
    """Rows of the chosen points; `point_of` counts in the flattened (T, K)."""
    flat = usable.reshape(len(usable), -1)[:, point_of]
    camera, point = np.nonzero(flat)
    t_s = (views.t_ns - views.t_ns[0]) / 1e9
    velocity = np.gradient(views.xy_img, t_s, axis=1) if len(t_s) > 1 else np.zeros_like(views.xy_img)
    per_point = np.nan_to_num(velocity.reshape(len(usable), -1, 2)[:, point_of])
    xy = views.xy_img.reshape(len(usable), -1, 2)[:, point_of]
    score = views.score.reshape(len(usable), -1)[:, point_of]
    return PointViews(
        camera, point, xy[camera, point], per_point[camera, point], t_s[point_of[point] // views.xy_img.shape[2]],
        len(point_of), 1 / np.clip(score[camera, point], _LEAST_SCORE, 1.0),
    )  # fmt: skip


def _first_poses(
    names: tuple[str, ...], norm: Array, usable: Array, cameras: tuple[Camera, ...]
) -> tuple[Poses, tuple[int, int]]:
    """cam_from_world of all cameras: the pair that agrees best, then one camera after the other."""
    count = len(names)
    flat, seen = norm.reshape(count, -1, 2), usable.reshape(count, -1)
    focal = np.array([camera.K[0, 0] for camera in cameras])
    pairs = [_pair(flat, seen, focal, a, b) for a in range(count) for b in range(a + 1, count)]
    pairs = [pair for pair in pairs if pair is not None]
    if not pairs:
        raise CalibrationError("person: no two cameras see enough of the person at the same time, from different sides")
    _, a, b, b_from_a = max(pairs, key=lambda pair: (pair[0], -pair[1], -pair[2]))
    placed = {a: Poses(np.eye(3), np.zeros(3)), b: b_from_a}
    while len(placed) < count:
        step = _next_camera(flat, seen, focal, placed)
        if step is None:
            lost = [names[i] for i in range(count) if i not in placed]
            raise CalibrationError(
                f"person: {', '.join(lost)} cannot be linked to {', '.join(names[i] for i in sorted(placed))};"
                " walk where they see the person together"
            )
        placed[step[0]] = step[1]
    return stacked([placed[i] for i in range(count)]), (a, b)


def _pair(flat: Array, seen: Array, focal: Array, a: int, b: int) -> tuple[float, int, int, Poses] | None:
    both = np.flatnonzero(seen[a] & seen[b])
    if len(both) < _LEAST_SHARED:
        return None
    both = both[:: max(1, len(both) // _MOST_POINTS)]
    p, q = flat[a, both], flat[b, both]
    cv2.setRNGSeed(7)
    essential, inlier = cv2.findEssentialMat(p, q, np.eye(3), cv2.RANSAC, 0.9999, _EPIPOLAR_PX / float(focal[[a, b]].mean()))
    if essential is None or essential.shape != (3, 3):
        return None
    front, rotation, shift, mask = cv2.recoverPose(essential, p, q, np.eye(3), mask=inlier)
    good = mask.ravel() > 0
    if front < _LEAST_SHARED // 2:
        return None
    rays_p = np.column_stack([p[good], np.ones(good.sum())])
    rays_q = np.column_stack([q[good], np.ones(good.sum())]) @ rotation
    cosine = (rays_p * rays_q).sum(axis=1) / (np.linalg.norm(rays_p, axis=1) * np.linalg.norm(rays_q, axis=1))
    # rays that meet at a right angle fix a point best
    sine = float(np.median(np.sqrt(np.clip(1 - cosine**2, 0, 1))))
    if sine < np.sin(_LEAST_RAYS_RAD):
        return None
    return front * front / len(both) * sine, a, b, Poses(rotation, shift.ravel())


def _next_camera(flat: Array, seen: Array, focal: Array, placed: dict[int, Poses]) -> tuple[int, Poses] | None:
    """The camera that sees most of the points the placed ones have fixed, and its pose."""
    known = sorted(placed)
    bare = [Camera(f"c{i}", (2, 2), np.eye(3), placed[i].se3()) for i in known]
    xy = np.where(seen[known][..., None], flat[known], np.nan)
    xyz = triangulate(Rig(tuple(bare)), xy)
    with np.errstate(invalid="ignore"):
        off = np.stack([np.linalg.norm(camera.project(xyz) - xy[i], axis=1) * focal[known[i]] for i, camera in enumerate(bare)])
        fixed = np.isfinite(xyz).all(axis=1) & (np.nanmax(np.where(np.isnan(off), -1, off), axis=0) < _RESECTION_PX)
    best: tuple[int, int, Poses] | None = None
    for c in range(len(flat)):
        rows = np.flatnonzero(fixed & seen[c]) if c not in placed else np.zeros(0, np.int64)
        if len(rows) < _LEAST_SHARED // 2:
            continue
        cv2.setRNGSeed(7)
        found, turn, shift, inlier = cv2.solvePnPRansac(
            xyz[rows], flat[c, rows], np.eye(3), None, iterationsCount=2000, reprojectionError=_RESECTION_PX / float(focal[c]),
            flags=cv2.SOLVEPNP_EPNP,
        )  # fmt: skip
        agreeing = 0 if inlier is None else len(inlier)
        if found and agreeing >= _LEAST_SHARED // 2 and (best is None or agreeing > best[0]):
            best = (agreeing, c, Poses(cv2.Rodrigues(turn)[0], shift.ravel()))
    return None if best is None else (best[1], best[2])


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


def _inlier(solution: PointSolution) -> Array:
    size = np.abs(solution.residual_px).max(axis=1)
    return np.asarray(size <= _INLIER_SIGMA * solution.sigma_px)


def _checks(
    views: PersonViews, cameras: tuple[Camera, ...], solution: PointSolution, rows: PointViews, rig: Rig, distance_m: float,
    length: KnownLength,
) -> list[Check]:  # fmt: skip
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
        _check_halves(views, cameras, rig, distance_m, length),
        checks.check_apart(cameras, Poses.from_se3(SE3(np.stack([c.cam_from_world.wxyz for c in rig]),
                                                       np.stack([c.cam_from_world.xyz for c in rig])))),
    ]  # fmt: skip


def _check_halves(views: PersonViews, cameras: tuple[Camera, ...], rig: Rig, distance_m: float, length: KnownLength) -> Check:
    """Solve from even and odd stretches of a tenth of the recording."""
    stretch = np.arange(len(views.t_ns)) * 10 // len(views.t_ns) % 2
    found = []
    for half in (0, 1):
        part = replace(views, t_ns=views.t_ns[stretch == half], xy_img=views.xy_img[:, stretch == half],
                       score=views.score[:, stretch == half])  # fmt: skip
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
