"""A judge of the true motion of the robot at the true time, next to the true body of the operator."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np

from posefuse.core.arrays import Array
from posefuse_teleop.separation import OperatorBody, remembered, separation_m
from posefuse_teleop.settings import SeparationSettings, TeleoperationSettings

from .person import view_of
from .world import TICK_S, World

# the true distance counts as kept while the robot brakes: pose age, watchdog and braking from full speed
REACTION_S = 0.45
# a robot without orders must stand still after this time
STANDING_S = 0.35
# what rounding may add
_HAIR = 1 + 1e-6
_MOVES_PER_S = 1e-6


@dataclass(frozen=True, kw_only=True)
class Breach:
    """What was broken: sequence, time since its start, and by how much."""

    sequence: int
    t_s: float
    what: str


class Judge:
    """Looks at the true motion of the robot only: commanded joints, the end effectors they give by MuJoCo.

    Attributes:
        breaches: what was broken, in words.
    """

    def __init__(self, world: World, settings: TeleoperationSettings, sequence: int) -> None:
        self._limits, self._stop_m, self._sequence = settings.limits, settings.separation.stop_m, sequence
        self._exact = SeparationSettings(sigmas=0.0, approach_mps=0.0)
        self._body = _JudgedBody(world) if hasattr(world.robot, "joints") else None
        self._xyz: deque[Array] = deque(maxlen=3)
        self._q: deque[Array] = deque(maxlen=3)
        self._near_s = self._blocked_s = 0.0
        self.breaches: list[Breach] = []

    def look(self, world: World) -> None:
        """Judge one more control period."""
        xyz = self._body.ends(world) if self._body else np.array(world.driver.follower.xyz)
        self._xyz.append(xyz)
        self._q.append(world.driver.state.q_rad)
        limits, t_s = self._limits, world.t_s
        low, high = np.array(limits.box_low_m), np.array(limits.box_high_m)
        if not np.isfinite(xyz).all() or (xyz < low - 1e-9).any() or (xyz > high + 1e-9).any():
            self._note(t_s, f"box {xyz}")
        if self._body:
            for what in self._body.problems(self._q, limits):
                self._note(t_s, what)
        if len(self._xyz) < 3:
            return
        before, last, now = self._xyz
        speed = _most(now - last) / TICK_S
        if speed > limits.speed_mps * _HAIR:
            self._note(t_s, f"velocity {speed:.3f} m/s")
        # a step that was left out by a late process changes the mean velocity of the next
        left_out = np.array_equal(now, last) or np.array_equal(last, before)
        change = _most(now - 2 * last + before) / TICK_S**2
        if change > limits.acceleration_mps2 * _HAIR and not left_out:
            self._note(t_s, f"acceleration {change:.2f} m/s2")
        joint_speed = float(np.abs(self._q[-1] - self._q[-2]).max(initial=0.0)) / TICK_S
        self._look_at_time(world, max(speed, joint_speed))

    def _look_at_time(self, world: World, speed: float) -> None:
        """What must stand must stand in time. speed: m/s of an end effector or rad/s of a joint."""
        t_s, moves = world.t_s, speed > _MOVES_PER_S
        silent_s = t_s - world.reached_s
        if silent_s > STANDING_S and moves:
            self._note(t_s, f"watchdog: moves at {speed:.3f} {silent_s:.2f} s after the last order")
        self._near_s = self._near_s + TICK_S if self._distance_m(world) < self._stop_m else 0.0
        if self._near_s > REACTION_S and moves:
            self._note(t_s, f"separation: moves at {speed:.3f} within {self._stop_m} m for {self._near_s:.2f} s")
        exchanged_s = world.exchanged_s
        if exchanged_s is not None and world.released_s < exchanged_s and t_s - exchanged_s > REACTION_S and moves:
            self._note(t_s, f"exchange: moves at {speed:.3f} {t_s - exchanged_s:.2f} s after another body came")
        self._blocked_s = self._blocked_s + TICK_S if world.blocked and self._off(world) else 0.0
        if self._blocked_s > STANDING_S and moves:
            self._note(t_s, f"following: is commanded at {speed:.3f} while the robot does not follow")

    def _off(self, world: World) -> bool:
        return bool(np.abs(world.robot.data.qpos[world.robot.joints.chain.qpos] - world.driver.state.q_rad).max() > 0.36)

    def _distance_m(self, world: World) -> float:
        view = view_of(world.body(world.t_s), world.now_ns)
        body = remembered(OperatorBody.unknown(), view)
        return separation_m(body, world.driver.state.spheres_world, world.now_ns, self._exact)

    def _note(self, t_s: float, what: str) -> None:
        self.breaches.append(Breach(sequence=self._sequence, t_s=t_s, what=what))


class _JudgedBody:
    """A robot with joints, seen by MuJoCo's own kinematics and contacts, apart from those of the product."""

    def __init__(self, world: World) -> None:
        import mujoco

        robot = world.robot
        self._mj, self._model, self._chain = mujoco, robot.model, robot.joints.chain
        self._place = robot.joints.world_from_model
        self._sites = [self._model.site(f"{side}_hand").id for side in world.settings.hands]
        self._data = mujoco.MjData(self._model)
        self._pairs = pairs_apart(self._model, self._data, self._chain, world.settings.limits.collision_m, mujoco)

    def ends(self, world: World) -> Array:
        """(H, 3) end effectors at the commanded joints."""
        self._data.qpos[self._chain.qpos] = world.driver.state.q_rad
        self._mj.mj_kinematics(self._model, self._data)
        return np.array(self._place @ self._data.site_xpos[self._sites])

    def problems(self, q: deque[Array], limits: Any) -> list[str]:
        """Limits of the newest joints, of which `ends` has just placed the last."""
        arm, chain, found = self._chain.arm, self._chain, []
        margin = np.where(arm, limits.joint_margin_rad, 0.0)
        if (q[-1] < chain.low + margin - 1e-8).any() or (q[-1] > chain.high - margin + 1e-8).any():
            found.append("joint limits")
        near = self._nearest_m()
        if near < limits.collision_m - 1e-7:
            found.append(f"collision: bodies {1e3 * near:.3f} mm apart")
        if len(q) < 3:
            return found
        speed = np.abs(q[-1] - q[-2]) / TICK_S
        if (speed > np.where(arm, limits.joint_speed_radps, limits.base_speed_mps) * _HAIR).any():
            found.append(f"joint velocity {speed.max():.2f}")
        change = np.abs(q[-1] - 2 * q[-2] + q[-3]) / TICK_S**2
        left_out = np.array_equal(q[-1], q[-2]) or np.array_equal(q[-2], q[-3])
        most = np.where(arm, limits.joint_acceleration_radps2, limits.base_acceleration_mps2)
        if (change > most * _HAIR).any() and not left_out:
            found.append(f"joint acceleration {change.max():.1f}")
        return found

    def _nearest_m(self) -> float:
        apart = self._data.geom_xpos[self._pairs[:, 1]] - self._data.geom_xpos[self._pairs[:, 0]]
        radius = self._model.geom_rbound[self._pairs]
        # the floor has no radius, and every geom may be near it
        near = (np.linalg.norm(apart, axis=1) - radius.sum(axis=1) < 0.05) | (radius[:, 0] == 0)
        return min(
            (self._mj.mj_geomDistance(self._model, self._data, a, b, 0.05, None) for a, b in self._pairs[near]), default=0.05
        )


def pairs_apart(model: Any, data: Any, chain: Any, least_m: float, mj: Any) -> Array:
    """(P, 2) all solid geoms of the robot, and of the robot and the floor, that are apart in its home posture."""
    data.qpos[chain.qpos] = chain.home
    mj.mj_kinematics(model, data)
    solid = [g for g in range(model.ngeom) if model.geom_contype[g]]
    pairs = [(a, b) for i, a in enumerate(solid) for b in solid[i + 1 :]]
    return np.array([pair for pair in pairs if mj.mj_geomDistance(model, data, *pair, 1.0, None) > least_m])


def _most(vectors: Array) -> float:
    return float(np.sqrt((vectors * vectors).sum(axis=-1).max()))
