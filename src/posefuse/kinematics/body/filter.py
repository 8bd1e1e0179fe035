"""The causal filter of one body, and the smoother that runs back over its history."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from posefuse.core.arrays import Array
from posefuse.core.skeleton import SIDES
from posefuse.kinematics import kernels
from posefuse.kinematics.definitions import POINTS, SEGMENT_NAMES
from posefuse.kinematics.joints import FrameBuffers
from posefuse.kinematics.settings import BodySettings

from . import fit_kernels, tree_kernels
from .model import HABIT_S, NODE_SEGMENT, SLACK_S, BodyModel, landmark_rows, tree_from_body

# A first state of a body, straight from where its keypoints are.

# the joint to which a limb is attached -> the one at which its first segment ends
_FIRST_SEGMENTS = (("shoulder", "elbow"), ("hip", "knee"))
_LIMBS = {f"{side}_{upper}": f"{side}_{lower}" for side in SIDES for upper, lower in _FIRST_SEGMENTS}


def guessed_state(body: BodyModel, tree: tree_kernels.Tree, workspace: FrameBuffers, xyz: Array) -> tuple[Array, Array] | None:
    """State (nodes,), (nodes, 3, 3) of a body whose keypoints (A, 3) are at these places; None without a pelvis.

    Joint angles come from the segment frames of the points. A straight limb has no frame: its first segment then points along
    the limb, turned from its parent by the smallest angle, and its hinge is straight.
    """
    points = np.full((len(body.skeleton), 3), np.nan)
    points[body.keypoint] = xyz
    rotation = workspace.frames_alone(points)
    if np.isnan(rotation[SEGMENT_NAMES.index("pelvis")]).any():
        return None
    hips = [body.skeleton.index(f"{side}_hip") for side in SIDES]
    q, rot = np.zeros(len(body.nodes)), np.tile(np.eye(3), (len(body.nodes), 1, 1))
    q[:3] = points[hips].mean(axis=0)
    frame, origin = np.empty_like(rot), np.empty((len(rot), 3))
    for n, node in enumerate(body.nodes):
        tree_kernels.forward_kinematics(tree, q, rot, frame, origin)
        segment = NODE_SEGMENT.get(node.name)
        if segment is None:
            continue
        world = rotation[SEGMENT_NAMES.index(segment)]
        if not np.isnan(world).any():
            relative = frame[n].T @ world
            if node.kind == tree_kernels.BALL:
                rot[n] = relative
            elif node.axis == 2:
                q[n] = np.arctan2(-relative[0, 1], relative[1, 1])
        elif _LIMBS.get(node.name) in body.skeleton.keypoints:
            along = points[body.skeleton.index(_LIMBS[node.name])] - points[body.skeleton.index(node.name)]
            if np.isfinite(along).all() and along.any():
                rot[n] = _shortest(np.array([0.0, -1.0, 0.0]), frame[n].T @ along / np.linalg.norm(along))
    return q, rot


def _shortest(one: Array, other: Array) -> Array:
    """Rotation (3, 3) by the smallest angle that takes one unit vector to another; about X where they are opposite."""
    axis, cosine = np.cross(one, other), float(one @ other)
    sine = float(np.linalg.norm(axis))
    if sine < 1e-9:
        return np.eye(3) if cosine > 0 else np.diag([1.0, -1.0, -1.0])
    return np.asarray(tree_kernels.exp3(axis / sine * np.arctan2(sine, cosine)))


_LOST_S = 1.0
# after this time without a measurement a velocity has fallen to 1/e
_VELOCITY_MEMORY_S = 0.3
# Gauss-Newton steps at most: of the first time step, and of each one after it
_FIRST_ITERATIONS, _ITERATIONS = 30, 6
_FIRST_SD = 1.0
_SPEED_SD = 3.0
# the smoother runs back over so many steps at a time, from so much later; a test compares that with the whole recording at once
_BLOCK_STEPS, _LOOK_AHEAD_S = 300, 3.0


@dataclass(frozen=True, eq=False, kw_only=True)
class Measurement:
    """What was seen of one body's keypoints (axis A as in `BodyModel.keypoint`) at one time step.

    Attributes:
        t_ns: session clock.
        xyz, cov: (A, 3), (A, 3, 3) world points to start from and, if `by_rays` is off, to fit; NaN where missing.
        projections, xy, inverse_var: (C, 3, 4), (A, C, 2), (A, C) undistorted pixels and 1 / sigma^2, 0 where unseen.
        standing: (A, 3) where keypoints of feet stand on the floor, NaN where they do not; counts together with rays.
        standing_cov: (A, 3, 3) of the error of these places.
    """

    t_ns: int
    xyz: Array
    cov: Array
    projections: Array
    xy: Array
    inverse_var: Array
    standing: Array | None = None
    standing_cov: Array | None = None


def of_points(t_ns: int, xyz: Array, cov: Array) -> Measurement:
    """3D points (A, 3) weighted by their covariance (A, 3, 3), without any ray."""
    empty = np.zeros((len(xyz), 0))
    return Measurement(
        t_ns=t_ns, xyz=xyz, cov=cov, projections=np.zeros((0, 3, 4)), xy=empty[..., None] + [0, 0], inverse_var=empty
    )


@dataclass(frozen=True, eq=False)
class State:
    """A body at one time step: `q`, `rot`, `velocity` (D,) and `cov` (2D, 2D), see `kernels`."""

    q: Array
    rot: Array
    velocity: Array
    cov: Array


class _Arm(NamedTuple):
    """Nodes of an arm, and landmarks (3,) of shoulder, elbow and wrist among the body's keypoints."""

    upper: int
    carrying: int
    elbow: int
    pronation: int
    points: tuple[int, int, int]


