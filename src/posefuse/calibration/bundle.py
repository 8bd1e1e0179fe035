"""Robust least squares for bundle adjustment, of rigid targets and of free points (keypoints of a person at time steps).

Levenberg-Marquardt with the Schur complement. Unknowns are few global blocks (cameras, markers, lenses) and many small local
ones (prop poses, points), each of which touches no other local one. Every observation is one image point. Deterministic: fixed
order of all sums. Method: Triggs, McLauchlan, Hartley, Fitzgibbon, "Bundle adjustment - a modern synthesis" (2000), sections 6.1
and 4.3.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from scipy.sparse import csr_matrix

from posefuse.core.arrays import SIGMA_PER_MAD, Array

State = TypeVar("State")

_MOST_ITERATIONS = 40
_LEAST_GAIN = 1e-6
_DAMPING_START, _DAMPING_MOST = 1e-4, 1e8


@dataclass(frozen=True, eq=False)
class ResidualBlock:
    """Global unknowns of one kind, as seen by the observations.

    Attributes:
        jacobian: (N, 2, p) change of each predicted point. index: (N,) which of the kind. count: how many there are.
        prior: (count, p, p) inverse covariance of the prior; None for none. offset: (count, p) present distance from its mean.
    """

    jacobian: Array
    index: Array
    count: int
    prior: Array | None = None
    offset: Array | None = None


@dataclass(frozen=True, eq=False)
class Linearised:
    """The problem about one state.

    Attributes:
        blocks: global unknowns. local_jacobian: (N, 2, q). local_index: (N,).
    """

    blocks: tuple[ResidualBlock, ...]
    local_jacobian: Array
    local_index: Array


class Problem(ABC, Generic[State]):
    """What the solver needs to know.

    Attributes:
        free: per block (count, p) bool; held unknowns are False.
        local_count: L. group: (N,) observations of one group (a marker in an image) share one robust weight.
        group_count: number of groups. cauchy: scale of the robust loss in standard deviations; inf for least squares.
    """

    free: tuple[Array, ...]
    local_count: int
    group: Array
    group_count: int
    cauchy: float

    @abstractmethod
    def residual(self, state: State) -> Array:
        """(N, 2) predicted minus observed, in standard deviations; NaN rows (behind a camera) count as far off."""

    @abstractmethod
    def linearise(self, state: State) -> Linearised:
        """How the residuals change about a state."""

    @abstractmethod
    def step(self, state: State, blocks: list[Array], local: Array) -> State:
        """The state moved by steps of each block (count, p) and of the local unknowns (L, q)."""

    @abstractmethod
    def prior_cost(self, state: State) -> float:
        """Cost of the priors."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Solution(Generic[State]):
    """Where the solver stopped.

    Attributes:
        state: the unknowns. residual: (N, 2) there. linear: the problem about it.
        covariance: (G, G) of the free global unknowns, in the order of the blocks, for unit observation noise.
        scores: (L, G) pull of the observations of each local unknown on the free global ones; their sum is about 0.
    """

    state: State
    residual: Array
    linear: Linearised
    covariance: Array
    scores: Array

    def spread_px(self, assumed_px: float, least_px: float) -> float:
        """Robust standard deviation of a coordinate, its residuals being in units of `assumed_px`, which it is without any."""
        usable = self.residual[np.isfinite(self.residual).all(axis=1)] * assumed_px
        return max(float(SIGMA_PER_MAD * np.median(np.abs(usable))), least_px) if len(usable) else assumed_px


def grouped_sum(values: Array, index: Array, count: int) -> Array:
    """(count, ...) sums of values (N, ...) by index (N,)."""
    chooser = csr_matrix((np.ones(len(index)), (index, np.arange(len(index)))), shape=(count, len(index)))
    return np.asarray(chooser @ values.reshape(len(index), -1)).reshape(count, *values.shape[1:])


