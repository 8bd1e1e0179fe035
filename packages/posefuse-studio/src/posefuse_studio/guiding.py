"""When a recording of a target is enough for its step of a calibration, and what to do until then: pure functions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from posefuse.calibration.targets.coverage import ENOUGH_SHARE, ENOUGH_TOGETHER, TargetCoverage
from posefuse.core.arrays import Array

from .calibrations import Step

# the calibration of lenses from a cube needs 1.3, see `Limits.own_depth_ratio`; the rest is for the error of sizes
NEAR_FAR = 1.45


def enough_for(step: Step, found: TargetCoverage, near_far: Array | None = None) -> bool:
    """Lenses need each image covered; a verification needs each camera to share views with another; positions need both.

    Args:
        found: what is covered. near_far: (C,) of `near_far_of`, where the recording is to give the lenses, too; None: it is not.
    """
    if step == "intrinsics":
        return bool((found.share >= ENOUGH_SHARE).all())
    if step == "verify":
        # three times the least that `verify` takes
        return bool((_shared(found) >= ENOUGH_TOGETHER).all())
    return found.enough and (near_far is None or bool((near_far >= NEAR_FAR).all()))


def near_far_of(sizes_px: Sequence[Sequence[float]]) -> Array:
    """(C,) by how much a target looked larger from near than from far, for the sizes of its views in each camera; 1: unknown.

    The largest edge of a square is hardly shortened by a tilt, so that sizes stand for distances.
    """
    spans = [np.quantile(one, [0.05, 0.95]) if len(one) > 1 else np.ones(2) for one in sizes_px]
    return np.array([far / near for near, far in spans])


def size_of(xy_img: Array, patch: Array) -> float:
    """The longest edge, px, of the squares (n, 2) corners of a frame, four to a patch (n,); NaN without a whole one."""
    squares = [xy_img[patch == one] for one in np.unique(patch)]
    edges = [np.linalg.norm(one - np.roll(one, 1, axis=0), axis=1).max() for one in squares if len(one) == 4]
    return float(max(edges, default=np.nan))


def advice_for(step: Step, found: TargetCoverage, near_far: Array | None = None) -> str:
    """What to do next, in words; arguments as of `enough_for`."""
    if enough_for(step, found, near_far):
        return _named("enough: stop moving the target", step)
    if step == "intrinsics":
        # no camera needs another one: as if all were linked
        linked = np.where(np.eye(len(found.cameras), dtype=bool), found.together, ENOUGH_TOGETHER)
        return _named(replace(found, together=linked).advice(), step)
    if step == "verify":
        shared = _shared(found)
        camera = int(np.argmin(shared))
        return f"show the board to {found.cameras[camera]} and another camera: {shared[camera]} of {ENOUGH_TOGETHER}"
    if found.enough and near_far is not None:
        camera = int(np.argmin(near_far))
        return f"move the cube near {found.cameras[camera]}, and far away from it"
    return _named(found.advice(), step)


def _named(advice: str, step: Step) -> str:
    """With the word for the target of the step."""
    return advice.replace("the target", "the cube" if step == "extrinsics" else "the board")


def _shared(found: TargetCoverage) -> Array:
    """(C,) moments that each camera shares with the one it shares most with."""
    return np.asarray(np.where(np.eye(len(found.cameras), dtype=bool), 0, found.together).max(axis=1))
