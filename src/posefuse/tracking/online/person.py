"""One tracked person: views in the order of their own times, the state after each of them, and what it rests on."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from posefuse.core import Kind, Rig, Skeleton
from posefuse.core.arrays import Array
from posefuse.core.rig import packed_rig
from posefuse.tracking.settings import MOTION, LiveMotion, LiveSettings

from .kernels.pose import PoseRow, pose, where
from .kernels.state import GROUPS, KeypointRays, Rules, SessionArrays, TrackState, born, unborn
from .kernels.step import ViewFigures, step
from .kernels.updates import begin_again
from .own_motion import HORIZON_S, OwnMotion

# a view's limb is swapped as a whole where that brings it so much closer
_CLEARLY = 0.5
# what a newborn's keypoint may do, one standard deviation
_BORN_M_S = 1.5
# in a count of cameras, the depth of one
_DEPTH_OF = 1 << 16
# over which motion is measured that moves a keypoint between the rows of an image
_ROW_NS = 5_000_000
# of keypoints that were measured, and of those that are only predicted
_KINDS = (int(Kind.FUSED), int(Kind.PREDICTED))


@dataclass(frozen=True, eq=False)
class Model:
    """Everything about a session the kernels read, packed once."""

    rig: Rig
    skeleton: Skeleton
    settings: LiveSettings
    motion: LiveMotion = MOTION

    @cached_property
    def arrays(self) -> SessionArrays:
        """As the kernels read them."""
        values = {**vars(self.motion), "lost_after_s": self.settings.lost_after_s}
        banks = (self.motion.keypoints, self.motion.body)
        return SessionArrays(
            cameras=packed_rig(self.rig),
            mirror=self.skeleton.mirror,
            group=_groups(self.skeleton),
            ends=self.skeleton.bone_indices,
            models=np.array([[[one.acceleration_m_s2, one.persistence_s] for one in bank] for bank in banks]),
            rules=Rules(*(float(values[name]) for name in Rules._fields)),
        )

    @cached_property
    def limbs(self) -> Array:
        """(GROUPS, K) of which limbs each keypoint is."""
        return np.asarray(self.arrays.group == np.arange(GROUPS)[:, None])

    def swapped(self, other: Array, same: Array) -> Array:
        """(K,) keypoints of limbs whose distances (K,) with left and right swapped are clearly less than those as they are.

        Arms, legs and head each as a whole: a pair of elbows alone is never swapped.
        """
        known = self.limbs & np.isfinite(other) & np.isfinite(same)
        limbs = [other[one].sum() < _CLEARLY * same[one].sum() for one in known]
        return np.asarray(self.limbs[limbs].any(axis=0))


def named_rays(rays: KeypointRays, world: Array, model: Model) -> tuple[Array, Array]:
    """Ideal points (K, 2) of a view, left and right as in a person at (K, 3), and 1 / variance (K,); NaN and 0 where unseen."""
    camera, mirror = model.rig.cameras[rays.camera].cam_from_world, model.arrays.mirror
    there = camera @ world
    expected = there[:, :2] / there[:, 2:]
    same, other = (np.linalg.norm(z - expected, axis=-1) for z in (rays.z, rays.z[mirror]))
    swapped = model.swapped(other, same)
    source = np.where(swapped, mirror, np.arange(len(mirror)))
    z = rays.z[source]
    return z, np.where(np.isfinite(z[:, 0]), 0.5 * (rays.white[source] ** 2).sum(axis=(-1, -2)), 0.0)


def _groups(skeleton: Skeleton) -> Array:
    """(K,) what is swapped together: arms 0, legs 1, head 2; -1 on the midline."""
    groups = np.full(len(skeleton), 2, np.int64)
    for number, sides in enumerate(skeleton.limbs):
        groups[np.concatenate(sides)] = number
    groups[skeleton.mirror == np.arange(len(skeleton))] = -1
    return groups


@dataclass(eq=False, kw_only=True)
class _Moment:
    """A view, rays and depth_m (K, 2) as of `rays_of`, and what was known just after it.

    The first has no view: it is where memory begins.
    """

    t_ns: int
    camera: int
    state: TrackState
    rays: KeypointRays | None = None
    depth_m: Array | None = None


# older views show where the person was
_NEWEST_NS = 150_000_000


@dataclass(frozen=True, eq=False, kw_only=True)
class Evidence:
    """Rays of one person, of the newest view of each camera (V).

    Attributes:
        camera: (V,) places in the rig, ascending.
        z: (V, K, 2) ideal image points, left and right as in the person; NaN where there is none or the cross-check found
            the camera wrong.
        inverse_var: (V, K) 1 / variance of these, 0 where there is none.
        then_world: (V, K, 3) where the tracker has the keypoints at the times of these rays; NaN where it does not.
    """

    camera: Array
    z: Array
    inverse_var: Array
    then_world: Array


class Person:
    """A person from the first view on. For a late view, the state before it is restored and later views are applied again."""

    def __init__(self, model: Model, person_id: int, t_ns: int, xyz: Array, cov: Array) -> None:
        self.id = person_id
        self.speed_m_s = 0.0
        self._model, self._birth_ns = model, t_ns
        # by camera; those of the birth are not distinguished
        self._measured_by_ns = {-2: t_ns, -1: t_ns}
        state = unborn(model.arrays)
        born(state, model.arrays, xyz, cov, _BORN_M_S)
        self._moments = [_Moment(t_ns=t_ns, camera=-1, state=state)]
        self._own_motion = OwnMotion(model.skeleton)

    def add(self, t_ns: int, rays: KeypointRays, depth_m: Array | None = None) -> ViewFigures | None:
        """Work a view in at its own time, see `rays_of`; its figures, or None when it is older than memory."""
        if t_ns < self._moments[0].t_ns:
            return None
        camera = rays.camera
        place = bisect_right(self._moments, (t_ns, camera), key=lambda m: (m.t_ns, m.camera))
        before = self._moments[place - 1].state
        self._moments.insert(place, _Moment(t_ns=t_ns, camera=camera, state=before, rays=rays, depth_m=depth_m))
        figures = newest = self._redone(place)
        for later in range(place + 1, len(self._moments)):
            newest = self._redone(later)
        self.speed_m_s = newest.speed_m_s
        if figures.measured > figures.gated:
            self._measured_by_ns[camera] = max(t_ns, self._measured_by_ns.get(camera, t_ns))
        if figures.depths > 0:
            # depth gives the distance of the person, as a second camera does
            self._measured_by_ns[_DEPTH_OF + camera] = self._measured_by_ns.get(camera, t_ns)
        return figures

    def forget(self, before_ns: int) -> None:
        """Views older than this will not come any more."""
        keep = 0
        while keep + 1 < len(self._moments) and self._moments[keep + 1].t_ns <= before_ns:
            keep += 1
            self._learn(self._moments[keep])
        del self._moments[:keep]

    def _learn(self, settled: _Moment) -> None:
        """From a moment that nothing changes any more; those up to it are kept."""
        while (due_ns := self._own_motion.waits_until_ns()) is not None and due_ns <= settled.t_ns:
            self._own_motion.judge(self.expected(due_ns)[0])
        if self._own_motion.wants(settled.t_ns):
            self._own_motion.settle(settled.t_ns, *self._now_and_later(settled.state))

    def begin_again(self, xyz: Array) -> None:
        """Put keypoints at world places (K, 3) in every kept state, as late views start from older ones; NaN: unchanged."""
        for moment in self._moments:
            begin_again(moment.state, xyz)
        if np.isfinite(xyz).any():
            self._own_motion.begin_again()

    @property
    def measured_ns(self) -> int:
        """When a view last measured the person."""
        return max(self._measured_by_ns.values())

    @property
    def crossed_ns(self) -> int:
        """Until when two cameras, or one with depth, measured the person; since then one alone, whose rays fit any depth."""
        return sorted(self._measured_by_ns.values())[-2]

    def evidence(self, t_ns: int) -> Evidence:
        """Of views not older than 150 ms at `t_ns`, which the order of arrival does not change."""
        newest = {one.camera: one for one in self._moments if t_ns - _NEWEST_NS <= one.t_ns <= t_ns and one.rays is not None}
        views, k = [newest[camera] for camera in sorted(newest)], len(self._model.skeleton)
        z, inverse_var, then = np.empty((len(views), k, 2)), np.empty((len(views), k)), np.empty((len(views), k, 3))
        for v, view in enumerate(views):
            assert view.rays is not None
            then[v] = self._when_exposed(view.t_ns, view.rays.late_s)
            z[v], inverse_var[v] = named_rays(view.rays, then[v], self._model)
        return Evidence(
            camera=np.array([view.camera for view in views], np.intp),
            z=z,
            inverse_var=inverse_var,
            then_world=then,
        )

    def _when_exposed(self, t_ns: int, late_s: Array) -> Array:
        """(K, 3) where keypoints were when their rows were exposed, so long (K,) after the middle of the exposure."""
        then = self.expected(t_ns)[0]
        if not late_s.any():
            return then
        later = self.expected(t_ns + _ROW_NS)[0]
        return then + (later - then) * (late_s / (_ROW_NS * 1e-9))[:, None]

    def expected(self, t_ns: int) -> tuple[Array, Array]:
        """Positions (K, 3) and how sure (K,) at a time, from what came before it."""
        return self._expected_from(self._before(t_ns).state, self._seconds(t_ns))

    def pose_into(self, t_ns: int, filled: PoseRow) -> bool:
        """Fill in the pose at t_ns; whether any keypoint of the person is there."""
        if t_ns < self._moments[0].t_ns:
            return False
        before = self._before(t_ns)
        pose(before.state, self._seconds(t_ns), self._model.arrays, _KINDS, filled)
        if t_ns > before.t_ns:
            since_s = (t_ns - before.t_ns) * 1e-9
            filled.xyz[:] += self._own_motion.correction(*self._now_and_later(before.state), since_s)
        return bool(filled.kind.any())

    def _expected_from(self, state: TrackState, t_s: float) -> tuple[Array, Array]:
        k = len(self._model.skeleton)
        means, sigmas = np.empty((k, 3)), np.empty(k)
        where(state, t_s, self._model.arrays, means, sigmas)
        return means, sigmas

    def _now_and_later(self, state: TrackState) -> tuple[Array, Array]:
        now_s = float(state.time[0])
        return self._expected_from(state, now_s)[0], self._expected_from(state, now_s + HORIZON_S)[0]

    def _redone(self, place: int) -> ViewFigures:
        now = self._moments[place]
        now.state = self._moments[place - 1].state.copy()
        figures: ViewFigures = step(now.state, self._seconds(now.t_ns), now.rays, self._model.arrays, now.depth_m)
        return figures

    def _before(self, t_ns: int) -> _Moment:
        return self._moments[max(0, bisect_right(self._moments, t_ns, key=lambda m: m.t_ns) - 1)]

    def _seconds(self, t_ns: int) -> float:
        return (t_ns - self._birth_ns) * 1e-9