def solve_bundle(problem: Problem[State], start: State) -> Solution[State]:
    """Minimise the robust cost from a start that is roughly right."""
    state, damping = start, _DAMPING_START
    residual = problem.residual(state)
    cost = _cost(problem, residual) + problem.prior_cost(state)
    converged, iteration = False, 0
    while iteration < _MOST_ITERATIONS and not converged:
        system = _System(problem, problem.linearise(state), residual)
        while iteration < _MOST_ITERATIONS:
            iteration += 1
            global_steps, local_steps = system.steps(damping)
            trial = problem.step(state, global_steps, local_steps)
            trial_residual = problem.residual(trial)
            trial_cost = _cost(problem, trial_residual) + problem.prior_cost(trial)
            if trial_cost <= cost:
                converged = cost - trial_cost <= _LEAST_GAIN * cost
                state, residual, cost = trial, trial_residual, trial_cost
                damping = max(damping / 6, 1e-9)
                break
            damping *= 5
            if damping > _DAMPING_MOST:
                converged = True
                break
    linear = problem.linearise(state)
    system = _System(problem, linear, residual)
    return Solution(
        state=state,
        residual=residual,
        linear=linear,
        covariance=system.covariance(),
        scores=system.scores(linear),
    )


def clustered_covariance(covariance: Array, scores: Array, block: Array) -> Array:
    """Covariance (G, G) with each standard error as large as the blocks of observations scatter, where that is more.

    Observations near in time share errors (blur, uneven stamps, a lens model that does not quite fit), which the noise of single
    corners does not show (White 1980, by clusters).

    Args:
        covariance: (G, G) from the noise. scores: (L, G) in the same unit of noise. block: (L,) number of each one's block.
    """
    used, place = np.unique(block[np.abs(scores).sum(axis=1) > 0], return_inverse=True)
    if len(used) < 2 or not len(covariance):
        return covariance
    pulls = grouped_sum(scores[np.abs(scores).sum(axis=1) > 0], place, len(used))
    pulls = (pulls - pulls.mean(axis=0)) @ covariance
    scatter = (pulls**2).sum(axis=0) * len(used) / (len(used) - 1)
    larger = np.sqrt(np.maximum(scatter / np.maximum(np.diag(covariance), 1e-300), 1.0))
    return np.asarray(covariance * larger[:, None] * larger)


def _group_square(problem: Problem[State], residual: Array) -> tuple[Array, Array]:
    """Mean square per coordinate (groups,) and number of points (groups,); points behind a camera are 1e3 sigma off."""
    square = np.nan_to_num((residual**2).sum(axis=1), nan=1e6) / 2
    points = np.bincount(problem.group, minlength=problem.group_count)
    return np.bincount(problem.group, square, problem.group_count) / np.maximum(points, 1), points


def _cost(problem: Problem[State], residual: Array) -> float:
    square, points = _group_square(problem, residual)
    if np.isinf(problem.cauchy):
        return float((points * square).sum())
    scale = problem.cauchy**2
    return float((points * scale * np.log1p(square / scale)).sum())


def _weights(problem: Problem[State], residual: Array) -> Array:
    """Robust weight (N,) of each point, one per group; 0 for points behind a camera."""
    square, _ = _group_square(problem, residual)
    weight = 1 / (1 + square / problem.cauchy**2) if np.isfinite(problem.cauchy) else np.ones_like(square)
    return np.where(np.isfinite(residual).all(axis=1), weight[problem.group], 0.0)


