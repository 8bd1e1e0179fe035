"""One tracked person: views in the order of their own times, and the state after each of them."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from posefuse.core import ConfigError, Kind, Pose3D, Rig, Skeleton
from posefuse.core.arrays import Array

from .own_motion import OwnMotion
from .settings import LiveSettings

_ARMS = ("shoulder", "elbow", "wrist", "pinky", "index", "thumb")
_LEGS = ("hip", "knee", "ankle", "heel", "foot_index", "big_toe", "small_toe")
# what a newborn's keypoint may do, one standard deviation
_BORN_M_S = 1.5
# in a count of cameras, the depth of one
_DEPTH_OF = 1 << 16


@dataclass(frozen=True, eq=False)
class Model:
    """Everything about a session the kernels read, packed once."""

    rig: Rig
    skeleton: Skeleton
    settings: LiveSettings

    def __post_init__(self) -> None:
        own, body = len(self.settings.motion_models), len(self.settings.body_models)
        if own != body:
            raise ConfigError(f"track.body_models: expected {own}, as many as track.motion_models, got {body}")

    @cached_property
    def sizes(self) -> tuple[int, int, int, int]:
        """Keypoints, motion models, cameras, bones."""
        return len(self.skeleton), len(self.settings.motion_models), len(self.rig), len(self.ends)

    @cached_property
    def cameras(self) -> Array:
        """(C, 15): rotation, translation, centre."""
        return np.stack(
            [np.concatenate([c.cam_from_world.matrix().ravel(), c.cam_from_world.xyz, c.centre_world]) for c in self.rig]
        )

    @cached_property
    def models(self) -> Array:
        """(2, M, 2): acceleration, and how long it lasts; of keypoints, and of the body."""
        banks = (self.settings.motion_models, self.settings.body_models)
        return np.array([[[one.acceleration_m_s2, one.persistence_s] for one in bank] for bank in banks])

    @cached_property
    def mirror(self) -> Array:
        """(K,) counterparts."""
        return np.asarray(self.skeleton.mirror, np.int64)

    @cached_property
    def group(self) -> Array:
        """(K,) what is exchanged together: arms 0, legs 1, head 2; -1 on the midline."""
        groups = np.full(len(self.skeleton), -1, np.int64)
        for i, name in enumerate(self.skeleton.keypoints):
            if self.mirror[i] != i:
                part = name.split("_", 1)[1]
                groups[i] = 0 if part in _ARMS else 1 if part in _LEGS else 2
        return groups

    @property
    def groups(self) -> int:
        """How many groups there are."""
        from . import kernels

        return kernels.GROUPS

    @cached_property
    def ends(self) -> Array:
        """(B, 2) bones."""
        return np.asarray(self.skeleton.bone_indices, np.int64)

    @cached_property
    def neighbours(self) -> Array:
        """(K, n) keypoints at the other ends of each one's bones, -1 for none."""
        lists: list[list[int]] = [[] for _ in self.skeleton.keypoints]
        for a, b in self.ends:
            lists[a].append(int(b))
            lists[b].append(int(a))
        most = max(1, *(len(one) for one in lists))
        return np.array([one + [-1] * (most - len(one)) for one in lists], np.int64)

    @cached_property
    def step_rules(self) -> Array:
        """As `kernels.step` wants them."""
        s = self.settings
        return np.array([s.outlier_chi2, s.gate_chi2, s.switch_s, s.lost_after_s, s.new_share, s.alone_hold_s])

    @cached_property
    def pose_rules(self) -> Array:
        """As `kernels.pose` wants them."""
        s = self.settings
        kinds = [float(Kind.FUSED), float(Kind.PREDICTED)]
        return np.array([s.measured_s, s.lost_after_s, s.lasting_share, s.averaging, s.bone_sigma_m, *kinds])


@dataclass(frozen=True, eq=False, kw_only=True)
class View:
    """One camera's keypoints of this person: z, sigma_px, depth_m (K, ...) and so on as in `optics.Rays`."""

    t_ns: int
    camera: int
    z: Array
    white: Array
    late_s: Array
    sigma_px: Array
    depth_m: Array | None = None


@dataclass(eq=False)
class _Moment:
    """What was known just after a view; the first has none: it is where memory begins."""

    t_ns: int
    camera: int
    view: View | None
    state: Array


