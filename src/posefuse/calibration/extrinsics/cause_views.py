"""Explanations in single images: blur, and markers that are mixed up."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from posefuse.calibration.solving.projection import Lenses
from posefuse.calibration.targets.kinds import patch_corners
from posefuse.core.arrays import SIGMA_PER_MAD, Array

from .causes import CauseTrial, Trouble
from .pipeline import TIME_STEPS, Solved, key_snapshots
from .planar import planar_views
from .snapshots import Snapshots

# coordinates of the middle of a marker scatter by half of a corner's noise; more than twice that is no noise
_MOST_SHARED = 2.0
# markers of a camera that fit less often than this never fit
_ODD_SHARE = 0.3


def views_wrong(trouble: Trouble) -> Iterator[CauseTrial]:
    """Images are blurred, or some markers of one camera are not those of the target."""
    if trouble.solved is None:
        yield from _blurred_views(trouble)
        return
    yield from _blurred(trouble, trouble.solved)
    yield from _odd_markers(trouble, trouble.solved)


def _blurred(trouble: Trouble, solved: Solved) -> Iterator[CauseTrial]:
    """The corners of some cameras are noisy each by itself, which neither pose nor time nor intrinsics make them."""
    seen, residual = solved.seen, solved.solution.residual_px
    own, shared = _noise_px(seen, residual, len(trouble.cameras))
    usual = float(np.nanmedian(own))
    limit = trouble.options.limits.corner_spread_px_per_1000 * max(max(c.size_wh) for c in trouble.cameras) / 1000
    blurred = [c for c in range(len(own)) if own[c] > min(3 * usual, limit) and shared[c] < _MOST_SHARED * own[c]]
    if not blurred:
        return
    names = ", ".join(trouble.cameras[c].name for c in blurred)
    sigma = float(np.nanmin(own))
    scaled = np.where(
        np.isin(seen.camera, blurred)[:, None], residual * (sigma / np.maximum(own, 1e-9))[seen.camera][:, None], residual
    )
    yield CauseTrial(
        f"the images of {names} are blurred or noisy: corners scatter by {max(own[c] for c in blurred):.1f} px each by itself",
        "focus, add light, shorten the exposure, or use larger markers", seen.camera, scaled, 0, len(blurred),
    )  # fmt: skip


def _noise_px(seen: Snapshots, residual: Array, cameras: int) -> tuple[Array, Array]:
    """(C,) scatter of corners about the middle of their marker, and of these middles times the root of their number."""
    good = np.nan_to_num(residual, nan=1e3)
    count = np.bincount(seen.group, minlength=seen.group_count)
    mean = np.stack([np.bincount(seen.group, good[:, k], seen.group_count) / np.maximum(count, 1) for k in (0, 1)], axis=1)
    inside = np.abs(good - mean[seen.group]) * np.sqrt(count / np.maximum(count - 1, 1))[seen.group][:, None]
    camera = seen.camera[seen.group_starts()]
    middle = np.abs(mean) * np.sqrt(count)[:, None]

    def usual(values: Array, of: Array) -> Array:
        return np.array([SIGMA_PER_MAD * np.median(values[of == c]) if (of == c).any() else np.nan for c in range(cameras)])

    return usual(inside, seen.camera), usual(middle, camera)


def _blurred_views(trouble: Trouble) -> Iterator[CauseTrial]:
    """For cameras that could not be linked: corners that scatter about any image of the target, in each image by itself."""
    seen = key_snapshots(trouble.observations, replace(trouble.options, instants=TIME_STEPS), np.zeros((len(trouble.cameras), 2)))
    if len(seen.camera) == 0:
        return
    views = planar_views(seen, patch_corners(trouble.target, seen.patches), Lenses(trouble.cameras))
    corners = views.rows[:, 1] - views.rows[:, 0]
    # a pose takes up six of the coordinates
    free = np.sqrt(2 * corners / np.maximum(2 * corners - 6, 1))
    focal = np.array([camera.K[0, 0] for camera in trouble.cameras])[views.camera]
    noise = views.error_norm[:, 0] * focal * free / np.sqrt(2)
    limit = trouble.options.limits.corner_spread_px_per_1000 * max(max(c.size_wh) for c in trouble.cameras) / 1000
    usual = [
        float(np.median(noise[views.camera == c])) if (views.camera == c).any() else 0.0 for c in range(len(trouble.cameras))
    ]
    blurred = [c for c, value in enumerate(usual) if value > limit]
    if blurred:
        names = ", ".join(trouble.cameras[c].name for c in blurred)
        # seen in each image by itself: no solve is needed to show it
        left = np.zeros((len(seen.camera), 2))
        yield CauseTrial(
            f"the images of {names} are blurred or noisy: corners scatter by {max(usual):.1f} px in single images",
            "focus, add light, shorten the exposure, use larger markers; is the target described as it is?",
            seen.camera, left, 0, 0,
        )  # fmt: skip


def _odd_markers(trouble: Trouble, solved: Solved) -> Iterator[CauseTrial]:
    """Some markers of one camera never fit, its others do: ids are mixed up there, or belong to something else."""
    first = solved.seen.group_starts()
    camera, patch, inlier = solved.seen.camera[first], solved.seen.patch[first], solved.inlier
    for c in np.unique(camera):
        mine = camera == c
        odd = [int(p) for p in np.unique(patch[mine]) if inlier[mine & (patch == p)].mean() < _ODD_SHARE]
        rest = mine & ~np.isin(patch, odd)
        if odd and rest.any() and inlier[rest].mean() > 1 - _ODD_SHARE:
            keep = ~((solved.seen.camera == c) & np.isin(solved.seen.patch, odd))
            ids = ", ".join(str(int(solved.seen.patches[p])) for p in odd)
            yield CauseTrial(
                f"markers {ids} that {trouble.cameras[c].name} sees are not those of the target: ids mixed up, or another prop",
                "look at what this camera saw, and take away what carries the same ids", solved.seen.camera[keep],
                solved.solution.residual_px[keep], 0, 6 * len(odd),
            )  # fmt: skip
