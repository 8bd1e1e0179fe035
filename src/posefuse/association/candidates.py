"""Every person every camera saw, as rays in the world, how well a 3D pose explains each, and the detections of one person."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from posefuse.core import Detections2D, Rig, Views
from posefuse.core.arrays import Array, frozen_fields
from posefuse.core.depth import joined_depth, keypoint_depth
from posefuse.core.observations import NOT_KEPT
from posefuse.core.values import UNSEEN

from .settings import AssociateSettings

# factor on the support of a detection with left and right swapped; 1: IDF1 of rendered people who hug falls from 0.832 to 0.821
_SWAPPED_SHARE = 0.7
# squared sine of the angle between two rays that meet nowhere
_PARALLEL = 1e-4
# of weighing rays by their distances, until a ray that does not belong hardly counts: with one, rendered people who hug are
# swapped three times instead of once
_ROUNDS = 4


@dataclass(frozen=True, eq=False, kw_only=True)
class Candidates:
    """D detections of all cameras in one list.

    Attributes:
        camera: (D,) place of its camera in the rig. place: (D,) place within that camera's detections.
        xy_norm: (D, K, 2) ideal image-plane points. score: (D, K), 0 where unusable.
        direction: (D, K, 3) unit rays in world axes. centre: (D, 3) where they start.
        rotation, translation: (D, 3, 3), (D, 3) cam_from_world of its camera.
        mirror: (K,) left/right counterparts.
        deep_world: (D, K, 3) the keypoints at their measured depth; NaN where it is unknown, None where no camera has depth.
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
    deep_world: Array | None = None

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
    skeleton, depth_m = detections[0].skeleton, joined_depth(detections)
    at_depth = None if depth_m is None else ahead * keypoint_depth(depth_m, xy_norm, skeleton)[..., :1]
    return Candidates(
        camera=camera,
        place=place,
        xy_norm=xy_norm,
        score=score,
        direction=direction,
        centre=rig.centres_world()[camera],
        rotation=np.ascontiguousarray(rotation),
        translation=np.ascontiguousarray(translation),
        mirror=np.asarray(skeleton.mirror, np.int64),
        deep_world=None if at_depth is None else (at_depth - translation[:, None]) @ rotation,
    )


def agreement(candidates: Candidates, xyz_world: Array, tolerance_m: float | Array) -> tuple[Array, Array]:
    """How well poses (H, K, 3) explain each detection: support (H, D) and share of its keypoints that agree (H, D).

    A keypoint supports by its score, less the square of its miss over the tolerance; the miss is measured at the depth
    of the body. `tolerance_m` is one for all or (H,). A detection with left and right swapped still is this person, but
    less so: of two people who face each other the one is nearly the other with left and right swapped.
    """
    from . import kernels

    size = (len(xyz_world), len(candidates))
    support, share = np.empty(size), np.empty(size)
    reach = np.broadcast_to(np.asarray(tolerance_m, np.float64), len(xyz_world))
    kernels.agreement(
        candidates.rotation, candidates.translation, candidates.xy_norm, candidates.score, np.ascontiguousarray(xyz_world),
        np.ascontiguousarray(reach), candidates.mirror, _SWAPPED_SHARE, support, share,
    )  # fmt: skip
    return support, share


def pair_midpoints(candidates: Candidates, pairs: Array) -> tuple[Array, Array]:
    """For pairs (H, 2) of detections: midpoints (H, K, 3) of their rays' common perpendiculars, and its lengths (H, K).

    NaN where a keypoint is missing, the rays are parallel, or meet behind a camera.
    """
    (one, two), score = pairs.T, candidates.score
    a, b = candidates.direction[one], candidates.direction[two]
    from_a, from_b = candidates.centre[one, None], candidates.centre[two, None]
    cosine, along_a, along_b = ((x * y).sum(axis=-1) for x, y in ((a, b), (from_b - from_a, a), (from_b - from_a, b)))
    crossing = (score[one] > 0) & (score[two] > 0) & (1 - cosine**2 > _PARALLEL)
    sine2 = np.where(crossing, 1 - cosine**2, np.nan)
    far_a, far_b = (along_a - cosine * along_b) / sine2, (cosine * along_a - along_b) / sine2
    ahead = ((far_a > 0) & (far_b > 0))[..., None]
    end_a = np.where(ahead, from_a + far_a[..., None] * a, np.nan)
    end_b = np.where(ahead, from_b + far_b[..., None] * b, np.nan)
    return (end_a + end_b) / 2, np.linalg.norm(end_a - end_b, axis=-1)


