"""The bundle adjustment of a walking person's keypoints: its start, its rows, and what can be let free."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from posefuse.calibration.extrinsics.prop_solve import KEYPOINTS, POINT, Freedom, PropState, SolvedRig, focal_sigma, solve_prop
from posefuse.calibration.extrinsics.snapshots import Snapshots
from posefuse.calibration.extrinsics.world import triangulate_linear
from posefuse.calibration.geometry import Poses, stacked
from posefuse.core import CalibrationError, Camera, Rig
from posefuse.core.arrays import Array

from .views import PersonViews

_MOST_PAIRED = 4000
_EPIPOLAR_PX = 6.0
_RESECTION_PX = 12.0
_LEAST_SHARED = 60
_LEAST_RAYS_RAD = np.deg2rad(8)


def first_poses(names: tuple[str, ...], norm: Array, usable: Array, cameras: tuple[Camera, ...]) -> tuple[Poses, tuple[int, int]]:
    """cam_from_world of all cameras: the pair that agrees best, then one camera after the other."""
    count = len(names)
    flat, seen = norm.reshape(count, -1, 2), usable.reshape(count, -1)
    focal = np.array([camera.K[0, 0] for camera in cameras])
    tried = [_pair(flat, seen, focal, a, b) for a in range(count) for b in range(a + 1, count)]
    pairs = [pair for pair in tried if pair is not None]
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
    both = both[:: max(1, len(both) // _MOST_PAIRED)]
    p, q = flat[a, both], flat[b, both]
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
    bare = [Camera(name=f"c{i}", size_wh=(2, 2), K=np.eye(3), cam_from_world=placed[i].se3()) for i in known]
    xy = np.where(seen[known][..., None], flat[known], np.nan)
    xyz = triangulate_linear(Rig(tuple(bare)), xy)
    with np.errstate(invalid="ignore"):
        off = np.stack([np.linalg.norm(camera.project(xyz) - xy[i], axis=1) * focal[known[i]] for i, camera in enumerate(bare)])
        fixed = np.isfinite(xyz).all(axis=1) & (np.nanmax(np.where(np.isnan(off), -1, off), axis=0) < _RESECTION_PX)
    best: tuple[int, int, Poses] | None = None
    for c in range(len(flat)):
        rows = np.flatnonzero(fixed & seen[c]) if c not in placed else np.zeros(0, np.int64)
        found = _resected(xyz[rows], flat[c, rows], float(focal[c]))
        if found is not None and (best is None or found[0] > best[0]):
            best = (found[0], c, found[1])
    return None if best is None else (best[1], best[2])


def _resected(xyz: Array, norm: Array, focal_px: float) -> tuple[int, Poses] | None:
    """Pose of a camera from points (n, 3) seen at (n, 2) on its ideal image plane, and how many of them agree."""
    if len(xyz) < _LEAST_SHARED // 2:
        return None
    found, turn, shift, inlier = cv2.solvePnPRansac(
        xyz, norm, np.eye(3), None, iterationsCount=2000, reprojectionError=_RESECTION_PX / focal_px, flags=cv2.SOLVEPNP_EPNP
    )
    agreeing = 0 if inlier is None else len(inlier)
    return (agreeing, Poses(cv2.Rodrigues(turn)[0], shift.ravel())) if found and agreeing >= _LEAST_SHARED // 2 else None


MOST_POINTS = 4000
# what is known of focal lengths before they are let free, as a share
_FREE_FOCAL = 0.5
# speeds are read over so long before and after
_SPEED_S = 0.1


def let_free(solved: SolvedRig, *, focal: bool = False, drift: bool = False) -> SolvedRig:
    """Solved once more from here, with every camera's clock free, and on request its focal length and its clock's rate."""
    lens_sigma = focal_sigma(solved.cameras, _FREE_FOCAL) if focal else None
    return solved.again(offset=True, drift=drift, lens_sigma=lens_sigma)


def solve_person_bundle(
    views: PersonViews, cameras: tuple[Camera, ...], most_points: int = MOST_POINTS, near: SolvedRig | None = None
) -> SolvedRig:
    """Poses of the cameras and places of the keypoints, from nothing or from a solution that is `near`."""
    usable = views.usable
    usable &= usable.sum(axis=0) >= 2
    norm = np.stack([camera.norm_from_px(xy) for camera, xy in zip(cameras, views.xy_img, strict=True)])
    usable &= np.isfinite(norm).all(axis=-1)
    if near is None:
        poses, (a, b) = first_poses(views.cameras, norm, usable, cameras)
        scale = b, int(np.argmax(np.abs(poses.t[b] - poses.t[a])))
        freedom = Freedom(reference=a, held_patches=None, scale=scale)
    else:
        poses, freedom = near.solution.state.cam_from_world, near.freedom
    point_of = np.flatnonzero(usable.any(axis=0).ravel())
    if len(point_of) > most_points:
        # by chance, since every n-th would be the same few keypoints again and again
        point_of = np.sort(np.random.default_rng(0).choice(point_of, most_points, replace=False))
    good, xyz = _start_points(views, cameras, usable, poses, point_of)
    point_of = point_of[good]
    rows, start = _rows(views, usable, point_of), PropState.of_points(poses, xyz)
    solution = solve_prop(rows, POINT, cameras, start, freedom, KEYPOINTS)
    return SolvedRig(cameras=cameras, seen=rows, corners=POINT, solution=solution, freedom=freedom, loss=KEYPOINTS)


def _start_points(
    views: PersonViews, cameras: tuple[Camera, ...], usable: Array, poses: Poses, point_of: Array
) -> tuple[Array, Array]:
    """Which of the points (P,) the first poses place in front of all that see them, and where (n, 3)."""
    rig = Rig(tuple(replace(c, cam_from_world=poses[i].se3()) for i, c in enumerate(cameras)))
    xy = np.where(usable[..., None], views.xy_img, np.nan).reshape(len(cameras), -1, 2)[:, point_of]
    xyz = triangulate_linear(rig, xy)
    in_front = np.stack([(camera.cam_from_world @ xyz)[:, 2] > 0.05 for camera in rig])
    good = np.asarray(np.isfinite(xyz).all(axis=1) & (in_front | ~np.isfinite(xy).all(axis=-1)).all(axis=0))
    return good, xyz[good]


def _rows(views: PersonViews, usable: Array, point_of: Array) -> Snapshots:
    """Rows of the chosen points; `point_of` counts in the flattened (T, K)."""
    camera, point = np.nonzero(usable.reshape(len(usable), -1)[:, point_of])
    xy = views.xy_img.reshape(len(usable), -1, 2)[:, point_of][camera, point]
    sigma = views.sigma_px.reshape(len(usable), -1)[:, point_of][camera, point]
    velocity = _velocity_px_s(views).reshape(len(usable), -1, 2)[:, point_of][camera, point]
    step = point_of // views.xy_img.shape[2]
    since_s = (views.t_ns - views.t_ns[[0, -1]].mean()) / 1e9
    return Snapshots.of_points(
        since_s[step],
        camera=camera,
        time_step=point,
        xy_img=xy,
        velocity_px_s=velocity,
        noise=sigma / np.median(sigma),
    )


def _velocity_px_s(views: PersonViews) -> Array:
    """(C, T, K, 2) of each keypoint in its images, by frames before and after; 0 where one of them lacks it."""
    out, steps = np.zeros(views.xy_img.shape), len(views.t_ns)
    lag = max(1, round(_SPEED_S * 1e9 / float(np.median(np.diff(views.t_ns))))) if steps > 1 else 1
    if steps > 2 * lag:
        apart_s = (views.t_ns[2 * lag :] - views.t_ns[: -2 * lag]) / 1e9
        out[:, lag:-lag] = (views.xy_img[:, 2 * lag :] - views.xy_img[:, : -2 * lag]) / apart_s[:, None, None]
    return np.nan_to_num(out)
