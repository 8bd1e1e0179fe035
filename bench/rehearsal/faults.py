"""Random sequences of faults through mapping, gate, link, limits and joints, and a judge that knows what is true.

Each sequence begins with an operator whose hand moves the robot, and continues with faults that begin and end at random: frozen,
late, jumping and dead cameras, exchanged people and bodies, hidden limbs, NaN, clocks that jump, a lost network, late or repeated
heartbeats, no state, a robot that does not follow, an operator who walks to the robot or reaches for it. The judge looks at the
true motion of the robot only, at the true time.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from posefuse_teleop.gate import Beat, Pressed
from posefuse_teleop.hands import BODY
from posefuse_teleop.session import OperatorNews, step_operator
from posefuse_teleop.settings import TeleoperationSettings
from posefuse_teleop.values import CameraReport, RobotState

from .judge import Breach, Judge
from .person import Build
from .world import TICK_S, World, settings_for

_LONG_S = 0.5
_WARM_TICKS = 55
# number of worlds from which sequences start; in half of them the operator has approached by up to this distance, and in every
# other pair targets go out of reach
_WORLDS = 32
_NEARER_M = 0.45
# damping of joints that are held, N m s/rad: no drive moves them
_HELD = 1e6
FAULTS = (
    "frozen pose", "late pose", "jumping pose", "dead cameras", "one camera left", "exchanged person", "NaN", "infinite",
    "exchanged sides", "unsure", "pose clock jumps", "gate clock jumps", "gate stalls", "lost network", "late network",
    "late heartbeats", "repeated heartbeats", "no heartbeats", "no robot state", "robot state not finite", "order not finite",
    "huge hand motion", "operator walks", "robot process late", "exchanged body", "hidden limbs", "operator reaches",
    "robot blocked",
)  # fmt: skip


@dataclass(frozen=True)
class Fault:
    """A fault and when it is there, s."""

    kind: str
    start_s: float
    end_s: float


def faults_of(rng: np.random.Generator, seconds: float) -> list[Fault]:
    """One to four faults."""
    found = []
    for kind in rng.choice(FAULTS, size=rng.integers(1, 5), replace=False):
        start_s = float(rng.uniform(0.0, 0.5 * seconds))
        found.append(Fault(str(kind), start_s, start_s + float(rng.uniform(0.01, 0.7 * seconds))))
    return found


def tick(world: World, active: set[str]) -> None:
    """One control period of both sides under the active faults."""
    rng = world.rng
    world.t_s += TICK_S
    world.seq += 1
    world.step_person("operator walks" in active, "operator reaches" in active)
    _change_body(world, active)
    now_ns, gate_ns = world.now_ns, world.now_ns
    if "gate clock jumps" in active:
        gate_ns += world.clock_ns
    if "gate stalls" not in active or rng.random() < 0.05:
        news = _news(world, active, now_ns)
        world.operator, order = step_operator(world.operator, news, gate_ns, world.settings)
        if order is not None:
            if "order not finite" in active:
                order = replace(order, xyz_world=order.xyz_world * rng.choice([np.nan, np.inf, 1e300]))
            delay_s = float(rng.uniform(0, 0.3)) if "late network" in active else 0.0
            if "lost network" not in active:
                world.waiting.append((world.t_s + delay_s, order))
    if "robot process late" not in active or rng.random() < 0.5:
        # the robot's process has a clock of its own, that of the machine
        due = [order for due_s, order in world.waiting if due_s <= world.t_s]
        world.reached_s = world.t_s if due else world.reached_s
        world.waiting = deque(entry for entry in world.waiting if entry[0] > world.t_s)
        _step_robot(world, due, "robot blocked" in active)
    else:
        world.left_out += 1
        world.idle()


def _step_robot(world: World, due: list[Any], blocked: bool) -> None:
    world.blocked = blocked and hasattr(world.robot, "joints")
    # held within the physics, as by a brake that does not open
    damping = world.robot.model.dof_damping if world.blocked else np.zeros(0)
    own = damping.copy()
    damping[:] = _HELD
    world.state = world.driver.step(due, world.now_ns, late=world.left_out, left_out=world.left_out)
    damping[:] = own
    world.left_out = 0


def _change_body(world: World, active: set[str]) -> None:
    """Another body comes in the place of the operator's, and stays; limbs are hidden while the fault lasts."""
    rng = world.rng
    if "exchanged body" in active and world.exchanged_s is None:
        angle, far = rng.uniform(0, 2 * np.pi), rng.uniform(0.6, 1.5)
        away = (-abs(far * np.cos(angle)), far * np.sin(angle), 0.0)
        world.build = Build(size=float(rng.uniform(0.85, 1.1)), away_m=tuple(map(float, away)))
        world.exchanged_s = world.t_s
    if "hidden limbs" not in active:
        world.gone = ()
    elif not world.gone:
        world.gone = tuple(np.flatnonzero(rng.random(len(BODY)) < rng.choice([0.1, 0.4, 0.9])))


def _news(world: World, active: set[str], now_ns: int) -> OperatorNews:
    rng = world.rng
    view = world.view()
    for kind, change in _VIEW_FAULTS.items():
        if kind in active:
            view = change(view, world)
    if "frozen pose" in active:
        world.frozen = view if world.frozen is None else world.frozen
        # a pipeline that hangs behind the tracker continues stamping
        view = replace(world.frozen, t_ns=view.t_ns, measured_ns=view.measured_ns) if rng.random() < 0.5 else world.frozen
    else:
        world.frozen = None
    healthy = 0 if "dead cameras" in active else 1 if "one camera left" in active else 4
    heartbeats = _beats(world, active, now_ns)
    if not heartbeats or heartbeats[-1].seq != world.seq:
        world.released_s = world.t_s
    return OperatorNews(
        view=None if "dead cameras" in active and rng.random() < 0.9 else view,
        pressed=Pressed(heartbeats=heartbeats),
        cameras=CameraReport(t_ns=now_ns, healthy=healthy, total=4),
        robot=_state(world, active),
    )


