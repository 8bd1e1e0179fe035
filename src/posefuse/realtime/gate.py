"""What is sent out as a fact: keypoints that are known well enough, and measured lately enough.

A robot that follows a frame is better off when the frame times out than when it flies. What is withheld is missing in every
output alike, and counted.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from posefuse.core import Kind, Pose3D
from posefuse.core.arrays import Array

from .config import KeypointGateSettings

# so far below a limit rounding does not matter
_CLEARLY = 0.99


class KeypointGate:
    """Passes poses on in the order of their times.

    Attributes:
        keypoints, people: how many were there, and how many of them were withheld: (all, withheld). A person is withheld when
            no keypoint is left.
    """

    def __init__(self, rules: KeypointGateSettings) -> None:
        self._rules = rules
        self.keypoints = self.people = (0, 0)
        # by person: when each keypoint was last measured
        self._measured_ns: dict[int, Array] = {}

    def passed(self, pose: Pose3D) -> Pose3D:
        """The pose without what is withheld."""
        if not len(pose.person_id):
            self._measured_ns = {}
            return pose
        there = pose.kind != Kind.MISSING
        good = there & _known_to(pose.cov_world, self._rules.sigma_m) & self._fresh(pose)
        left = good.any(axis=1)
        self.keypoints = _counted(self.keypoints, there, good)
        self.people = _counted(self.people, there.any(axis=1), left)
        if good.all():
            return pose
        return replace(
            pose,
            xyz_world=np.where(good[..., None], pose.xyz_world, np.nan),
            cov_world=np.where(good[..., None, None], pose.cov_world, np.nan),
            reproj_px=np.where(good, pose.reproj_px, np.nan),
            n_views=np.where(good, pose.n_views, 0),
            kind=np.where(good, pose.kind, Kind.MISSING),
        ).people(left)

    def figures(self) -> dict[str, float]:
        """Shares of what was withheld."""
        return {name: cut / of if of else 0.0 for name, (of, cut) in (("keypoints", self.keypoints), ("people", self.people))}

    def _fresh(self, pose: Pose3D) -> Array:
        """(N, K) bool: measured not too long ago."""
        before, now = self._measured_ns, {}
        for person, kind in zip(pose.person_id.tolist(), pose.kind, strict=True):
            # who is new was measured just now
            last = before.get(person, np.full(kind.shape, pose.t_ns))
            now[person] = np.where((kind == Kind.PREDICTED) & (last <= pose.t_ns), last, pose.t_ns)
        self._measured_ns = now
        oldest_ns = pose.t_ns - round(self._rules.unmeasured_s * 1e9)
        measured = np.array([now[person] for person in pose.person_id.tolist()]).reshape(pose.kind.shape)
        return np.asarray(measured >= oldest_ns)


def _known_to(cov: Array, sigma_m: float) -> Array:
    """(...) bool: `worst_sigma_m` of covariances (..., 3, 3) is at most `sigma_m`."""
    # no eigenvalue is larger than the root of the sum of squares: mostly there is none to be computed
    squares = np.einsum("...ij,...ij->...", cov, cov)
    known = np.asarray(squares < (_CLEARLY * sigma_m**2) ** 2)
    if not known.all():
        known[~known] = worst_sigma_m(cov[~known]) <= sigma_m
    return known


def worst_sigma_m(cov: Array) -> Array:
    """(...) standard deviation along the worst known axis of covariances (..., 3, 3); infinite where NaN."""
    known = np.asarray(np.isfinite(cov).all(axis=(-2, -1)))
    variance = np.linalg.eigvalsh(np.where(known[..., None, None], cov, np.eye(3)))[..., -1]
    return np.asarray(np.where(known, np.sqrt(np.maximum(variance, 0.0)), np.inf))


def _counted(before: tuple[int, int], there: Array, good: Array) -> tuple[int, int]:
    count = int(there.sum())
    return before[0] + count, before[1] + count - int((there & good).sum())
