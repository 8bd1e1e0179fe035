"""What sets the scale of a rig from a person: the person's stature, or the distance of two cameras."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posefuse.core import CalibrationError, Rig, Skeleton
from posefuse.core.arrays import Array
from posefuse.core.skeleton import LIMB_ENDS, SIDES

# of people who can be asked to walk through a room
_STATURES_M = (0.8, 2.4)
# of people of any age, standing or not; limbs that are not wholly seen come out somewhat short
_SIZES_M = (0.5, 2.7)
# the length of a limb as a share of the person's height, as networks mark it;
# `bench/fit_stature.py`: bodies left out come out 0.4 % too small, with a standard deviation of 1.1 %
STATURE_SHARES = {"upper_arm": 0.1560, "forearm": 0.1443, "thigh": 0.2261, "shank": 0.2346}
# standard error of a height as a share of it: that deviation, and how limbs vary among people of one height (2.4 %, by the
# spreads of segments in `tracking/segments.py`)
STATURE_SIGMA = 0.027


@dataclass(frozen=True)
class KnownLength:
    """What sets the scale: the person's stature in metres, or two cameras and their distance in metres; exactly one of them."""

    stature_m: float | None = None
    apart: tuple[str, str, float] | None = None

    def __post_init__(self) -> None:
        if self.apart is not None and self.apart[0] == self.apart[1]:
            raise CalibrationError(f"scale: expected the distance of two cameras, got {self.apart[0]} twice")
        metres = self.stature_m if self.apart is None else self.apart[2]
        if not (metres is not None and np.isfinite(metres) and metres > 0):
            raise CalibrationError(f"scale: expected a length > 0 m, got {metres}")
        least_m, most_m = _STATURES_M
        if self.stature_m is not None and not least_m <= self.stature_m <= most_m:
            centimetres = f"; did you mean {metres / 100:g} m?" if least_m <= metres / 100 <= most_m else ""
            raise CalibrationError(f"height of the person: expected {least_m:g} to {most_m:g} m, got {metres:g}{centimetres}")

    def scale(self, rig: Rig, skeleton: Skeleton, xyz: Array) -> float:
        """By how much a rig of any scale, and the person's keypoints (T, K, 3) in it, have to grow."""
        if self.stature_m is not None:
            return self.stature_m / stature_m(skeleton, xyz)
        assert self.apart is not None
        first, second, distance_m = self.apart
        return distance_m / float(np.linalg.norm(rig[second].centre_world - rig[first].centre_world))


def limb_lengths_m(skeleton: Skeleton, xyz: Array) -> Array:
    """(4,) usual length of each of `LIMB_ENDS`, both sides, of keypoints (T, K, 3); NaN where none was seen."""
    out = np.full(len(LIMB_ENDS), np.nan)
    for i, ends in enumerate(LIMB_ENDS.values()):
        sides = [[f"{side}_{end}" for end in ends] for side in SIDES]
        known = [[skeleton.index(name) for name in names] for names in sides if all(name in skeleton.keypoints for name in names)]
        lengths = np.array([np.linalg.norm(xyz[:, a] - xyz[:, b], axis=1) for a, b in known])
        if np.isfinite(lengths).any():
            out[i] = np.nanmedian(lengths)
    return out


def stature_m(skeleton: Skeleton, xyz: Array) -> float:
    """A person's height from the limbs of keypoints (T, K, 3); NaN when no limb is there. How well: `bench/fit_stature.py`."""
    lengths, shares = limb_lengths_m(skeleton, xyz), np.array(list(STATURE_SHARES.values()))
    known = np.isfinite(lengths)
    return float(lengths[known].sum() / shares[known].sum()) if known.any() else float("nan")


def size_doubt(skeleton: Skeleton, xyz: Array) -> str:
    """What a rig is wrong in where people (T, N, K, 3) are far too small or too large in it; empty where they are not."""
    sizes_m = np.array([stature_m(skeleton, xyz[:, n]) for n in range(xyz.shape[1])])
    if not np.isfinite(sizes_m).any():
        return ""
    size_m, (least_m, most_m) = float(np.nanmedian(sizes_m)), _SIZES_M
    if least_m <= size_m <= most_m:
        return ""
    return (
        f"people are {size_m:.2f} m tall by this calibration: its translations are not in metres (decimetres, feet?), or the size"
        " of its target was wrong"
    )
