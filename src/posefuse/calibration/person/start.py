"""A first, rough answer for cameras that watch one person: two cameras by their essential matrix, the others by resection.

Essential matrix by five points and consensus (Nister 2004); poses from points by EPnP (Lepetit et al. 2009) and consensus.
"""

from __future__ import annotations

import cv2
import numpy as np

from posefuse.calibration.extrinsics.world import triangulate_linear
from posefuse.calibration.solving.rotations import Poses, stacked
from posefuse.core import CalibrationError, Camera, Rig
from posefuse.core.arrays import Array

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
