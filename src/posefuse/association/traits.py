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
# change of a measured length with cameras and poses: the part of the bundled network's errors that does not average out
_LASTING_M = 0.010
# clothes: standard deviations of L*, a*, b* among people, and those due to light, camera and side of the body
_POPULATION_LAB = np.array([22.0, 12.0, 16.0])
_LASTING_LAB = np.array([7.0, 4.0, 4.0])
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
    """Running mean and covariance of D traits.

    Attributes:
        frames: (D,) in how many frames each was known. mean: (D,). scatter: (D, D) sum of products of deviations.
    """

    frames: Array
    mean: Array
    scatter: Array

    @staticmethod
    def unknown(size: int) -> Traits:
        """Nothing known yet."""
        return Traits(frames=np.zeros(size), mean=np.zeros(size), scatter=np.zeros((size, size)))

    def with_frame(self, values: Array) -> Traits:
        """After one more measurement (D,)."""
        known = np.isfinite(values)
        frames = self.frames + known
        before = np.where(known, values - self.mean, 0.0)
        mean = self.mean + before / np.maximum(frames, 1)
        after = np.where(known, values - mean, 0.0)
        return Traits(frames=frames, mean=mean, scatter=self.scatter + np.outer(before, after))

    def pooled(self, other: Traits) -> Traits:
        """Of both together."""
        frames = self.frames + other.frames
        apart = np.where((self.frames > 0) & (other.frames > 0), other.mean - self.mean, 0.0)
        mean = (self.frames * self.mean + other.frames * other.mean) / np.maximum(frames, 1)
        shared = self.frames * other.frames / np.maximum(frames, 1)
        weight = np.sqrt(np.outer(shared, shared))
        return Traits(frames=frames, mean=mean, scatter=self.scatter + other.scatter + weight * np.outer(apart, apart))

    def of_mean(self) -> Array:
        """(D, D) covariance of the mean, with errors that last."""
        frames = np.maximum(self.frames, 1)
        each = self.scatter / np.sqrt(np.outer(frames, frames))
        independent = np.maximum(np.sqrt(np.outer(frames, frames)) / _LASTING_FRAMES, 1.0)
        return np.asarray((each + each.T) / 2 / independent)


def sameness(one: Traits, other: Traits) -> float:
    """Log-likelihood ratio: one person measured twice, against two people drawn from the population. 0 is neutral.

    Each cue (lengths, clothes of trunk, thighs, shanks) is bounded separately, so that no single cue decides.
    """
    known = (one.frames >= _LEAST_FRAMES) & (other.frames >= _LEAST_FRAMES)
    if not known.any():
        return 0.0
    apart = one.mean - other.mean
    measured = one.of_mean() + other.of_mean()
    lasting, population = _variances((one.mean + other.mean) / 2)
    total = 0.0
    for cue in _CUES:
        among = np.flatnonzero(known[cue]) + cue.start
        if len(among):
            same = measured[np.ix_(among, among)] + 2 * np.diag(lasting[among])
            two = same + 2 * np.diag(population[among])
            ratio = _log_density(apart[among], same) - _log_density(apart[among], two)
            total += float(np.logaddexp(np.log1p(-_WRONG_CUE) + ratio, np.log(_WRONG_CUE)))
    return total


def _variances(mean: Array) -> tuple[Array, Array]:
    """(D,) variance of lasting errors of each trait, and of the population, for traits of this size (D,)."""
    clothes = (len(mean) - LENGTHS) // len(_LASTING_LAB)
    lasting = np.concatenate([np.full(LENGTHS, _LASTING_M), np.tile(_LASTING_LAB, clothes)])
    population = np.concatenate([_POPULATION_SHARE * np.maximum(np.abs(mean[:LENGTHS]), 1e-3), np.tile(_POPULATION_LAB, clothes)])
    return lasting**2, population**2


def _log_density(apart: Array, cov: Array) -> float:
    _, log_det = np.linalg.slogdet(cov)
    return float(-0.5 * (apart @ np.linalg.solve(cov, apart) + log_det))


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
