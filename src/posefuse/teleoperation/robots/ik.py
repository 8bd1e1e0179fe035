"""Differential inverse kinematics of a whole body: one quadratic program per control step.

Unknowns are the steps of all joints that move an end effector. Minimised are the errors of the end effectors, then (weakly) the
distance from a comfortable posture, the motion of the base, and changes of joint velocity; constraints are joint limits with a
margin, joint speeds, and distances between the robot's own bodies. The formulation is the usual one (Escande et al. 2014;
the linearised distances after Faverjon and Tournassoud 1987); the program is solved by DAQP (Arnström et al. 2022).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from posefuse.core.arrays import Array
from posefuse.teleoperation.mapping import rotvec_between
from posefuse.teleoperation.settings import LimitSettings

from .chain import Chain

# weights: errors count per m^2 and, by this length, per rad^2
_TURN_LENGTH_M = 0.3
_DAMPING, _BASE_DAMPING, _POSTURE, _CHANGE = 1e-4, 3e-2, 2e-3, 2e-3
_POSTURE_PER_S = 0.5
# end effectors may be so far from their poses before the joints count as unable to follow
_ERROR_M = 0.005
_SLOWEST = 0.1
# the arm works alone while it is stretched to between the inner shares of its length and its condition number is below the first;
# from the outer ones on the base moves freely
_FOLDED, _COMFORTABLE, _STRETCHED = (0.25, 0.35), 0.55, 0.7
_EASY_CONDITION, _HARD_CONDITION = 8.0, 16.0
# a pair of bodies nearer than this is watched; so much of what is left of their distance may be used up in one step
_WATCH_M, _APPROACH = 0.12, 0.3


class WholeBodyIk:
    """Joint positions for poses of the end effectors, from one step to the next.

    Attributes:
        chain: the robot. q: (n,) joint positions as commanded. error_m: largest position error after the last `solve`.
        condition: of the arms' Jacobian before the last `solve`.
    """

    def __init__(self, chain: Chain, limits: LimitSettings) -> None:
        import daqp

        self._daqp: Any = daqp
        self.chain, self._limits = chain, limits
        self.q = chain.home.copy()
        self._comfort = chain.home.copy()
        self._dq = self._next = np.zeros(len(self.q))
        self.error_m, self.condition = 0.0, 1.0

    def solve(self, xyz: Array, wxyz: Array, dt_s: float) -> bool:
        """Find the joints for (H, 3), (H, 4) after `dt_s`; `take` then commands them. False if there is no solution."""
        chain = self.chain
        chain.place(self.q)
        jacobians = chain.jacobians()
        self.condition = max(_condition(j[:, chain.arm]) for j in jacobians)
        weight, target = np.diag(self._damping()), np.zeros(len(self.q))
        for h, j in enumerate(jacobians):
            here_xyz, here_wxyz = chain.end_effector(h)
            error = np.concatenate([xyz[h] - here_xyz, _TURN_LENGTH_M * rotvec_between(here_wxyz, wxyz[h])])
            weight += j.T @ j
            target += j.T @ error
        pull = np.where(chain.arm, _POSTURE_PER_S * dt_s * (self._comfort - self.q), 0.0)
        weight += np.diag(np.where(chain.arm, _POSTURE, 0.0) + _CHANGE)
        target += _POSTURE * pull + _CHANGE * self._dq
        low, high = self._bounds(dt_s)
        rows, least = chain.distances(self._limits.collision_m, _WATCH_M, _APPROACH)
        found = self._daqp.solve(
            weight,
            -target,
            rows,
            np.concatenate([high, np.full(len(least), 1e30)]),
            np.concatenate([low, least]),
        )
        if found[2] < 1 or not np.isfinite(found[0]).all():
            return False
        self._next = np.clip(found[0], low, high)
        chain.place(self.q + self._next)
        self.error_m = max(float(np.linalg.norm(xyz[h] - chain.end_effector(h)[0])) for h in range(len(xyz)))
        after = max(_condition(j[:, chain.arm]) for j in chain.jacobians())
        return after <= max(self._limits.stop_condition, self.condition)

    def begin(self, q: Array) -> None:
        """The joints are at (n,); that is the comfortable posture from now on."""
        self.q, self._comfort, self._dq = q.copy(), q.copy(), np.zeros(len(q))

    @property
    def follows(self) -> bool:
        """Whether the joints kept up with the end effectors in the last `solve`."""
        return self.error_m <= _ERROR_M

    def pace(self) -> float:
        """Share of the speed limit: falls with the condition number, never to nothing, so that a singularity can be left."""
        limits = self._limits
        share = (limits.stop_condition - self.condition) / (limits.stop_condition - limits.slow_condition)
        return float(np.clip(share, _SLOWEST, 1.0))

    def take(self) -> Array:
        """(n,) joint steps of the last `solve`; the commanded joints are now there."""
        self._dq = self._next
        self.q = self.q + self._dq
        return self._dq

    def rest(self) -> Array:
        """The joints stand where they are: (n,) zeros."""
        self._dq = np.zeros(len(self.q))
        return self._dq

    def _base_share(self) -> float:
        """How freely the base may move, 0..1: not at all while the arm is comfortable."""
        stretch = self.chain.stretch()
        far = (stretch - _COMFORTABLE) / (_STRETCHED - _COMFORTABLE)
        near = (_FOLDED[1] - stretch) / (_FOLDED[1] - _FOLDED[0])
        hard = (self.condition - _EASY_CONDITION) / (_HARD_CONDITION - _EASY_CONDITION)
        return float(np.clip(max(far, near, hard), 0.0, 1.0))

    def _damping(self) -> Array:
        return np.where(self.chain.arm, _DAMPING, _BASE_DAMPING)

    def _bounds(self, dt_s: float) -> tuple[Array, Array]:
        """Least and most step of each joint. One that is past its limit may come back only."""
        chain, limits = self.chain, self._limits
        share = self._base_share()
        speed = np.where(chain.arm, limits.joint_speed_radps, limits.base_speed_mps * share)
        margin = np.where(chain.arm, limits.joint_margin_rad, 0.0)
        low = np.maximum(-speed * dt_s, np.minimum(chain.low + margin - self.q, 0.0))
        high = np.minimum(speed * dt_s, np.maximum(chain.high - margin - self.q, 0.0))
        return low, high


def _condition(jacobian: Array) -> float:
    values = np.linalg.svd(jacobian, compute_uv=False)
    return float(values[0] / max(values[-1], 1e-9))
