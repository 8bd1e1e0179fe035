"""Every person every camera saw, as rays in the world, and how well a 3D pose explains each of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from posefuse.core import Detections2D, Rig
from posefuse.core.arrays import Array


@dataclass(frozen=True, eq=False, kw_only=True)
class Candidates:
    """D detections of all cameras in one list.

    Attributes:
        camera: (D,) place of its camera in the rig. place: (D,) place within that camera's detections.
        xy_norm: (D, K, 2) ideal image-plane points. score: (D, K), 0 where unusable.
        direction: (D, K, 3) unit rays in world axes. centre: (D, 3) where they start.
        rotation, translation: (D, 3, 3), (D, 3) cam_from_world of its camera.
        mirror: (K,) left/right counterparts.
    """

    camera: Array
    place: Array
    xy_norm: Array
    score: Array
    direction: Array
    centre: Array
    rotation: Array
    translation: Array
    mirror: Array

    def __len__(self) -> int:
        return len(self.camera)


def candidates_from_detections(detections: Sequence[Detections2D], rig: Rig) -> Candidates:
    """All detections (one entry per camera, in the order of the rig) as rays."""
    camera = np.repeat(np.arange(len(rig)), [len(d) for d in detections])
    place = np.concatenate([np.arange(len(d)) for d in detections])
    xy_norm = np.concatenate([cam.norm_from_px(d.xy_img) for cam, d in zip(rig, detections, strict=True)])
    score = np.concatenate([np.nan_to_num(d.score.astype(np.float64)) for d in detections])
    score = np.where(np.isfinite(xy_norm).all(axis=-1), score, 0.0)
    rotation = np.stack([cam.cam_from_world.matrix() for cam in rig])[camera]
    translation = np.stack([cam.cam_from_world.xyz for cam in rig])[camera]
    ahead = np.concatenate([xy_norm, np.ones_like(xy_norm[..., :1])], axis=-1)
    direction = ahead @ rotation
    direction = direction / np.linalg.norm(direction, axis=-1, keepdims=True)
    mirror = detections[0].skeleton.mirror
    return Candidates(
        camera=camera,
        place=place,
        xy_norm=xy_norm,
        score=score,
        direction=direction,
        centre=rig.centres_world()[camera],
        rotation=rotation,
        translation=translation,
        mirror=mirror,
    )


def agreement(candidates: Candidates, xyz_world: Array, tolerance_m: float | Array) -> tuple[Array, Array]:
    """How well poses (H, K, 3) explain each detection: support (H, D) and share of its keypoints that agree (H, D).

    A keypoint supports by its score, less the square of its miss over the tolerance; the miss is measured at the depth
    of the body. `tolerance_m` is one for all or (H, 1, 1). A detection with left and right exchanged still is this person:
    the better reading counts.
    """
    as_named = _agreement(candidates, xyz_world, tolerance_m)
    exchanged = _agreement(candidates, xyz_world[:, candidates.mirror], tolerance_m)
    better = exchanged[0] > as_named[0]
    return np.where(better, exchanged[0], as_named[0]), np.where(better, exchanged[1], as_named[1])


def _agreement(candidates: Candidates, xyz_world: Array, tolerance_m: float | Array) -> tuple[Array, Array]:
    xyz_cam = np.einsum("dij,hkj->hdki", candidates.rotation, xyz_world) + candidates.translation[:, None]
    with np.errstate(invalid="ignore"):
        miss = np.linalg.norm(xyz_cam[..., :2] - candidates.xy_norm * xyz_cam[..., 2:], axis=-1)
        gain = np.where(xyz_cam[..., 2] > 0, 1 - (miss / tolerance_m) ** 2, 0.0)
    gain = np.where(gain > 0, gain, 0.0)
    both = (candidates.score > 0) & np.isfinite(xyz_cam[..., 0])
    share = (gain > 0).sum(axis=-1) / np.maximum(both.sum(axis=-1), 1)
    return (gain * candidates.score).sum(axis=-1), share


def meeting_points(candidates: Candidates, pairs: Array) -> tuple[Array, Array]:
    """For pairs (H, 2) of detections: midpoints (H, K, 3) of their rays' common perpendiculars, and its lengths (H, K).

    NaN where a keypoint is missing, the rays are parallel, or meet behind a camera.
    """
    one, two = pairs[:, 0], pairs[:, 1]
    d, f = candidates.direction[one], candidates.direction[two]
    base = (candidates.centre[two] - candidates.centre[one])[:, None]
    cosine = (d * f).sum(axis=-1)
    along_d, along_f = (base * d).sum(axis=-1), (base * f).sum(axis=-1)
    usable = (candidates.score[one] > 0) & (candidates.score[two] > 0)
    sine2 = np.where(usable & (1 - cosine**2 > 1e-4), 1 - cosine**2, np.nan)
    s, t = (along_d - cosine * along_f) / sine2, (cosine * along_d - along_f) / sine2
    ends = candidates.centre[one][:, None] + s[..., None] * d, candidates.centre[two][:, None] + t[..., None] * f
    ahead = (s > 0) & (t > 0)
    gap = np.where(ahead, np.linalg.norm(ends[0] - ends[1], axis=-1), np.nan)
    return np.where(ahead[..., None], (ends[0] + ends[1]) / 2, np.nan), gap


def joint_points(candidates: Candidates, members: Array, tolerance_m: float) -> Array:
    """(K, 3) points nearest to the rays of several detections; NaN where fewer than two see the keypoint.

    Score-weighted least squares on the distances to the rays, re-weighted (Cauchy at the tolerance) so that a member
    that does not belong cannot pull.
    """
    d, centre = candidates.direction[members], candidates.centre[members][:, None]
    weight = candidates.score[members] ** 2
    seen = (weight > 0).sum(axis=0) >= 2
    across = np.eye(3) - d[..., :, None] * d[..., None, :]
    across = np.where(weight[..., None, None] > 0, across, 0.0)
    target = (across @ centre[..., None])[..., 0]
    xyz = np.full((d.shape[1], 3), np.nan)
    robust = weight
    for _ in range(4):
        information = (robust[..., None, None] * across).sum(axis=0)
        information = np.where(seen[:, None, None], information, np.eye(3)) + 1e-9 * np.eye(3)
        xyz = np.linalg.solve(information, (robust[..., None] * target).sum(axis=0)[..., None])[..., 0]
        miss = np.linalg.norm((across @ xyz[..., None])[..., 0] - target, axis=-1)
        robust = weight / (1 + (3 * miss / tolerance_m) ** 2)
    return np.where(seen[:, None], xyz, np.nan)