class Person:
    """A person from the first view on. For a late view, the state before it is restored and later views are applied again."""

    def __init__(self, model: Model, person_id: int, t_ns: int, xyz: Array, cov: Array) -> None:
        from . import kernels

        self.id = person_id
        self.speed_m_s = 0.0
        self._model, self._birth_ns = model, t_ns
        # by camera; those of the birth are not distinguished
        self._measured_by_ns = {-2: t_ns, -1: t_ns}
        state = np.empty(kernels.state_size(*model.sizes))
        kernels.born(state, *model.sizes, xyz, cov, _BORN_M_S, model.models)
        self._moments = [_Moment(t_ns, -1, None, state)]
        self._figures = np.empty(kernels.FIGURES)
        self._own_motion = OwnMotion(model.skeleton, model.sizes, model.models)

    def add(self, view: View) -> Array | None:
        """Work a view in at its own time; its figures (`kernels.FIGURES`), or None when it is older than memory."""
        if view.t_ns < self._moments[0].t_ns:
            return None
        place = bisect_right(self._moments, (view.t_ns, view.camera), key=lambda m: (m.t_ns, m.camera))
        self._moments.insert(place, _Moment(view.t_ns, view.camera, view, np.empty_like(self._moments[0].state)))
        figures = newest = self._redone(place)
        for later in range(place + 1, len(self._moments)):
            newest = self._redone(later)
        self.speed_m_s = float(newest[4])
        if figures[0] > figures[1]:
            self._measured_by_ns[view.camera] = max(view.t_ns, self._measured_by_ns.get(view.camera, view.t_ns))
        if figures[5] > 0:
            # depth gives the distance of the person, as a second camera does
            self._measured_by_ns[_DEPTH_OF + view.camera] = self._measured_by_ns.get(view.camera, view.t_ns)
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
        self._own_motion.settle(settled.state, settled.t_ns)

    def begin_again(self, xyz: Array) -> None:
        """Put keypoints at world places (K, 3) in every kept state, as late views start from older ones; NaN: unchanged."""
        from . import kernels

        for moment in self._moments:
            kernels.begin_again(moment.state, self._model.sizes, xyz)
        if np.isfinite(xyz).any():
            self._own_motion.begin_again()

    def exchange(self, groups: Array) -> None:
        """Exchange left and right of limbs (`kernels.GROUPS`,), see `Model.group`, in every kept state."""
        from . import kernels

        for moment in self._moments:
            kernels.exchange_groups(moment.state, self._model.sizes, self._model.mirror, self._model.group, groups)
        if groups.any():
            self._own_motion.begin_again()

    @property
    def measured_ns(self) -> int:
        """When a view last measured the person."""
        return max(self._measured_by_ns.values())

    @property
    def crossed_ns(self) -> int:
        """Until when two cameras, or one with depth, measured the person; since then one alone, whose rays fit any depth."""
        return sorted(self._measured_by_ns.values())[-2]

    def expected(self, t_ns: int) -> tuple[Array, Array]:
        """Positions (K, 3) and how sure (K,) at a time, from what came before it."""
        from . import kernels

        model = self._model
        means, sigmas = np.empty((model.sizes[0], 3)), np.empty(model.sizes[0])
        state = self._before(t_ns).state
        kernels.where(state, self._seconds(t_ns), model.sizes, model.models, means, sigmas)
        return means, sigmas

    def pose_into(self, t_ns: int, out: Pose3DArrays, row: int) -> bool:
        """Fill row `row` with the pose at t_ns; whether any keypoint of the person is there."""
        from . import kernels

        if t_ns < self._moments[0].t_ns:
            return False
        model = self._model
        before = self._before(t_ns)
        kernels.pose(
            before.state, self._seconds(t_ns), model.cameras, model.ends, model.sizes, model.models,
            model.pose_rules, out.xyz[row], out.cov[row], out.reproj[row], out.n_views[row], out.kind[row],
        )  # fmt: skip
        correction = self._own_motion.correction(before.state, (t_ns - before.t_ns) * 1e-9)
        if correction is not None:
            out.xyz[row] += correction
        return bool(out.kind[row].any())

    def _redone(self, place: int) -> Array:
        from . import kernels

        model, now = self._model, self._moments[place]
        view = now.view
        assert view is not None
        kernels.step(
            self._moments[place - 1].state, now.state, self._seconds(now.t_ns), view.camera, view.z, view.white, view.late_s,
            view.sigma_px, model.cameras, model.mirror, model.group, model.neighbours, model.ends, model.sizes, model.models,
            model.step_rules, self._figures, view.depth_m,
        )  # fmt: skip
        return self._figures.copy()

    def _before(self, t_ns: int) -> _Moment:
        return self._moments[max(0, bisect_right(self._moments, t_ns, key=lambda m: m.t_ns) - 1)]

    def _seconds(self, t_ns: int) -> float:
        return (t_ns - self._birth_ns) * 1e-9


class Pose3DArrays:
    """Room for the pose of up to n people."""

    def __init__(self, n: int, k: int) -> None:
        self.xyz, self.cov, self.reproj = np.empty((n, k, 3)), np.empty((n, k, 3, 3)), np.empty((n, k))
        self.n_views, self.kind = np.zeros((n, k), np.uint8), np.zeros((n, k), np.uint8)

    def pose(self, t_ns: int, skeleton: Skeleton, ids: list[int]) -> Pose3D:
        """The first rows, one per id, as a value."""
        n = len(ids)
        return Pose3D(
            t_ns=t_ns,
            skeleton=skeleton,
            person_id=np.array(ids, np.int64),
            xyz_world=self.xyz[:n],
            cov_world=self.cov[:n],
            reproj_px=self.reproj[:n],
            n_views=self.n_views[:n],
            kind=self.kind[:n],
        )