def _beats(world: World, active: set[str], now_ns: int) -> tuple[Beat, ...]:
    if "no heartbeats" in active:
        return ()
    if "repeated heartbeats" in active:
        return (Beat(seq=world.seq - int(world.rng.integers(0, 30)), sent_ns=now_ns),) * 2
    if "late heartbeats" in active:
        return (Beat(seq=world.seq, sent_ns=now_ns - int(world.rng.integers(0, 400_000_000))),)
    return (Beat(seq=world.seq, sent_ns=now_ns),)


def _state(world: World, active: set[str]) -> RobotState | None:
    if world.state is None or "no robot state" in active:
        return None
    if "robot state not finite" in active:
        return replace(world.state, xyz_world=np.full_like(world.state.xyz_world, np.nan))
    return world.state


_VIEW_FAULTS: dict[str, Callable[[Any, World], Any]] = {
    "late pose": lambda view, world: replace(view, measured_ns=view.measured_ns - int(world.rng.integers(0, 10**9))),
    "jumping pose": lambda view, world: replace(
        view, xyz_world=view.xyz_world + world.rng.normal(size=view.xyz_world.shape) * world.rng.choice([0.02, 0.3, 5.0])
    ),
    "exchanged person": lambda view, world: replace(view, person_id=int(world.rng.integers(1, 4))),
    "NaN": lambda view, world: replace(
        view, xyz_world=np.where(world.rng.random(view.xyz_world.shape) < 0.5, np.nan, view.xyz_world)
    ),
    "infinite": lambda view, world: replace(
        view, xyz_world=np.full_like(view.xyz_world, np.inf), sigma_m=np.full_like(view.sigma_m, np.inf)
    ),
    "exchanged sides": lambda view, world: replace(view, xyz_world=view.other_xyz_world, other_xyz_world=view.xyz_world),
    "unsure": lambda view, world: replace(view, sigma_m=np.abs(world.rng.normal(size=view.sigma_m.shape)) * 0.1),
    "pose clock jumps": lambda view, world: replace(
        view, t_ns=view.t_ns + int(world.rng.choice([-(10**10), -(10**7), 10**7, 10**8, 3600 * 10**9]))
    ),
    "huge hand motion": lambda view, world: replace(view, xyz_world=view.xyz_world + 0.5 * np.sin(25 * world.t_s)),
}


def engaged_world(settings: TeleoperationSettings, seed: int, robot: str = "point") -> World:
    """A world whose robot has just begun to move."""
    world = World(settings, np.random.default_rng([seed, 3]), robot)
    world.t_s = -_WARM_TICKS * TICK_S
    world.walked_m = float(world.rng.uniform(0, _NEARER_M)) if seed % 2 else 0.0
    for k in range(_WARM_TICKS):
        tick(world, {"no heartbeats"} if k < 25 else set())
    return world


@dataclass(kw_only=True)
class Outcome:
    """What sequences did.

    Attributes:
        breaches: what was broken. moved: in how many sequences the robot moved.
    """

    breaches: list[Breach] = field(default_factory=list)
    moved: int = 0

    def add(self, other: Outcome) -> None:
        """Count another outcome in."""
        self.breaches += other.breaches
        self.moved += other.moved


def run_sequence(begin: World, seed: int, limits: TeleoperationSettings | None = None) -> Outcome:
    """One sequence that continues from a world, judged by `limits` (default: its own)."""
    rng = np.random.default_rng([seed, 7])
    world = begin.copied(rng)
    # most are short; the long ones see what takes its time: losses, new engagements, people who walk
    seconds = float(rng.choice([0.15, 1.0], p=[0.9, 0.1]))
    faults, judge = faults_of(rng, seconds), Judge(world, limits or world.settings, seed)
    if seconds > _LONG_S and rng.random() < 0.5:
        faults.append(Fault("operator walks", 0.0, seconds))
    moved = False
    for _ in range(round(seconds / TICK_S)):
        active = {fault.kind for fault in faults if fault.start_s <= world.t_s < fault.end_s}
        if "gate clock jumps" in active and rng.random() < 0.1:
            world.clock_ns = int(rng.choice([-(10**10), -(10**7), 10**7, 2 * 10**8, 10**12]))
        tick(world, active)
        moved = moved or world.driver.follower.moves[0].speed > 0.05
        judge.look(world)
    return Outcome(breaches=judge.breaches, moved=int(moved))


def run_many(
    first: int,
    count: int,
    robot: str = "point",
    settings: TeleoperationSettings | None = None,
    limits: TeleoperationSettings | None = None,
) -> Outcome:
    """Sequences `first` to `first + count - 1`.

    Args:
        robot: one of `robots.STANDS`. settings: of all sequences; None: in half of them targets are out of reach.
        limits: by which they are judged; None: the settings.
    """
    both = [settings or settings_for(robot, roomy) for roomy in (False, True)]
    worlds = [engaged_world(both[seed // 2 % 2], seed, robot) for seed in range(min(count, _WORLDS))]
    total = Outcome()
    with np.errstate(all="ignore"):
        for seed in range(first, first + count):
            total.add(run_sequence(worlds[seed % len(worlds)], seed, limits))
    return total
