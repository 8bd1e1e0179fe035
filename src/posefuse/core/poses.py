"""3D poses of one time step and of a recording. Axes as in `values`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np
from numpy.typing import DTypeLike

from .arrays import Array, FrozenArrays, frozen_fields, give_away, taken
from .errors import InputError, ShapeError
from .skeleton import Skeleton
from .values import check_keypoints


class Kind(IntEnum):
    """How a 3D keypoint came about."""

    MISSING = 0
    FUSED = 1  # from the views of this time step alone
    SMOOTHED = 2  # from views of this and neighbouring time steps
    INTERPOLATED = 3  # inside a gap, from both sides of it
    PREDICTED = 4  # ahead of the newest measurement


@dataclass(frozen=True, eq=False, kw_only=True)
class Pose3D(FrozenArrays):
    """People in 3D at one time step.

    Attributes:
        t_ns: session clock.
        person_id: (N,) int64.
        xyz_world: (N, K, 3) metres; NaN where missing.
        cov_world: (N, K, 3, 3) square metres; NaN where missing.
        reproj_px: (N, K) rms distance of the used views' raw pixels to the reprojection.
        n_views: (N, K) uint8 views used.
        kind: (N, K) uint8 of `Kind`.
    """

    t_ns: int
    skeleton: Skeleton
    person_id: Array
    xyz_world: Array
    cov_world: Array
    reproj_px: Array
    n_views: Array
    kind: Array

    def __post_init__(self) -> None:
        check_keypoints(self, frozen_fields(self, _POSE_AXES, _POSE_DTYPES))

    def __repr__(self) -> str:
        return f"Pose3D(at {self.t_ns} ns, people (ids) {self.person_id.tolist()}, {self.skeleton})"

    @staticmethod
    def empty(t_ns: int, skeleton: Skeleton) -> Pose3D:
        """No person at this time."""
        sizes = {"N": 0, "K": len(skeleton), "3": 3}
        arrays = {name: np.zeros([sizes[axis] for axis in axes.split()]) for name, axes in _POSE_AXES.items()}
        return Pose3D(t_ns=t_ns, skeleton=skeleton, **arrays)

    def people(self, which: Array) -> Pose3D:
        """These people only: `which` is (N,) bool, or their places on axis N in the order wanted."""
        return replace(self, **taken(self, _POSE_AXES, which))


def point_sigma_m(cov: Array) -> Array:
    """(...) standard deviation along one axis of points with covariance (..., 3, 3): root of the mean variance."""
    return np.asarray(np.sqrt(np.trace(cov, axis1=-2, axis2=-1) / 3))


def worst_sigma_m(cov: Array) -> Array:
    """(...) standard deviation along the worst known axis of covariances (..., 3, 3); infinite where NaN."""
    known = np.asarray(np.isfinite(cov).all(axis=(-2, -1)))
    variance = np.linalg.eigvalsh(np.where(known[..., None, None], cov, np.eye(3)))[..., -1]
    return np.asarray(np.where(known, np.sqrt(np.maximum(variance, 0.0)), np.inf))


_POSE_DTYPES: dict[str, DTypeLike] = {"n_views": np.uint8, "kind": np.uint8}
_POSE_AXES = {
    "person_id": "N",
    "xyz_world": "N K 3",
    "cov_world": "N K 3 3",
    "reproj_px": "N K",
    "n_views": "N K",
    "kind": "N K",
}
# those that change with time
_PLANES = tuple(name for name in _POSE_AXES if name != "person_id")


@dataclass(frozen=True, eq=False, kw_only=True)
class PoseSequence(FrozenArrays):
    """People in 3D over time: `Pose3D` with an axis T in front, person_id excepted.

    Attributes:
        t_ns: (T,) int64, strictly increasing.
        person_id: (N,).
        xyz_world: (T, N, K, 3).
        cov_world: (T, N, K, 3, 3).
        reproj_px: (T, N, K).
        n_views: (T, N, K).
        kind: (T, N, K).
    """

    t_ns: Array
    skeleton: Skeleton
    person_id: Array
    xyz_world: Array
    cov_world: Array
    reproj_px: Array
    n_views: Array
    kind: Array

    def __post_init__(self) -> None:
        axes = {name: text if name == "person_id" else f"T {text}" for name, text in _POSE_AXES.items()}
        check_keypoints(self, frozen_fields(self, {"t_ns": "T"} | axes, _POSE_DTYPES))
        if (np.diff(self.t_ns) <= 0).any():
            raise ShapeError("PoseSequence.t_ns: expected strictly increasing times")

    def __repr__(self) -> str:
        return f"PoseSequence({len(self)} time steps, people (ids) {self.person_id.tolist()}, {self.skeleton})"

    def __len__(self) -> int:
        return len(self.t_ns)

    def at(self, i: int) -> Pose3D:
        """The time step at place i of axis T."""
        arrays = taken(self, _PLANES, i)
        return Pose3D(t_ns=int(self.t_ns[i]), skeleton=self.skeleton, person_id=self.person_id, **arrays)

    def part(self, steps: slice) -> PoseSequence:
        """These time steps only."""
        return replace(self, **taken(self, ("t_ns", *_PLANES), steps))

    def people(self, which: Array | slice) -> PoseSequence:
        """These people only: `which` is (N,) bool, or their places on axis N in the order wanted."""
        return replace(self, person_id=self.person_id[which], **taken(self, _PLANES, (slice(None), which)))

    @staticmethod
    def from_poses(poses: Sequence[Pose3D]) -> PoseSequence:
        """Stack poses of increasing times; a person is missing (NaN) in the poses without that person.

        People are in the order of the poses where that is one, else in that of their ids.

        Raises:
            ShapeError: no pose, another skeleton, or times that do not increase.
        """
        if not poses:
            raise ShapeError("PoseSequence: expected at least 1 pose, got 0")
        skeleton = poses[0].skeleton
        if any(pose.skeleton != skeleton for pose in poses):
            raise ShapeError("PoseSequence: expected the same skeleton in every pose")
        ids = poses[0].person_id
        if not all(np.array_equal(pose.person_id, ids) for pose in poses):
            ids = np.unique(np.concatenate([pose.person_id for pose in poses]))
        place = {person: n for n, person in enumerate(ids.tolist())}
        written = WrittenPoses(np.array([pose.t_ns for pose in poses]), skeleton, ids)
        for i, pose in enumerate(poses):
            written.write(i, pose, [place[person] for person in pose.person_id.tolist()])
        return written.sequence()


# the files have a rate and no times: time steps this far off it (in periods) would be moved silently
_UNEVEN_PERIODS = 0.05
# so many times as many: a clock that was set, or a machine that slept, would make a day of empty steps
_MOST_SKIPPED = 10


def evenly_spaced(poses: PoseSequence) -> PoseSequence:
    """The same with a time step without people for each one that a live session skipped, for files that hold no times.

    Raises:
        InputError: other times that are not evenly spaced.
    """
    if len(poses) < 2:
        return poses
    apart_ns = np.diff(poses.t_ns)
    period_ns = float(np.median(apart_ns))
    at = (poses.t_ns - poses.t_ns[0]) / period_ns
    step = np.rint(at).astype(int)
    if np.abs(at - step).max() > max(_UNEVEN_PERIODS, 1e-6 * len(poses)) or step[-1] > _MOST_SKIPPED * len(poses):
        raise InputError(
            f"C3D, BVH and glTF hold evenly spaced time steps only; these are {apart_ns.min() * 1e-9:.4g} to "
            f"{apart_ns.max() * 1e-9:.4g} s apart: set rate_hz (of a live session: `posefuse solve FILE.mcap` makes even ones)"
        )
    if step[-1] < len(poses):
        return poses
    t_ns = poses.t_ns[0] + np.rint(np.arange(step[-1] + 1) * period_ns).astype(np.int64)
    t_ns[step] = poses.t_ns
    written = WrittenPoses(t_ns, poses.skeleton, poses.person_id)
    written.write(slice(None), poses.part(slice(1)).people(slice(0)), [])
    written.write(step, poses)
    return written.sequence()


class WrittenPoses:
    """Room for the poses of people (N,) at times (T,); each time step must be written."""

    def __init__(self, t_ns: Array, skeleton: Skeleton, person_id: Array) -> None:
        self._t_ns, self._skeleton, self._person_id = t_ns, skeleton, person_id
        sizes = {"N": len(person_id), "K": len(skeleton), "3": 3}
        # memory that is not written yet takes no room: of an hour it is much
        self._planes = {
            name: np.empty((len(t_ns), *(sizes[axis] for axis in _POSE_AXES[name].split())), _POSE_DTYPES.get(name, np.float64))
            for name in _PLANES
        }

    def write(self, steps: int | slice | Array, poses: Pose3D | PoseSequence, people: list[int] | None = None) -> None:
        """Poses at a time step or several: of everybody, or of people at these places on axis N; the others are missing."""
        for name, plane in self._planes.items():
            if people is None:
                plane[steps] = getattr(poses, name)
            else:
                plane[steps] = Kind.MISSING if plane.dtype == np.uint8 else np.nan
                plane[steps, people] = getattr(poses, name)

    def sequence(self) -> PoseSequence:
        """All that was written; nothing can be written any more."""
        give_away(*self._planes.values())
        return PoseSequence(t_ns=self._t_ns, skeleton=self._skeleton, person_id=self._person_id, **self._planes)
