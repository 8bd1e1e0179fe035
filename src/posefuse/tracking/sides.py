"""Left/right correction over time: a limb that changes sides for a few time steps moves as no limb does, and is put right.

When legs pass each other most views may confuse them at once, and then no single time step can decide. Motion can: the swinging
foot is fast and the standing one is not, so the labelling under which all limbs keep their velocity is the right one. Live, views
are compared with the tracked pose (`tracking.online.kernels.rays`).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from posefuse.core import PoseSequence, Rig, Skeleton, ViewSequence
from posefuse.core.arrays import Array, give_away
from posefuse.core.skeleton import swap_sides

# a keypoint's surprise counts up to this distance from where its velocity would have taken it
_MOST_SURPRISE_M = 0.4
# what a swap must gain per time step and keypoint to be believed
_PRIOR_M = 0.03
# clues to where the body faces that must outweigh the others before a swap against them counts as impossible
_FACING_CLUES = 2
# hips and shoulders are on the same side where the cosine of the angle between their left-right axes is clear of zero
_LEAST_TWIST = 0.2
# a view is held to no less than this, so that an overconfident one is not swapped for a few pixels
_LEAST_SIGMA_PX = 2.0
# Cauchy loss that swapping a limb in a view must save, its scale in standard deviations, and the share of their distance to the
# reference that both sides may keep: a view that takes one arm for both gives no reason to swap the arms of another view
_LEAST_GAIN, _SCALE_SIGMA, _NEARER = 2.0, 2.0, 0.8
# time steps whose views are judged at once: intermediate arrays are several times as large as the views
_PART_STEPS = 1000


def steady_sides(sequence: PoseSequence, facing: Array) -> tuple[Array, Array]:
    """Positions (T, N, K, 3) and covariances (T, N, K, 3, 3) with left and right of arms and legs swapped where that makes their
    motion steady, for each person separately.

    The labelling of least total surprise over the whole recording (Viterbi over pairs of time steps; surprise is the distance
    from constant velocity); arms and legs also stay on the side of the body that feet, nose and knees show, and legs on
    the side given by the shoulders. Arms of which nothing shows where they belong are never swapped in most of a recording.

    Args:
        sequence: poses. facing: (2, T, N) clues, for arms and for legs, that their left one is on the left, less those against
            it, as `posefuse.kinematics.facing_votes` counts them; zeros where nothing is known.
    """
    xyz, cov = sequence.xyz_world.copy(), sequence.cov_world.copy()
    # arms first: their shoulders then show which side of the body the hips are on
    for part, (left, right) in enumerate(sequence.skeleton.limbs):
        for n in range(len(sequence.person_id)):
            agree = np.where(np.abs(facing[part, :, n]) >= _FACING_CLUES, np.sign(facing[part, :, n]), 0)
            if part > 0:
                twist = _twist(xyz[:, n], sequence.skeleton)
                agree += np.where(np.abs(twist) > _LEAST_TWIST, np.sign(twist), 0)
            swapped = _labels(sequence.t_ns, xyz[:, n, left], xyz[:, n, right], agree)
            wrong = np.isin(np.arange(len(sequence)), swapped)
            for plane in (xyz, cov):
                swap_sides(plane[:, n], wrong, left, right)
    return xyz, cov


def sides_like(reference: PoseSequence, rig: Rig, views: ViewSequence) -> ViewSequence:
    """The views with left and right of a limb swapped wherever that view then fits the reference better.

    The reference is the same recording steadied over time, so a view is judged by what came before and after as well as by
    the other views.
    """
    parts = parts_of_steps(len(reference))
    wrong = [sides_that_differ(reference.xyz_world[part], rig, views.part(part)) for part in parts]
    return with_sides_swapped(views, np.concatenate(wrong))


def parts_of_steps(steps: int) -> list[slice]:
    """Time steps whose views are judged at once; at least one part, which may be empty."""
    return [slice(start, start + _PART_STEPS) for start in range(0, max(steps, 1), _PART_STEPS)]


def sides_that_differ(xyz_world: Array, rig: Rig, views: ViewSequence, sigma_m: Array | None = None) -> Array:
    """(T, N, C, L) which of the skeleton's L pairs of limbs a view has swapped, by points (T, N, K, 3); see `sides_like`.

    sigma_m: (T, N, K) how well the points are known, where that is less than what a view states.
    """
    expected = np.stack([camera.project(xyz_world) for camera in rig], axis=2)
    wrong = np.zeros((*views.score.shape[:3], len(views.skeleton.limbs)), bool)
    sigma_px = np.fmax(views.sigma_px, _LEAST_SIGMA_PX)
    known_px = np.zeros(sigma_px.shape) if sigma_m is None else _in_images(rig, xyz_world, sigma_m)
    for limb, (left, right) in enumerate(views.skeleton.limbs):
        # the same for both sides: otherwise what is known least would fit best
        doubt_px = np.fmax(known_px[..., left], known_px[..., right])
        saved, nearer = np.zeros(wrong.shape[:-1]), np.zeros(wrong.shape[:-1])
        for seen, other in ((left, right), (right, left)):
            kept, swapped = (
                np.linalg.norm(views.xy_img[..., seen, :] - expected[..., named, :], axis=-1)
                / np.hypot(sigma_px[..., seen], doubt_px)
                for named in (seen, other)
            )
            # missing ones do not count
            saved += np.nansum(_loss(kept) - _loss(swapped), axis=-1)
            nearer += np.nansum(_NEARER * kept - swapped, axis=-1)
        wrong[..., limb] = (saved > _LEAST_GAIN) & (nearer > 0)
    return wrong


def _loss(sigmas: Array) -> Array:
    """Cauchy loss of distances in standard deviations."""
    return np.log1p((sigmas / _SCALE_SIGMA) ** 2)


def _in_images(rig: Rig, xyz_world: Array, sigma_m: Array) -> Array:
    """(T, N, C, K) pixels that so many metres at the points are."""
    depth_m = np.linalg.norm(xyz_world[:, :, None] - rig.centres_world()[:, None], axis=-1)
    return np.asarray(np.array([camera.K[0, 0] for camera in rig])[:, None] * sigma_m[:, :, None] / depth_m)


def with_sides_swapped(views: ViewSequence, wrong: Array) -> ViewSequence:
    """The views with left and right swapped of the limbs (T, N, C, L) that are wrong."""
    planes = {name: np.array(getattr(views, name)) for name in ("xy_img", "score", "sigma_px")}
    if views.depth_m is not None:
        planes["depth_m"] = np.array(views.depth_m)
    for limb, (left, right) in enumerate(views.skeleton.limbs):
        for plane in planes.values():
            swap_sides(plane, wrong[..., limb], left, right)
    give_away(*planes.values())
    changed: dict[str, Any] = dict(planes)
    return replace(views, **changed)


def _twist(xyz: Array, skeleton: Skeleton) -> Array:
    """(T,) cosine between hip line and shoulder line, both from right to left; NaN where one is missing.

    Swapping arms or legs, not both, turns its sign.
    """
    if any(f"left_{part}" not in skeleton.keypoints for part in ("hip", "shoulder")):
        return np.full(len(xyz), np.nan)
    lines = [xyz[:, skeleton.index(f"left_{part}")] - xyz[:, skeleton.index(f"right_{part}")] for part in ("hip", "shoulder")]
    length = np.prod([np.linalg.norm(line, axis=-1) for line in lines], axis=0)
    return np.asarray((lines[0] * lines[1]).sum(axis=-1) / np.where(length > 1e-6, length, np.nan))


def _labels(t_ns: Array, left: Array, right: Array, agree: Array) -> Array:
    """Indices of the time steps to swap, from (T, k, 3) positions of both sides.

    agree: (T,) how much of the rest of the body shows that sides are right, negative: swapped, 0: nothing.
    """
    count = len(t_ns)
    if count < 3:
        return np.zeros(0, np.intp)
    both = np.stack([np.concatenate([left, right], axis=1), np.concatenate([right, left], axis=1)])  # (label, T, 2k, 3)
    stretch = (np.diff(t_ns)[1:] / np.diff(t_ns)[:-1])[:, None, None]
    impossible = _MOST_SURPRISE_M**2
    keep = np.where(agree < 0, -agree, 0) * impossible
    swap = _PRIOR_M**2 * np.isfinite(left[..., 0]).sum(axis=1) * 2 + np.where(agree > 0, agree, 0) * impossible
    prior = np.stack([keep, swap], axis=1)
    cost = prior[0][:, None] + prior[1][None]  # (label before, label now)
    came_from = np.zeros((count, 2, 2), np.int8)
    surprise: Array = np.stack(
        [[[_surprise(both[a, :-2], both[b, 1:-1], both[c, 2:], stretch) for c in (0, 1)] for b in (0, 1)] for a in (0, 1)]
    )  # (a, b, c, T - 2)
    for t in range(2, count):
        total = cost[:, :, None] + surprise[..., t - 2] + prior[t]
        came_from[t] = total.argmin(axis=0)
        cost = total.min(axis=0)
    b, c = np.unravel_index(int(cost.argmin()), cost.shape)
    labels = np.zeros(count, np.int8)
    labels[-2:] = b, c
    for t in range(count - 1, 1, -1):
        labels[t - 2] = came_from[t, labels[t - 1], labels[t]]
    if 2 * labels.sum() > count and not agree.any():  # only the majority decides
        labels = 1 - labels
    return np.flatnonzero(labels)


def _surprise(before: Array, now: Array, after: Array, stretch: Array) -> Array:
    """(T - 2,) summed squared distance from constant velocity; keypoints missing at any of the three do not count."""
    away = np.linalg.norm(after - now - (now - before) * stretch, axis=-1)
    return np.asarray(np.nansum(np.minimum(away, _MOST_SURPRISE_M) ** 2, axis=1))