def joint_points(candidates: Candidates, members: Array, tolerance_m: float) -> Array:
    """(K, 3) points nearest to the rays of several detections; NaN where fewer than two see the keypoint.

    Score-weighted least squares on the distances to the rays, re-weighted (Cauchy at a third of the tolerance) so that a
    member that does not belong cannot pull. Of a single detection with depth its own points, at their depth.
    """
    if len(members) == 1 and candidates.deep_world is not None:
        return np.asarray(candidates.deep_world[members[0]])
    weight, centre, ray = candidates.score[members] ** 2, candidates.centre[members, None], candidates.direction[members]
    # what of a vector lies across each ray (M, K, 3, 3)
    across = np.where((weight > 0)[..., None, None], np.eye(3) - ray[..., None] * ray[..., None, :], 0.0)
    at, counts = across @ centre[..., None], weight[..., None, None]
    for _ in range(_ROUNDS):
        # a little stiffer: parallel rays leave one direction open
        information = (counts * across).sum(axis=0) + 1e-9 * np.eye(3)
        xyz = np.linalg.solve(information, (counts * at).sum(axis=0))
        miss_m = np.linalg.norm((across @ xyz - at)[..., 0], axis=-1)
        counts = (weight / (1 + (3 * miss_m / tolerance_m) ** 2))[..., None, None]
    return np.where((weight > 0).sum(axis=0)[:, None] > 1, xyz[..., 0], np.nan)


@dataclass(frozen=True, eq=False, kw_only=True)
class Assignment:
    """Which detection of each camera is which person.

    Attributes:
        person_id: (N,) int64.
        place: (N, C) index among the detections of the camera; -1 where the camera does not see the person.
    """

    person_id: Array
    place: Array

    def __post_init__(self) -> None:
        frozen_fields(self, {"person_id": "N", "place": "N C"}, {"place": np.int64})

    def views(self, detections: Sequence[Detections2D], t_ns: int) -> Views:
        """The people's detections, one per camera in the order of axis C, as views at this time."""
        return Views.of(detections, t_ns, self.person_id, self.place)

    def people_of(self, c: int, count: int) -> Array:
        """(P,) the person of each of the `count` detections of camera c; -1 for those that belong to no person."""
        people = np.full(count, NOT_KEPT, np.int64)
        seen = self.place[:, c] != UNSEEN
        people[self.place[seen, c]] = self.person_id[seen]
        return people


# a person needs this many keypoints in 3D: fewer do not identify the person
LEAST_POINTS = 3


def best_per_camera(candidates: Candidates, support: Array) -> Array:
    """Indices of the best supported detection of each camera; cameras without support have none."""
    order = np.argsort(-support, kind="stable")
    order = order[support[order] > 0]
    _, first = np.unique(candidates.camera[order], return_index=True)
    return np.sort(order[first])


def refined_members(candidates: Candidates, members: Array, free: Array, settings: AssociateSettings) -> tuple[Array, Array]:
    """Fuse the members and ask every free detection again; once more with the answer. A single member stays as it is.

    Without this for the people followed, IDF1 of rendered people who cross and hug falls from 0.902 to 0.892; without the share
    of the keypoints from 0.936 to 0.928.

    Returns:
        The members, and their points (K, 3).
    """
    for _ in range(2):
        pose = joint_points(candidates, members, settings.tolerance_m)
        if len(members) < 2:
            return members, pose
        if np.isfinite(pose[:, 0]).sum() < LEAST_POINTS:
            return members[:0], pose
        support, share = agreement(candidates, pose[None], settings.tolerance_m)
        before, fits = members, (share[0] >= settings.min_share) & free
        members = best_per_camera(candidates, np.where(fits, support[0], 0.0))
        if np.array_equal(members, before):
            return members, pose
    return members, joint_points(candidates, members, settings.tolerance_m)
