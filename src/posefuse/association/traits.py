"""What distinguishes people without their faces: numbers that stay the same while a body moves, learnt frame by frame.

Seven lengths of the body (left and right averaged), in metres, from the 3D pose; then colours of the clothes of trunk, thighs
and shanks (CIE L*, a*, b*). A value that is unknown is NaN.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from posefuse.core import Detections2D, Skeleton
from posefuse.core.arrays import Array
from posefuse.core.skeleton import LIMB_ENDS, SIDES, pick_keypoints
from posefuse.core.values import UNSEEN

from .candidates import Assignment

# how many of the traits are lengths; each is the mean of both sides, between girdles twice the same
LENGTHS = 7
_SPANS = [[(f"{side}_{a}", f"{side}_{b}") for side in SIDES] for a, b in (*LIMB_ENDS.values(), ("shoulder", "hip"))]
_SPANS += [[(f"left_{name}", f"right_{name}")] * len(SIDES) for name in ("shoulder", "hip")]
_ENDS = tuple(zip(*(ends for sides in _SPANS for ends in sides), strict=True))
# adults of one population: standard deviation of a length as a share of it
_POPULATION_SHARE = 0.08
# clothes of trunk, thighs and shanks: standard deviations of L*, a*, b* among people
_POPULATION_LAB = (22.0, 12.0, 16.0) * 3
# standard deviations of errors that do not average out: those of the bundled network in a length (m), which change with cameras
# and poses, and those of clothes due to light, camera and side of the body
_LASTING = np.array((0.010,) * LENGTHS + (7.0, 4.0, 4.0) * 3)
# a cue is wrong for this share of people: hidden behind another person all the time, a jacket taken off, a bad pose
_WRONG_CUE = 0.03
# what is learnt and compared as one cue: lengths of the body, clothes of trunk, thighs and shanks
_CUES = (slice(0, 7), slice(7, 10), slice(10, 13), slice(13, 16))
# errors of a network last for about so many frames: this many count as one
_LASTING_FRAMES = 8
# lengths of people, from a small child's to a tall adult's; farther off is no body
_LEAST_M, _MOST_M = np.array([0.13, 0.11, 0.20, 0.20, 0.25, 0.14, 0.08]), np.array([0.50, 0.45, 0.65, 0.65, 0.80, 0.60, 0.50])
# traits known in so few frames carry no information
_LEAST_FRAMES = 4


def body_lengths_m(xyz_world: Array, skeleton: Skeleton) -> Array:
    """(N, 7) upper arm, forearm, thigh, shank, side of the trunk, shoulder width, hip width of poses (N, K, 3); NaN unknown."""
    one, other = (pick_keypoints(xyz_world, skeleton, ends) for ends in _ENDS)
    lengths = np.linalg.norm(one - other, axis=-1).reshape(len(xyz_world), LENGTHS, len(SIDES))
    known = np.isfinite(lengths)
    total = np.where(known, lengths, 0.0).sum(axis=-1)
    return np.where(known.any(axis=-1), total / np.maximum(known.sum(axis=-1), 1), np.nan)


def plausible_share(lengths_m: Array) -> Array:
    """(N,) share of the known lengths (N, 7) that a human body can have; 0 where none is known."""
    known = np.isfinite(lengths_m)
    fits = known & (lengths_m >= _LEAST_M) & (lengths_m <= _MOST_M)
    return np.asarray(fits.sum(axis=-1) / np.maximum(known.sum(axis=-1), 1))


@dataclass(frozen=True, eq=False, kw_only=True)
class Traits:
    """Running mean and variance of D traits.

    Attributes:
        frames: (D,) in how many frames each was known. mean: (D,). squares: (D,) sum of squared deviations.
    """

    frames: Array
    mean: Array
    squares: Array

    @staticmethod
    def unknown(size: int) -> Traits:
        """Nothing known yet."""
        return Traits(frames=np.zeros(size), mean=np.zeros(size), squares=np.zeros(size))

    def with_frame(self, values: Array) -> Traits:
        """After one more measurement (D,)."""
        known = np.isfinite(values)
        frames = self.frames + known
        before = np.where(known, values - self.mean, 0.0)
        mean = self.mean + before / np.maximum(frames, 1)
        after = np.where(known, values - mean, 0.0)
        return Traits(frames=frames, mean=mean, squares=self.squares + before * after)

    def pooled(self, other: Traits) -> Traits:
        """Of both together."""
        frames = self.frames + other.frames
        apart = np.where((self.frames > 0) & (other.frames > 0), other.mean - self.mean, 0.0)
        mean = (self.frames * self.mean + other.frames * other.mean) / np.maximum(frames, 1)
        shared = self.frames * other.frames / np.maximum(frames, 1)
        return Traits(frames=frames, mean=mean, squares=self.squares + other.squares + shared * apart**2)

    def of_mean(self) -> Array:
        """(D,) variance of the mean, with errors that last."""
        each = self.squares / np.maximum(self.frames, 1)
        return np.asarray(each / np.maximum(self.frames / _LASTING_FRAMES, 1))


def sameness(one: Traits, other: Traits) -> float:
    """Log-likelihood ratio: one person measured twice (D = 16), against two people drawn from the population. 0 is neutral.

    Each cue (lengths, clothes of trunk, thighs, shanks) is bounded separately, so that no single cue decides.
    """
    known = (one.frames >= _LEAST_FRAMES) & (other.frames >= _LEAST_FRAMES)
    lengths_m = np.maximum((one.mean + other.mean)[:LENGTHS] / 2, 1e-3)
    same = one.of_mean() + other.of_mean() + 2 * _LASTING**2
    two = same + 2 * np.concatenate([_POPULATION_SHARE * lengths_m, _POPULATION_LAB]) ** 2
    square = (one.mean - other.mean) ** 2
    # of two normal densities
    ratio = np.where(known, (square / two - square / same + np.log(two / same)) / 2, 0.0)
    return float(
        sum(np.logaddexp(np.log1p(-_WRONG_CUE) + ratio[cue].sum(), np.log(_WRONG_CUE)) for cue in _CUES if known[cue].any())
    )


# numbers that describe the clothes of a person: L*, a* and b* of trunk, thighs and shanks
CLOTHING_TRAITS = 9
# one view may show another person's clothes, in front of the person
_LEAST_VIEWS = 2


def clothing_traits(assignment: Assignment, detections: Sequence[Detections2D]) -> Array:
    """(N, 9) colours of each person of the assignment, see `median_clothing`."""
    seen = np.full((*assignment.place.shape, 3, 3), np.nan)
    for row, c in np.argwhere(assignment.place != UNSEEN):
        seen[row, c] = detections[c].clothing_lab[assignment.place[row, c]]
    return np.array([median_clothing(one) for one in seen]).reshape(-1, CLOTHING_TRAITS)


def median_clothing(clothing_lab: Array) -> Array:
    """(9,) medians over views (V, 3, 3) of L*, a*, b* of trunk, thighs and shanks; NaN where fewer than two views know."""
    known = np.asarray(np.isfinite(clothing_lab).all(axis=-1))
    enough = known.sum(axis=0) >= _LEAST_VIEWS
    median = np.full((3, 3), np.nan)
    for part in np.flatnonzero(enough):
        median[part] = np.median(clothing_lab[known[:, part], part], axis=0)
    return median.ravel()
