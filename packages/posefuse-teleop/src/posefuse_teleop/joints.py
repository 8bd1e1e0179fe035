"""Commanded joints of a robot: each step keeps all limits, and leaves a stop that keeps them, too.

A wanted step is taken only if the robot can stop after it: all joints slow down together, along a straight line of joint
positions, as hard as the accelerations of joints and end effectors allow. That stop is computed step by step and checked against
every limit before the wanted step is taken, and is carried out where no later wanted step passes. So there always is a checked
stop, as in fail-safe motion planning (Pek and Althoff 2018), and no limit depends on what the inverse kinematics finds.
"""

from __future__ import annotations

import numpy as np

from posefuse.core import SE3
from posefuse.core.arrays import Array
from posefuse.core.se3 import quaternion_product

from .follower import FOLLOWS_M, FOLLOWS_RAD, Follower
from .kinematics import Chain, WholeBodyIk
from .limits import first_inside, last_inside, norm
from .settings import STOP_CONDITION, TURN_ACCELERATION_RADPS2, LimitSettings
from .values import RobotState

# a stop that takes longer is none: with the watchdog, the robot stands 0.35 s after the last order
_STOP_S = 0.28
# share of the limits of end effectors that is planned with: a step and a stop are found on chords of slightly curved paths
_STEP, _STOP = 0.9995, 0.99
# pairs of bodies farther apart than this are not measured exactly
_WATCH_M = 0.25
_ROUNDING = 1e-9


