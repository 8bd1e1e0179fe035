"""Differential inverse kinematics of a whole body: one quadratic program per control step.

Unknowns are the steps of all joints that move an end effector. Minimised are the errors of the end effectors, then (weakly) the
distance from a comfortable posture, the motion of the base, and changes of joint velocity; constraints are joint limits with a
margin, speed and acceleration of the joints, and distances between the robot's own bodies. The formulation is the usual one
(Escande et al. 2014; the linearised distances after Faverjon and Tournassoud 1987); the program is solved by DAQP (Arnström et
al. 2022).
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
_DAMPING, _BASE_DAMPING, _POSTURE, _CHANGE = 1e-6, 3e-4, 2e-5, 2e-5
_POSTURE_PER_S = 0.5
# the arm works alone while it is stretched to between the inner shares of its length and its condition number is below the first;
# from the outer ones on the base moves freely
_FOLDED, _COMFORTABLE, _STRETCHED = (0.3, 0.4), 0.5, 0.62
_EASY_CONDITION, _HARD_CONDITION = 8.0, 16.0
# a pair of bodies nearer than this is watched
_WATCH_M = 0.2
# share of the acceleration with which the program brakes before limits of joints and distances; the rest is for what it does not
# see: the path of the end effectors, and joints that have to brake together
_EARLY = 0.4


class WholeBodyIk:
    """Joint steps for poses of the end effectors.

    Attributes:
        chain: the robot. comfort: (n,) posture that it tends to. condition: of the arms' Jacobian before the last `step`.
    """

    def __init__(self, chain: Chain, limits: LimitSettings) -> None:
        import daqp

        self._daqp: Any = daqp
        self.chain, self._limits = chain, limits
        self.comfort = chain.home.copy()
        self.condition = 1.0
        arm = chain.arm
        self.speed = np.where(arm, limits.joint_speed_radps, limits.base_speed_mps)
        self.acceleration = np.where(arm, limits.joint_acceleration_radps2, limits.base_acceleration_mps2)
        margin = np.where(arm, limits.joint_margin_rad, 0.0)
        self.low, self.high = chain.low + margin, chain.high - margin

    def step(self, q: Array, last: Array, xyz: Array, wxyz: Array, dt_s: float) -> Array | None:
        """(n,) joint step from `q` after the step `last` that brings the end effectors to (H, 3), (H, 4); None: no solution."""
        chain = self.chain
        chain.place(q + last)
        ahead = chain.positions()
        chain.place(q)
        jacobians, here, turned = chain.jacobians(), chain.positions(), chain.orientations()
        # the path of an end effector is curved, and about as much in this step as in the last one
        curve = ahead - here - jacobians[:, :3] @ last
        self.condition = max(_condition(_scaled(j)[:, chain.arm]) for j in jacobians)
        weight, target = np.diag(self._damping()), np.zeros(len(q))
        for h, j in enumerate(jacobians):
            error = np.concatenate([xyz[h] - here[h] - curve[h], _TURN_LENGTH_M * rotvec_between(turned[h], wxyz[h])])
            scaled = _scaled(j)
            weight += scaled.T @ scaled
            target += scaled.T @ error
        pull = np.where(chain.arm, _POSTURE_PER_S * dt_s * (self.comfort - q), 0.0)
        weight += np.diag(np.where(chain.arm, _POSTURE, 0.0) + _CHANGE)
        target += _POSTURE * pull + _CHANGE * last
        low, high = self._bounds(q, last, dt_s)
        rows, least = self._apart(dt_s)
        upper = np.concatenate([high, np.full(len(least), 1e30)])
        found = self._daqp.solve(weight, -target, rows, upper, np.concatenate([low, least]))
        if found[2] < 1 or not np.isfinite(found[0]).all():
            return None
        return np.asarray(np.clip(found[0], low, high))

    def pace(self) -> float:
        """Share of the speed limit: falls with the condition number, never to nothing, so that a singularity can be left."""
        limits = self._limits
        share = (limits.stop_condition - self.condition) / (limits.stop_condition - limits.slow_condition)
        return float(np.clip(share, _SLOWEST, 1.0))

    def singular(self) -> float:
        """Condition number of the arms' Jacobian as the chain is placed now."""
        return max(_condition(_scaled(j)[:, self.chain.arm]) for j in self.chain.jacobians())

    def _base_share(self) -> float:
        """How freely the base may move, 0..1: not at all while the arm is comfortable."""
        stretch = self.chain.stretch()
        far = (stretch - _COMFORTABLE) / (_STRETCHED - _COMFORTABLE)
        near = (_FOLDED[1] - stretch) / (_FOLDED[1] - _FOLDED[0])
        hard = (self.condition - _EASY_CONDITION) / (_HARD_CONDITION - _EASY_CONDITION)
        return float(np.clip(max(far, near, hard), 0.0, 1.0))

    def _damping(self) -> Array:
        return np.where(self.chain.arm, _DAMPING, _BASE_DAMPING)

    def _bounds(self, q: Array, last: Array, dt_s: float) -> tuple[Array, Array]:
        """Least and most step of each joint. One that is past its limit may come back only."""
        arm, change = self.chain.arm, self.acceleration * dt_s**2
        speed = dt_s * self.speed * (1.0 if arm.all() else np.where(arm, 1.0, self._base_share()))
        up = np.minimum(speed, _braking_step(self.high - q, _EARLY * change))
        down = np.minimum(speed, _braking_step(q - self.low, _EARLY * change))
        return np.clip(-down, last - change, last + change), np.clip(up, last - change, last + change)

    def _apart(self, dt_s: float) -> tuple[Array, Array]:
        """Linear constraints rows @ step >= least that keep pairs of bodies apart: (C, n), (C,)."""
        limits = self._limits
        gaps = self.chain.gaps(_WATCH_M)
        if not gaps:
            return np.zeros((0, len(self.low))), np.zeros(0)
        left = np.array([gap.distance_m - limits.collision_m for gap in gaps])
        return np.array([gap.row for gap in gaps]), -_braking_step(left, _EARLY * limits.acceleration_mps2 * dt_s**2)


_SLOWEST = 0.1


def _braking_step(left: Array, change: Array | float) -> Array:
    """Largest step towards a limit that is `left` away, if each step may be smaller by `change` than the one before."""
    return np.asarray(np.sqrt(change * change + 2 * change * np.maximum(left, 0.0)) - change)


def _scaled(jacobian: Array) -> Array:
    """A Jacobian (6, n) whose rows of orientation are lengths."""
    return np.concatenate([jacobian[:3], _TURN_LENGTH_M * jacobian[3:]])


def _condition(jacobian: Array) -> float:
    values = np.linalg.svd(jacobian, compute_uv=False)
    return float(values[0] / max(values[-1], 1e-9))