@dataclass(frozen=True, eq=False)
class FilteredStep:
    """One step of the filter as the smoother needs it; `expected` and `transition` are None at a start.

    The arms in `turned` were reversed until then: in `state` they are turned, in `expected` and all before they are not.
    """

    t_ns: int
    state: State
    expected: State | None
    transition: tuple[Array, Array, Array] | None
    turned: tuple[_Arm, ...] = ()


class _Arms:
    """The arms of one body; remembers the evidence against the side to which each elbow is bent.

    An elbow that is held at its end of motion while its points are bent to the other side is a minimum that a filter does not
    leave: the upper arm is turned by 180 deg about its own axis. Legs have none, because hips have limits, too.
    """

    def __init__(self, body: BodyModel, tree: tree_kernels.Tree) -> None:
        self._tree, names, rows = tree, [node.name for node in body.nodes], landmark_rows(body)[:, 0]
        self._against: dict[_Arm, float] = {}
        for side in SIDES:
            nodes = [f"{side}_{part}" for part in ("shoulder", "carrying", "elbow", "pronation")]
            shoulder, elbow, wrist = (int(rows[POINTS.index(f"{side}_{point}")]) for point in ("shoulder", "elbow", "wrist"))
            if set(nodes) <= set(names) and min(shoulder, elbow, wrist) >= 0:
                upper, carrying, hinge, pronation = map(names.index, nodes)
                self._against[_Arm(upper, carrying, hinge, pronation, (shoulder, elbow, wrist))] = 0.0
        self._frame, self._origin = np.empty((len(names), 3, 3)), np.empty((len(names), 3))

    @property
    def doubted(self) -> set[_Arm]:
        """The arms that are more likely reversed than not; in time that may still prove to be wrong."""
        return {arm for arm, against in self._against.items() if against > 0}

    def reversed(self, state: State, seen: Measurement, repeats: float) -> tuple[_Arm, ...]:
        """The arms that must be reversed in this state."""
        tree_kernels.forward_kinematics(self._tree, state.q, state.rot, self._frame, self._origin)
        found = []
        for arm, before in self._against.items():
            _, y, z = self._frame[arm.upper].T.copy()
            points = np.array(arm.points)
            against = kernels.evidence_against(seen.xyz, seen.cov, points, 1, y, z, repeats, before)
            self._against[arm] = against if against <= kernels.REVERSED else 0.0
            found += [arm] if against > kernels.REVERSED else []
        return tuple(found)


def _with_arms_turned(tree: tree_kernels.Tree, state: State, arms: Iterable[_Arm]) -> State:
    """The state with its points where they are and the elbows of these arms bent to the other side; twice is as it was."""
    size = len(state.velocity)
    q, rot, sign = state.q.copy(), state.rot.copy(), np.ones(2 * size)
    for upper, carrying, elbow, pronation, _ in arms:
        rot[upper] = rot[upper] @ np.diag([-1.0, 1.0, -1.0])
        q[carrying], q[elbow] = -q[carrying], -q[elbow]
        # the hand stays as it is
        q[pronation] -= np.copysign(np.pi, q[pronation] - tree.limits[pronation, 0].mean())
        at = tree.dof[upper]
        negated = [at, at + 2, tree.dof[carrying], tree.dof[elbow]]
        sign[negated], sign[np.add(negated, size)] = -1.0, -1.0
    return State(q, rot, sign[size:] * state.velocity, sign[:, None] * state.cov * sign)


