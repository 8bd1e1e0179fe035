"""A judge of the true motion of the robot at the true time."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from posefuse.core.arrays import Array
from posefuse.teleoperation.separation import OperatorBody, remembered, separation_m
from posefuse.teleoperation.settings import SeparationSettings, TeleoperationSettings

from .person import person_view
from .world import TICK_S, World

# the true distance counts as kept while the robot brakes: pose age, watchdog and braking from full speed
REACTION_S = 0.45
# a robot without orders must stand still after this time
STANDING_S = 0.35


@dataclass(frozen=True, kw_only=True)
class Breach:
    """What was broken: sequence, time since its start, and by how much."""

    sequence: int
    t_s: float
    what: str


class Judge:
    """Looks at the true motion of the robot only. breaches: what was broken, in words."""

    def __init__(self, settings: TeleoperationSettings, sequence: int) -> None:
        self._limits, self._stop_m, self._sequence = settings.limits, settings.separation.stop_m, sequence
        self._xyz: deque[Array] = deque(maxlen=3)
        self._exact = SeparationSettings(sigmas=0.0, approach_mps=0.0)
        self._near_s = 0.0
        self.breaches: list[Breach] = []

    def look(self, xyz: Array, world: World) -> None:
        """Judge one more control period."""
        self._xyz.append(xyz)
        limits, t_s = self._limits, world.t_s
        low, high = np.array(limits.box_low_m), np.array(limits.box_high_m)
        if not np.isfinite(xyz).all() or (xyz < low - 1e-9).any() or (xyz > high + 1e-9).any():
            self._note(t_s, f"box {xyz}")
        if len(self._xyz) < 3:
            return
        before, last, now = self._xyz
        speed = float(np.linalg.norm(now - last)) / TICK_S
        if speed > limits.speed_mps * (1 + 1e-6):
            self._note(t_s, f"velocity {speed:.3f} m/s")
        change = float(np.linalg.norm(now - 2 * last + before)) / TICK_S**2
        # a step that was left out by a late process changes the mean velocity of the next
        if change > limits.acceleration_mps2 * (1 + 1e-6) and not self._left_out(now, last, before):
            self._note(t_s, f"acceleration {change:.2f} m/s2")
        silent_s = t_s - world.reached_s
        if silent_s > STANDING_S and speed > 1e-6:
            self._note(t_s, f"watchdog: moves at {speed:.3f} m/s {silent_s:.2f} s after the last order")
        near = world.walked_m > 0 and self._distance_m(world) < self._stop_m
        self._near_s = self._near_s + TICK_S if near else 0.0
        if self._near_s > REACTION_S and speed > 1e-6:
            self._note(t_s, f"separation: moves at {speed:.3f} m/s within {self._stop_m} m for {self._near_s:.2f} s")

    def _left_out(self, now: Array, last: Array, before: Array) -> bool:
        return np.array_equal(now, last) or np.array_equal(last, before)

    def _distance_m(self, world: World) -> float:
        view = person_view(world.hand(world.t_s), world.now_ns, shift_m=world.shift_m)
        body = remembered(OperatorBody.unknown(), view)
        return separation_m(body, world.driver.posture.spheres_world, world.now_ns, self._exact)

    def _note(self, t_s: float, what: str) -> None:
        self.breaches.append(Breach(sequence=self._sequence, t_s=t_s, what=what))