class Joints:
    """Commanded joints.

    Attributes:
        chain, ik: of the robot. world_from_model: where it stands. q: (n,) positions. step: (n,) the last one.
    """

    def __init__(self, chain: Chain, limits: LimitSettings, world_from_model: SE3) -> None:
        self.chain, self.world_from_model, self._limits = chain, world_from_model, limits
        self.ik = WholeBodyIk(chain, limits)
        self.begin(chain.home)

    def begin(self, q: Array) -> None:
        """The joints stand at (n,); that is the comfortable posture from now on."""
        self.ik.comfort = self.q = q.copy()
        self._along = self.step = np.zeros(len(q))
        # what is left of the checked stop: shares of the step `_along`
        self._stop: list[float] = []
        # end effectors now and a step ago, (H, 3), axes of the model
        self._here = self._before = self._ends(q)
        # how a joint step turns them, (H, 3, n), and how the last one did, (H, 3)
        self._turn_rows = self.chain.jacobians()[:, 3:]
        self._turned, self._dt_s = np.zeros_like(self._here), 1.0
        self._apart = self.chain.distances(_WATCH_M)

    def follow(self, wanted: Follower, dt_s: float, left_out: int) -> Array:
        """One control step of a commanded motion (`follower.Robot.move`); the joints then, (n,)."""
        self._dt_s = dt_s
        if wanted.brakes or wanted.stands:
            self.brake(dt_s, left_out)
        else:
            self.move(wanted.xyz, wanted.wxyz, dt_s)
        return self.q

    def coast(self, steps: int, dt_s: float) -> None:
        """So many steps that were never commanded, of a robot that stops by itself: one more like the last, then the stop."""
        self._take(self.step, self._stop, self._along)
        for _ in range(min(steps - 1, len(self._stop) + 1)):
            self.brake(dt_s)

    def resting(self) -> tuple[Array, float]:
        """(n,) where the joints rest at the end of the checked stop, and how many control steps from now."""
        return self.q + sum(self._stop) * self._along, len(self._stop)

    def state(self, measured: Array, fault: str) -> RobotState:
        """The robot whose joints are measured at (n,).

        Its spheres are where it is and where it was commanded to be: it is between the two.

        Args:
            fault: what else is known to be wrong; joints far from their commanded positions are a fault, too.
        """
        chain, place = self.chain, self.world_from_model
        turn = place.matrix()
        chain.place(measured)
        ends, spheres = place @ chain.positions(), chain.spheres()
        chain.place(self.q)
        spheres = np.concatenate([spheres, chain.spheres()])
        spheres[:, :3] = place @ spheres[:, :3]
        return RobotState(
            xyz_world=place @ self._here,
            wxyz=quaternion_product(place.wxyz, chain.orientations()),
            velocity_world=(self._here - self._before) @ turn.T / self._dt_s,
            turn_rate_world=self._turned @ turn.T / self._dt_s,
            measured_xyz_world=ends,
            q_rad=self.q,
            spheres_world=spheres,
            pace=self.ik.pace(),
            fault=fault or self._not_following(measured, ends - place @ self._here),
        )

    def _not_following(self, measured: Array, apart: Array) -> str:
        """What is wrong, if anything. apart: (H, 3) measured minus commanded end effectors: shows a base that is held, too."""
        off = np.abs(measured - self.q)[self.chain.arm]
        if off.max() <= FOLLOWS_RAD:
            far_m = float(np.linalg.norm(apart, axis=1).max())
            return f"the end effector is {far_m:.2f} m from where it was commanded" if far_m > FOLLOWS_M else ""
        name = [name for name, arm in zip(self.chain.names, self.chain.arm, strict=True) if arm][int(off.argmax())]
        return f"joint {name} is {off.max():.2f} rad from its commanded position"

    def move(self, xyz_world: Array, wxyz: Array, dt_s: float) -> None:
        """One step towards poses (H, 3), (H, 4) of the end effectors, as far as the limits allow."""
        back = self.world_from_model.inverse()
        wanted = self.ik.step(self.q, self.step, back @ xyz_world, quaternion_product(back.wxyz, wxyz), dt_s)
        if wanted is not None and self._moved(wanted, dt_s):
            return
        self.brake(dt_s)

    def brake(self, dt_s: float, left_out: int = 0) -> None:
        """One step of the checked stop. left_out: steps of it that were due before and never done."""
        stop = self._stop[left_out:]
        self._take(self._safe(left_out), stop[1:], self._along)
        if left_out and stop:
            # the same line, but from another point of it
            shorter, _ = self._stop_after([self._before, self._here], self.q, self.step, dt_s)
            if shorter and shorter[-1] == 0:
                self._stop, self._along = shorter, self.step

    def _moved(self, wanted: Array, dt_s: float) -> bool:
        """Take what the limits of the end effectors leave of a wanted step; False where that does not pass all checks."""
        safe = self._safe(0)
        step = safe + self._share_in_limits(safe, wanted, dt_s) * (wanted - safe)
        stop = self._checked_stop(step, dt_s)
        if stop is not None:
            self._take(step, stop, step)
        return stop is not None

    def _safe(self, left_out: int) -> Array:
        return self._stop[left_out] * self._along if len(self._stop) > left_out else np.zeros(len(self.q))

    def _take(self, step: Array, stop: list[float], along: Array) -> None:
        self.q, self.step, self._stop, self._along = self.q + step, step, stop, along
        self._turned = self._turn_rows @ step
        self._before, self._here = self._here, self._ends(self.q)
        self._turn_rows = self.chain.jacobians()[:, 3:]
        self._apart = self.chain.distances(_WATCH_M)

    def _ends(self, q: Array) -> Array:
        self.chain.place(q)
        return self.chain.positions()

    def _share_in_limits(self, safe: Array, wanted: Array, dt_s: float) -> float:
        """How much of the way from the safe to the wanted step keeps speed and acceleration of the end effectors."""
        limits, rows = self._limits, self._turn_rows
        start, end = self._ends(self.q + safe) - self._here, self._ends(self.q + wanted) - self._here
        moves = _share_of_way(start, end, self._here - self._before, limits.speed_mps * dt_s, limits.acceleration_mps2 * dt_s**2)
        turns = (limits.turn_rate_radps * dt_s, TURN_ACCELERATION_RADPS2 * dt_s**2)
        return min(moves, _share_of_way(rows @ safe, rows @ wanted, self._turned, *turns))

    def _checked_stop(self, step: Array, dt_s: float) -> list[float] | None:
        """The stop after a step, in shares of it; None where step or stop break a limit."""
        q = self.q + step
        stop, ends = self._stop_after([self._before, self._here, self._ends(q)], q, step, dt_s)
        last = q + sum(stop) * step
        low, high = np.minimum(self.ik.low - _ROUNDING, self.q), np.maximum(self.ik.high + _ROUNDING, self.q)
        if (stop and stop[-1] > 0) or (last < low).any() or (last > high).any() or not self._allowed(ends, dt_s):
            return None
        self.chain.place(last)
        if self.ik.singular() > max(STOP_CONDITION, self.ik.condition):
            return None
        return stop if self._keeps_apart(q, step, stop) else None

    def _stop_after(self, ends: list[Array], q: Array, along: Array, dt_s: float) -> tuple[list[float], Array]:
        """Shares of the step `along` that slow it down to nothing; the last is 0 unless it takes too long or cannot be.

        ends: of (H, 3) end effectors, the last at `q`, after the step. Also returns those with each step of the stop, (S, H, 3).
        """
        stop: list[float] = []
        share = 1.0
        turned = np.linalg.norm(self._turn_rows @ along, axis=1) / TURN_ACCELERATION_RADPS2
        drop = _STOP * dt_s**2 / max(float((np.abs(along) / self.ik.acceleration).max()), float(turned.max()), 1e-12)
        while share > 0 and len(stop) * dt_s < _STOP_S:
            share, there = self._slowed(q, along, ends[-2:], (max(0.0, share - drop), share), dt_s)
            q = q + share * along
            ends.append(there)
            stop.append(share)
        return stop, np.array(ends)

    def _slowed(self, q: Array, along: Array, ends: list[Array], shares: tuple[float, float], dt_s: float) -> tuple[float, Array]:
        """The least of a range of shares that keeps the acceleration of the end effectors, and where they are then.

        ends: where they were a step ago, and are.
        """
        (before, here), (least, share) = ends, shares
        most = _STOP * self._limits.acceleration_mps2 * dt_s**2
        there = self._ends(q + least * along)
        change = there - 2 * here + before
        if float(np.einsum("hi,hi->h", change, change).max()) <= most * most:
            return least, there
        way = self._ends(q + share * along) - there
        parts = [first_inside(a, b, most) for a, b in zip(change, way, strict=True)]
        slowed = least + max(parts) * (share - least)
        return slowed, self._ends(q + slowed * along)

    def _allowed(self, ends: Array, dt_s: float) -> bool:
        """Whether the end effectors may move so: (S, H, 3) at the ends of steps, the first of which was the one before last."""
        limits = self._limits
        steps = np.diff(ends, axis=0)
        speeds = np.sqrt(np.einsum("shi,shi->sh", steps, steps))
        changes = np.diff(steps, axis=0)
        if np.einsum("shi,shi->sh", changes, changes).max() > (limits.acceleration_mps2 * dt_s**2) ** 2:
            return False
        if (speeds[1:] > np.maximum(limits.speed_mps * dt_s, speeds[0])).any():
            return False
        xyz = self.world_from_model @ ends[1:]
        low, high = np.minimum(limits.box_low_m, xyz[0]), np.maximum(limits.box_high_m, xyz[0])
        return bool((xyz >= low).all() and (xyz <= high).all())

    def _keeps_apart(self, q: Array, along: Array, stop: list[float]) -> bool:
        """Whether no pair of bodies comes nearer than it may, or than it is now, during a step and its stop."""
        least = np.minimum(self._limits.collision_m - _ROUNDING, self._apart)
        self.chain.place(q)
        apart = self.chain.distances(_WATCH_M)
        if (apart < least).any():
            return False
        if (apart - self.chain.travel_m(sum(stop) * along) >= least).all():
            return True
        for share in stop:
            q = q + share * along
            self.chain.place(q)
            if (self.chain.distances(_WATCH_M) < least).any():
                return False
        return True


def _share_of_way(start: Array, end: Array, last: Array, speed: float, change: float) -> float:
    """How much of the way between vectors (H, 3) of one step keeps its length and its difference from the last step."""
    shares = [1.0]
    for a, b, before in zip(start, end, last, strict=True):
        shares.append(last_inside(a - before, b - a, _STEP * change))
        shares.append(last_inside(a, b - a, max(_STEP * speed, norm(a))))
    return min(shares)