class BodyFilter:
    """Follows one body. Remembers the last state; forgets it after a second without any measurement."""

    def __init__(self, body: BodyModel, settings: BodySettings, workspace: FrameBuffers) -> None:
        self.body, self.settings = body, settings
        self.tree = tree_from_body(body, settings)
        self._workspace = workspace
        self.arms = _Arms(body, self.tree)
        self._last: FilteredStep | None = None
        self._seen_ns = 0

    def step(self, seen: Measurement) -> FilteredStep | None:
        """The body at this time step; None while it has not been seen well enough to start."""
        information = information_of(seen.cov) if not len(seen.projections) else np.zeros_like(seen.cov)
        usable = (information[:, 0, 0] > 0) | (seen.inverse_var > 0).any(axis=1)
        if self._last is not None and (seen.t_ns - self._seen_ns) * 1e-9 > _LOST_S:
            self._last, self.arms = None, _Arms(self.body, self.tree)
        seen, information = self._with_contacts(seen, information)
        if self._last is None:
            filtered = self._start(seen, information)
        else:
            filtered = self._next(self._last, seen, information)
            repeats = self._repeats((seen.t_ns - self._last.t_ns) * 1e-9)
            if self.settings.joint_limits and (arms := self.arms.reversed(filtered.state, seen, repeats)):
                filtered = replace(filtered, state=_with_arms_turned(self.tree, filtered.state, arms), turned=arms)
        self._last = filtered
        if usable.any():
            self._seen_ns = seen.t_ns
        return filtered

    def _with_contacts(self, seen: Measurement, information: Array) -> tuple[Measurement, Array]:
        """The feet's places on the floor in place of points that do not count themselves."""
        if seen.standing is None:
            return seen, information
        there = np.isfinite(seen.standing[:, 0])
        # a place on the floor is no measurement whose error lasts
        repeats = 1.0 if self._last is None else self._repeats((seen.t_ns - self._last.t_ns) * 1e-9)
        counts = repeats / self.settings.contact_sigma_m**2
        xyz = np.where(there[:, None], seen.standing, seen.xyz)
        return replace(seen, xyz=xyz), np.where(there[:, None, None], counts * np.eye(3), information)

    def _repeats(self, elapsed_s: float) -> float:
        """In how many time steps the error of a measurement is the same."""
        return max(1.0, self.settings.noise_memory_s / elapsed_s)

    def _start(self, seen: Measurement, information: Array) -> FilteredStep | None:
        guess = guessed_state(self.body, self.tree, self._workspace, seen.xyz)
        if guess is None:
            return None
        q, rot = guess
        size = self.tree.size
        first = self.tree.held(1 / _FIRST_SD**2)
        hessian = self._fit(q, rot, first, seen, information, repeats=1.0, habit=1.0, steps=_FIRST_ITERATIONS)
        cov = np.zeros((2 * size, 2 * size))
        cov[:size, :size] = tree_kernels.inverse(hessian)
        cov[size:, size:] = np.diag(np.where(self.tree.slack_var > 0, 1e-12, _SPEED_SD**2))
        return FilteredStep(seen.t_ns, State(q, rot, np.zeros(size), cov), None, None)

    def _next(self, last: FilteredStep, seen: Measurement, information: Array) -> FilteredStep:
        tree = self.tree
        elapsed_s = (seen.t_ns - last.t_ns) * 1e-9
        q, rot, velocity, cov = (a.copy() for a in (last.state.q, last.state.rot, last.state.velocity, last.state.cov))
        transition = fit_kernels.predict(tree, elapsed_s, _VELOCITY_MEMORY_S, SLACK_S, q, rot, velocity, cov)
        expected = State(q.copy(), rot.copy(), velocity.copy(), cov.copy())
        prior = tree_kernels.inverse(np.ascontiguousarray(cov[: tree.size, : tree.size]))
        repeats = self._repeats(elapsed_s)
        hessian = self._fit(q, rot, prior, seen, information, repeats=repeats, habit=HABIT_S / elapsed_s, steps=_ITERATIONS)
        step = tree_kernels.difference(tree, q, rot, expected.q, expected.rot)
        fit_kernels.absorb(cov, prior, tree_kernels.inverse(hessian), step, velocity)
        return FilteredStep(seen.t_ns, State(q, rot, velocity, cov), expected, transition)

    def _fit(
        self,
        q: Array,
        rot: Array,
        prior: Array,
        seen: Measurement,
        information: Array,
        *,
        repeats: float,
        habit: float,
        steps: int,
    ) -> Array:
        measured = fit_kernels.SeenKeypoints(seen.xyz, information, seen.projections, seen.xy, seen.inverse_var)
        hessian = fit_kernels.gauss_newton(
            self.tree, (q.copy(), rot.copy()), prior, np.sqrt(max(1.0, habit)), measured,
            self.settings.robust_dof, repeats, steps, q, rot,
        )  # fmt: skip
        return np.asarray(hessian)


