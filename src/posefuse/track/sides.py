"""Left and right over time: a limb that changes sides for a few instants moves as no limb does, and is put right.

When legs pass each other most views may confuse them at once, and then no single instant can tell. Time can: the swinging
foot is fast and the standing one is not, so the labelling under which all limbs keep their velocity is the right one.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from posefuse.core import PoseSequence, Rig, Skeleton
from posefuse.core.arrays import Array

_LIMBS = (
    ("hip", "knee", "ankle", "heel", "foot_index", "big_toe", "small_toe"),
    ("shoulder", "elbow", "wrist", "pinky", "index", "thumb"),
)
# a keypoint's surprise counts up to this distance from where its velocity would have taken it
_MOST_SURPRISE_M = 0.4
# what an exchange must gain per instant and keypoint to be believed
_PRIOR_M = 0.03
# a view is held to no less than this, so that an overconfident one is not exchanged for a few pixels
_LEAST_SIGMA_PX = 2.0
# Cauchy loss that exchanging a limb in a view must save; its scale in standard deviations
_LEAST_GAIN, _SCALE_SIGMA = 2.0, 2.0


def steady_sides(sequence: PoseSequence) -> PoseSequence:
    """Exchange left and right of arms and legs where that lets them move on steadily, for each person by itself.

    The labelling of least total surprise over the whole recording (Viterbi over pairs of instants; surprise is the distance
    from constant velocity); a recording is never exchanged as a whole.
    """
    fields = ("xyz_world", "cov_world", "reproj_px", "n_views", "kind")
    arrays = {name: np.array(getattr(sequence, name)) for name in fields}
    for left, right in _sides(sequence.skeleton):
        for n in range(len(sequence.person_id)):
            swapped = _labels(sequence.t_ns, arrays["xyz_world"][:, n, left], arrays["xyz_world"][:, n, right])
            wrong = np.isin(np.arange(len(sequence)), swapped)
            for array in arrays.values():
                _exchange(array[:, n], wrong, left, right)
    return replace(sequence, **arrays)


def sides_like(reference: PoseSequence, rig: Rig, xy_img: Array, score: Array, sigma_px: Array) -> tuple[Array, Array, Array]:
    """Views (T, N, C, K, ...) with left and right of a limb exchanged wherever that view then fits the reference better.

    The reference is the same recording steadied over time, so a view is judged by what came before and after as well as by
    the other views.

    Returns:
        xy_img (T, N, C, K, 2), score and sigma_px (T, N, C, K), new arrays.
    """
    planes = [np.array(xy_img), np.array(score), np.array(sigma_px)]
    expected = np.stack([camera.project(reference.xyz_world) for camera in rig], axis=2)
    sigma = np.fmax(planes[2], _LEAST_SIGMA_PX)
    for left, right in _sides(reference.skeleton):
        loss = {
            (i, j): _loss(planes[0][..., seen, :] - expected[..., named, :], sigma[..., seen])
            for i, seen in enumerate((left, right))
            for j, named in enumerate((left, right))
        }
        gain = loss[0, 0] + loss[1, 1] - loss[0, 1] - loss[1, 0]
        wrong = gain > _LEAST_GAIN
        for plane in planes:
            _exchange(plane, wrong, left, right)
    return planes[0], planes[1], planes[2]


def _loss(away_px: Array, sigma_px: Array) -> Array:
    """Cauchy loss of (..., k, 2) pixel distances, summed over keypoints; missing ones do not count."""
    square = (away_px**2).sum(axis=-1) / (_SCALE_SIGMA * sigma_px) ** 2
    return np.asarray(np.nansum(np.log1p(square), axis=-1))


def _exchange(plane: Array, wrong: Array, left: Array, right: Array) -> None:
    """Exchange columns `left` and `right` of plane[wrong] in place."""
    rows = plane[wrong]
    rows[:, left], rows[:, right] = rows[:, right], rows[:, left]
    plane[wrong] = rows


def _sides(skeleton: Skeleton) -> list[tuple[Array, Array]]:
    """Left and right keypoint indices of each limb pair."""
    pairs = []
    for parts in _LIMBS:
        left = [i for i, k in enumerate(skeleton.keypoints) if k.startswith("left_") and k[5:] in parts]
        if left:
            pairs.append((np.array(left), skeleton.mirror[left]))
    return pairs


def _labels(t_ns: Array, left: Array, right: Array) -> Array:
    """(T,) indices of the instants to exchange, from (T, k, 3) positions of both sides."""
    count = len(t_ns)
    if count < 3:
        return np.zeros(0, np.intp)
    both = np.stack([np.concatenate([left, right], axis=1), np.concatenate([right, left], axis=1)])  # (label, T, 2k, 3)
    stretch = (np.diff(t_ns)[1:] / np.diff(t_ns)[:-1])[:, None, None]
    prior = _PRIOR_M**2 * np.isfinite(left[..., 0]).sum(axis=1) * 2
    cost = np.array([[0.0, prior[1]], [prior[0], prior[0] + prior[1]]])  # (label before, label now)
    came_from = np.zeros((count, 2, 2), np.int8)
    surprise = np.stack(
        [[[_surprise(both[a, :-2], both[b, 1:-1], both[c, 2:], stretch) for c in (0, 1)] for b in (0, 1)] for a in (0, 1)]
    )  # (a, b, c, T - 2)
    for t in range(2, count):
        total = cost[:, :, None] + surprise[..., t - 2] + np.array([0.0, prior[t]])
        came_from[t] = total.argmin(axis=0)
        cost = total.min(axis=0)
    b, c = np.unravel_index(int(cost.argmin()), cost.shape)
    labels = np.zeros(count, np.int8)
    labels[-2:] = b, c
    for t in range(count - 1, 1, -1):
        labels[t - 2] = came_from[t, labels[t - 1], labels[t]]
    if 2 * labels.sum() > count:
        labels = 1 - labels
    return np.flatnonzero(labels)


def _surprise(before: Array, now: Array, after: Array, stretch: Array) -> Array:
    """(T - 2,) summed squared distance from constant velocity; keypoints missing at any of the three do not count."""
    away = np.linalg.norm(after - now - (now - before) * stretch, axis=-1)
    return np.asarray(np.nansum(np.minimum(away, _MOST_SURPRISE_M) ** 2, axis=1))