class _System:
    """Normal equations with the local unknowns eliminated."""

    def __init__(self, problem: Problem[State], linear: Linearised, residual: Array) -> None:
        weight, residual = _weights(problem, residual), np.nan_to_num(residual)
        self._weighted_residual = weight[:, None] * residual
        self._sizes = [(block.count, block.jacobian.shape[2]) for block in linear.blocks]
        self._free = np.concatenate([free.ravel() for free in problem.free])
        starts = np.cumsum([0] + [count * p for count, p in self._sizes])
        self._starts = starts
        total, locals_ = int(starts[-1]), problem.local_count
        plain = [np.nan_to_num(block.jacobian) for block in linear.blocks]
        weighted = [jacobian * weight[:, None, None] for jacobian in plain]
        local = np.nan_to_num(linear.local_jacobian)
        q = local.shape[2]
        self._A = np.zeros((total, total))
        self._g = np.zeros(total)
        self._B = np.zeros((locals_, total, q))
        # what is held takes no part, and its rows go below
        moving = [i for i, free in enumerate(problem.free) if free.any()]
        for i in moving:
            block, (n, p), s = linear.blocks[i], self._sizes[i], starts[i]
            for j in (k for k in moving if k >= i):
                (m, r), u = self._sizes[j], starts[j]
                both = grouped_sum(_outer(weighted[i], plain[j]), block.index * m + linear.blocks[j].index, n * m)
                square = both.reshape(n, m, p, r).transpose(0, 2, 1, 3).reshape(n * p, m * r)
                self._A[s : s + n * p, u : u + m * r] = square
                self._A[u : u + m * r, s : s + n * p] = square.T
            self._g[s : s + n * p] = grouped_sum((weighted[i] * residual[:, :, None]).sum(axis=1), block.index, n).ravel()
            mixed = grouped_sum(_outer(weighted[i], local), linear.local_index * n + block.index, locals_ * n)
            self._B[:, s : s + n * p] = mixed.reshape(locals_, n * p, q)
            if block.prior is not None and block.offset is not None:
                for own in np.arange(s, s + n * p).reshape(n, p):
                    self._A[np.ix_(own, own)] += block.prior[(own[0] - s) // p]
                self._g[s : s + n * p] += (block.prior @ block.offset[..., None]).ravel()
        self._C = grouped_sum(_outer(local * weight[:, None, None], local), linear.local_index, locals_)
        self._h = grouped_sum((local * self._weighted_residual[:, :, None]).sum(axis=1), linear.local_index, locals_)
        self._A = self._A[np.ix_(self._free, self._free)]
        self._g, self._B = self._g[self._free], self._B[:, self._free]

    def _reduced(self, damping: float) -> tuple[Array, Array, Array]:
        """Schur complement, its right side, and inverse local blocks."""
        q = self._C.shape[1]
        diagonal = np.einsum("lii->li", self._C)
        # a local block nothing observes any more stays where it is
        damped = self._C + np.eye(q) * (damping * diagonal + 1e-12 * diagonal.max(initial=1.0))[:, None, :]
        inverse = np.linalg.inv(damped)
        # relative to each unknown's own: one that is all but held must not hold the others, which have other units
        A = self._A + np.diag(damping * np.diag(self._A) + self._least())
        through = self._B @ inverse
        flat_shape = (self._B.shape[1], self._B.shape[0] * q)
        flat_B = self._B.transpose(1, 0, 2).reshape(flat_shape)
        flat_through = through.transpose(1, 0, 2).reshape(flat_shape)
        return A - flat_through @ flat_B.T, self._g - flat_through @ self._h.ravel(), inverse

    def _least(self) -> Array:
        """(G,) information below which rounding errors leave nothing of each unknown's own."""
        own = np.diag(self._A)
        return np.asarray(1e-12 * np.where(own > 0, own, own.max(initial=1.0)))

    def steps(self, damping: float) -> tuple[list[Array], Array]:
        """Steps of every global block (count, p) and of the local unknowns (L, q)."""
        schur, right, inverse = self._reduced(damping)
        step = np.zeros(len(self._free))
        step[self._free] = -np.linalg.solve(schur, right)
        pulled = self._h + np.einsum("lgq,g->lq", self._B, step[self._free])
        local = -(inverse @ pulled[..., None])[..., 0]
        parts = [step[s : s + n * p].reshape(n, p) for s, (n, p) in zip(self._starts, self._sizes, strict=False)]
        return parts, local

    def scores(self, linear: Linearised) -> Array:
        """(L, G) weighted pull of each local unknown's observations, the local unknown taken out."""
        count, parts = len(self._C), []
        for block, (n, p) in zip(linear.blocks, self._sizes, strict=True):
            pull = (np.nan_to_num(block.jacobian) * self._weighted_residual[:, :, None]).sum(axis=1)
            parts.append(grouped_sum(pull, linear.local_index * n + block.index, count * n).reshape(count, n * p))
        own = np.concatenate(parts, axis=1)[:, self._free]
        _, _, inverse = self._reduced(0.0)
        return np.asarray(own - np.einsum("lgq,lqr,lr->lg", self._B, inverse, self._h))

    def covariance(self) -> Array:
        """(G, G) of the free global unknowns for unit noise; infinite where the data do not determine them."""
        schur, _, _ = self._reduced(0.0)
        if len(schur) == 0:
            return schur
        # in units in which each unknown alone has unit information
        unit = np.sqrt(np.maximum(np.diag(schur), self._least()))
        values, vectors = np.linalg.eigh((schur + schur.T) / 2 / np.outer(unit, unit))
        return np.asarray((vectors / np.maximum(values, 1e-11 * values.max())) @ vectors.T) / np.outer(unit, unit)


def _outer(left: Array, right: Array) -> Array:
    """(N, p, r) left^T right of Jacobians (N, 2, p) and (N, 2, r)."""
    return np.asarray(np.swapaxes(left, 1, 2) @ right)