def smoothed(filter_: BodyFilter, seen: Iterable[Measurement]) -> Iterator[tuple[Measurement, State | None]]:
    """What was seen, in time order, with the state given the whole recording; None where there is none yet.

    What is seen later than some seconds changes a state no more: a recording is smoothed block by block, in constant memory.
    """
    kept: list[tuple[Measurement, FilteredStep | None]] = []
    for one in seen:
        kept.append((one, filter_.step(one)))
        if len(kept) > _BLOCK_STEPS and (one.t_ns - kept[_BLOCK_STEPS][0].t_ns) * 1e-9 >= _LOOK_AHEAD_S:
            yield from _smoothed_block(filter_.tree, kept, _BLOCK_STEPS, set())
            del kept[:_BLOCK_STEPS]
    yield from _smoothed_block(filter_.tree, kept, len(kept), filter_.arms.doubted)


def _smoothed_block(
    tree: tree_kernels.Tree, kept: list[tuple[Measurement, FilteredStep | None]], count: int, backwards: set[_Arm]
) -> Iterator[tuple[Measurement, State | None]]:
    """The first `count` of these steps, smoothed with all of them.

    An arm that was found to be reversed is turned in all steps before that in which its elbow is bent backwards; one of
    `backwards` in the last steps, too.
    """
    states: list[State | None] = []
    after, later = None, None
    for place in range(len(kept) - 1, -1, -1):
        filtered = kept[place][1]
        backwards = backwards | set(after.turned if after is not None else ())
        later = _smoothed_state(tree, filtered, after, later)
        after = filtered
        backwards = {arm for arm in backwards if later is not None and later.q[arm.elbow] < 0}
        if place < count:
            states.append(_with_arms_turned(tree, later, backwards) if later is not None and backwards else later)
    return ((kept[place][0], state) for place, state in enumerate(reversed(states)))


def _smoothed_state(
    tree: tree_kernels.Tree, filtered: FilteredStep | None, after: FilteredStep | None, later: State | None
) -> State | None:
    """One step backwards; `after`, `later`: the next step as filtered and as smoothed."""
    if filtered is None:
        return None
    if after is None or later is None or after.expected is None or after.transition is None:
        return filtered.state
    later = _with_arms_turned(tree, later, after.turned) if after.turned else later
    moved = tree_kernels.difference(tree, later.q, later.rot, after.expected.q, after.expected.rot)
    change = np.concatenate([moved, later.velocity - after.expected.velocity])
    step, cov = fit_kernels.smooth_step(filtered.state.cov, *after.transition, after.expected.cov, later.cov, change)
    q, rot = filtered.state.q.copy(), filtered.state.rot.copy()
    tree_kernels.retract(tree, step[: tree.size], q, rot)
    return replace(filtered.state, q=q, rot=rot, velocity=filtered.state.velocity + step[tree.size :], cov=cov)


def information_of(cov: Array) -> Array:
    """Inverse (A, 3, 3) of covariances; 0 where a point is missing."""
    known = np.asarray(np.isfinite(cov).all(axis=(-1, -2)))
    safe = np.where(known[:, None, None], cov, np.eye(3)) + 1e-12 * np.eye(3)
    return np.where(known[:, None, None], np.linalg.inv(safe), 0.0)
