"""Where each person was last, and where they are expected: what association remembers from frame to frame."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from posefuse.core import Kind, Pose3D, Skeleton
from posefuse.core.arrays import Array

# a keypoint keeps its own speed until the next frame: a rendered walk is 13.7 mm off, and 13.9 where only the body's leads to the
# regions of the next images; a person out of sight keeps the body's, which fades: of four rendered people who cross before three
# cameras, 7.1 % are missed, and 8.6 % if it does not
_FADE_S = 0.4
_NEXT_FRAME_S = 0.12
# the body's speed is averaged over this time: without the mean and the bound below, IDF1 of rendered people falls from 0.936 to
# 0.881
_SPEED_S = 0.15
# faster, a frame was wrong: without it four rendered people who cross before three cameras are swapped twice
_FASTEST_M_S = 6.0


def median_known(points: Array) -> Array:
    """(3,) median of the points (K, 3) that are known; NaN where none is. Much faster than `numpy.nanmedian`."""
    known = points[np.isfinite(points[:, 0])]
    return np.asarray(np.median(known, axis=0)) if len(known) else np.full(3, np.nan)


@dataclass(frozen=True, eq=False, kw_only=True)
class LastSeen:
    """One person as last measured.

    Attributes:
        person_id: their id. t_ns: when a view last measured them.
        xyz_world: (K, 3) then; a keypoint that was missing is carried along with the body; NaN if it was never seen.
        velocity_m_s: (K, 3) of each keypoint, 0 where unknown. body_velocity_m_s: (3,) of the whole body, averaged.
    """

    person_id: int
    t_ns: int
    xyz_world: Array
    velocity_m_s: Array
    body_velocity_m_s: Array

    def at(self, t_ns: int) -> Array:
        """(K, 3) where the person is expected: the motion continues with decreasing speed."""
        age_s = max(t_ns - self.t_ns, 0) * 1e-9
        return np.asarray(self.xyz_world + self.body_velocity_m_s * _FADE_S * (1 - np.exp(-age_s / _FADE_S)))

    def moving_at(self, t_ns: int) -> Array:
        """(K, 3) where each keypoint is expected in the next frame, by its own speed; later as `at`.

        One wrong keypoint moves far: good for choosing where to look, too uncertain for identity.
        """
        age_s = max(t_ns - self.t_ns, 0) * 1e-9
        return np.asarray(self.xyz_world + self.velocity_m_s * age_s) if age_s <= _NEXT_FRAME_S else self.at(t_ns)

    def measured(self, t_ns: int, xyz_world: Array) -> LastSeen:
        """The same person after one more measurement (K, 3); NaN where a keypoint is missing."""
        step_s = max(t_ns - self.t_ns, 1) * 1e-9
        known = np.isfinite(xyz_world[:, 0])
        moved = (xyz_world - self.xyz_world) / step_s
        middle = median_known(moved)
        body = middle if np.isfinite(middle).all() else self.body_velocity_m_s
        body = body * min(1.0, _FASTEST_M_S / max(float(np.linalg.norm(body)), 1e-9))
        weight = 1 - np.exp(-step_s / _SPEED_S)
        return LastSeen(
            person_id=self.person_id,
            t_ns=t_ns,
            xyz_world=np.where(known[:, None], xyz_world, self.at(t_ns)),
            velocity_m_s=np.nan_to_num(moved),
            body_velocity_m_s=self.body_velocity_m_s + weight * (body - self.body_velocity_m_s),
        )

    @staticmethod
    def first(person_id: int, t_ns: int, xyz_world: Array) -> LastSeen:
        """A person seen for the first time (K, 3)."""
        return LastSeen(
            person_id=person_id,
            t_ns=t_ns,
            xyz_world=np.array(xyz_world),
            velocity_m_s=np.zeros(xyz_world.shape),
            body_velocity_m_s=np.zeros(3),
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class Memory:
    """The people of the last `lost_after_s`. A value: `after` gives the next one.

    Attributes:
        skeleton: names axis K. people: by id.
    """

    skeleton: Skeleton
    people: tuple[LastSeen, ...] = ()

    @property
    def seen_ns(self) -> Array:
        """(N,) when each of them was last measured."""
        return np.array([one.t_ns for one in self.people], np.int64)

    def expected(self, t_ns: int) -> Pose3D:
        """Where the people are expected at this time, in the order of `people`; kind PREDICTED."""
        return self._pose(t_ns, np.array([one.at(t_ns) for one in self.people]))

    def looked_for(self, t_ns: int) -> Pose3D:
        """As `expected`, each keypoint by its own speed: the people whom the views should look for."""
        return self._pose(t_ns, np.array([one.moving_at(t_ns) for one in self.people]))

    def last(self, t_ns: int) -> Pose3D:
        """Where they were last; the time is `t_ns`."""
        return self._pose(t_ns, np.array([one.xyz_world for one in self.people]))

    def after(self, pose: Pose3D, lost_after_s: float) -> Memory:
        """With the people measured in `pose`, without those out of sight for longer than `lost_after_s`."""
        people = {one.person_id: one for one in self.people if (pose.t_ns - one.t_ns) * 1e-9 <= lost_after_s}
        for person, xyz in zip(pose.person_id.tolist(), pose.xyz_world, strict=True):
            if np.isfinite(xyz[:, 0]).any():
                before = people.get(person)
                people[person] = before.measured(pose.t_ns, xyz) if before else LastSeen.first(person, pose.t_ns, xyz)
        return replace(self, people=tuple(people[person] for person in sorted(people)))

    def _pose(self, t_ns: int, xyz_world: Array) -> Pose3D:
        n, k = len(self.people), len(self.skeleton)
        xyz = xyz_world.reshape(n, k, 3)
        kind = np.where(np.isfinite(xyz[..., 0]), Kind.PREDICTED, Kind.MISSING)
        ids = np.array([one.person_id for one in self.people], np.int64)
        unknown = np.full((n, k), np.nan)
        return Pose3D(
            t_ns=t_ns,
            skeleton=self.skeleton,
            person_id=ids,
            xyz_world=xyz,
            cov_world=np.full((n, k, 3, 3), np.nan),
            reproj_px=unknown,
            n_views=np.zeros((n, k)),
            kind=kind,
        )
