"""A shoulder or hip that never got a 3D point: where it may be, so that the person still has a skeleton to start from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from posefuse.core import PoseSequence
from posefuse.core.arrays import Array
from posefuse.core.view_sequences import nearest_frames

from .model import FEWEST_SEEN
from .shape import LengthPrior

# a missing joint -> the segment across the body there, and the pair of joints whose line it is taken to be parallel to
_ACROSS = {"shoulder": ("shoulders", "hip"), "hip": ("hips", "shoulder")}
_SIDES = ("left", "right")


def with_stand_ins(sequence: PoseSequence, prior: LengthPrior) -> PoseSequence:
    """The poses with a shoulder that was hardly ever seen put next to the other one, parallel to the hips, and hips likewise.

    They are as far apart as people's are on average. For the start of a fit alone: nothing was measured there. A person
    who lacks a shoulder and a hip keeps both gaps.
    """
    xyz = sequence.xyz_world.copy()
    places = {name: k for k, name in enumerate(sequence.skeleton.keypoints)}
    for joint, (segment, other) in _ACROSS.items():
        if any(f"{side}_{name}" not in places for side in _SIDES for name in (joint, other)) or segment not in prior.names:
            continue
        width_m = float(prior.mean_m[prior.names.index(segment)])
        left, right = (places[f"{side}_{joint}"] for side in _SIDES)
        line = sequence.xyz_world[:, :, places[f"right_{other}"]] - sequence.xyz_world[:, :, places[f"left_{other}"]]
        line = width_m * line / np.linalg.norm(line, axis=-1, keepdims=True)
        for n in range(xyz.shape[1]):
            _fill(xyz[:, n], left, right, line[:, n])
    return replace(sequence, xyz_world=xyz)


def _fill(xyz: Array, left: int, right: int, line: Array) -> None:
    """Fill the side of (T, K, 3) that was hardly ever seen from the other, which lies a line (T, 3) to the right or left."""
    seen = {side: np.isfinite(xyz[:, side]).all(axis=-1) for side in (left, right)}
    for missing, known, sign in ((left, right, -1.0), (right, left, 1.0)):
        if seen[missing].sum() < FEWEST_SEEN <= seen[known].sum():
            gaps = ~seen[missing] & seen[known]
            xyz[gaps, missing] = xyz[gaps, known] + sign * line[gaps]


def nearest_in_time(sequence: PoseSequence) -> Array:
    """(T, N, K, 3) points of a recording; a missing one is where it was nearest in time, carried along by the hips.

    Only a place to start from: a limb that begins bent the wrong way may stay so, since rays far off count little.
    """
    hips = [sequence.skeleton.index(f"{side}_hip") for side in ("left", "right")]
    filled = sequence.xyz_world.copy()
    for n in range(filled.shape[1]):
        middle = filled[:, n, hips].mean(axis=1)
        for k in range(filled.shape[2]):
            known = np.flatnonzero(np.isfinite(filled[:, n, k, 0]) & np.isfinite(middle[:, 0]))
            missing = np.flatnonzero(np.isnan(filled[:, n, k, 0]))
            if len(known) and len(missing):
                near = known[nearest_frames(known, missing)]
                filled[missing, n, k] = filled[near, n, k] + middle[missing] - middle[near]
    return filled
