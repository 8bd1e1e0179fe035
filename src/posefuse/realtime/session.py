"""A live session from sources to outputs: groups started, the beat kept, everything ended again."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import islice
from typing import Any

import numpy as np

from posefuse.core import Pose3D, Rig, Skeleton, SourceError
from posefuse.kinematics import JointTracker
from posefuse.tracking.online import Tracker, build_tracker
from posefuse.tracking.stand_in import made_up_detections

from .assignment import dealt
from .board import Board
from .capture import LiveInput
from .config import LiveConfig
from .fusion import Fusion, build_solve
from .group import GroupPlan
from .joint_centres import Centring
from .outputs import NoOutputs, OutputPlan, OutputProcess
from .processes import Groups
from .provenance import notes_of
from .rig_watch import watching

LEAST_CAMERAS = 2
_LEAD_NS = 300_000_000
_WARM_UP_INSTANTS = 15
Say = Callable[[str], None]


@dataclass
class Finished:
    """What a session leaves behind: figures for tables and reports.

    Attributes:
        fusion: with its latencies and monitor. zero_ns: session time at which recorded sources showed their time 0.
        seconds: how long it ran. outputs: per way out, what happened to what it was given.
        lost: values there was no room for. trouble: of the outputs. restarts: of camera processes.
        cpu_s: processor time of the fusion process, and of all its children.
        memory_mb: most memory of this process and its camera processes, added up.
        clock_offset_s: by camera, on several machines only; NaN while it is not known.
    """

    fusion: Fusion
    skeleton: Skeleton
    zero_ns: int = 0
    seconds: float = 0.0
    outputs: dict[str, Any] = field(default_factory=dict)
    lost: int = 0
    trouble: str = ""
    restarts: int = 0
    stopped_by: str = ""
    cpu_s: tuple[float, float] = (0.0, 0.0)
    memory_mb: float = 0.0
    clock_offset_s: dict[str, float] = field(default_factory=dict)


def run_live(
    rig: Rig, inputs: Sequence[LiveInput], config: LiveConfig, plan: OutputPlan, duration_s: float | None, say: Say
) -> Finished:
    """Run until the time is over, all sources have ended, or Ctrl-C.

    Raises:
        SourceError: fewer than two cameras, or one that cannot be opened.
        InputError: an output that cannot be opened.
    """
    if len(inputs) < LEAST_CAMERAS:
        raise SourceError(f"expected sources for at least {LEAST_CAMERAS} cameras, got {len(inputs)}; see --source")
    rig = rig.only(entry.camera for entry in inputs)
    plan = replace(plan, rig=rig, notes=notes_of(rig, config))
    board = new_board(rig)
    outputs = NoOutputs() if plan.empty else OutputProcess(plan)
    try:
        with Groups(group_plans(rig, inputs, config, plan), board) as groups, watching(rig, clocks=False) as watch:
            outputs.wait_ready()
            skeleton = groups.wait_ready()
            say("; ".join([*groups.whereabouts(), *([watch.whereabouts()] if watch else [])]))
            joints = None if plan.empty else ready_joints(skeleton, config)
            tracker, centring = ready_tracker(rig, skeleton, config), Centring(rig.names, config.joint_centres)
            fusion = Fusion(rig, tracker, board, plan.clock, outputs, centring, watch, joints)
            for told in groups.centres():
                fusion.take(told)
            done = Finished(fusion, skeleton)
            with stop_requests() as stopped:
                done.zero_ns = _run(fusion, groups, config, duration_s, stopped, say)
            done.restarts, done.memory_mb = groups.restarts, groups.memory_mb()
            done.stopped_by = stopped[0] if stopped else ""
    finally:
        outputs.close()
    times = os.times()
    done.cpu_s = (times.user + times.system, times.children_user + times.children_system)
    done.seconds = (plan.clock.now_ns() - done.zero_ns) / 1e9
    done.outputs, done.lost, done.trouble = outputs.figures, outputs.lost, outputs.trouble
    return done


def _run(fusion: Fusion, groups: Groups, config: LiveConfig, duration_s: float | None, stopped: list[str], say: Say) -> int:
    zero_ns = time.monotonic_ns() + _LEAD_NS
    groups.begin(zero_ns)
    zero_session_ns = zero_ns + fusion.clock.offset_ns
    end_ns = None if duration_s is None else zero_session_ns + round(duration_s * 1e9)
    news = News(fusion, zero_session_ns, say)

    def until(now_ns: int) -> bool:
        news.tell(now_ns)
        over = end_ns is not None and now_ns >= end_ns
        return over or bool(stopped) or fusion.monitor.all_ended()

    with favoured():
        fusion.run(groups, config.rate_hz, until)
    return zero_session_ns


class News:
    """Says at once what changes; times are told from `zero_ns`."""

    def __init__(self, fusion: Fusion, zero_ns: int, say: Say) -> None:
        self._fusion, self._zero_ns, self._say = fusion, zero_ns, say
        self._told, self._trouble = 0, ""

    def tell(self, now_ns: int) -> None:
        """Whatever has not been told yet."""
        monitor, watch = self._fusion.monitor, self._fusion.watch
        new = min(monitor.event_count - self._told, len(monitor.events))
        self._told = monitor.event_count
        for event in islice(monitor.events, len(monitor.events) - new, None):
            self._say_at(event.t_ns, f"camera {event.camera}: {event.state}{': ' + event.text if event.text else ''}")
        if watch is not None and watch.trouble != self._trouble:
            self._trouble = watch.trouble
            self._say_at(now_ns, f"rig watch: {watch.trouble}")

    def _say_at(self, t_ns: int, words: str) -> None:
        self._say(f"{(t_ns - self._zero_ns) / 1e9:6.2f} s  {words}")


@contextmanager
def favoured() -> Iterator[None]:
    """The beat comes first on a busy machine, where the system allows it; processes started from here do not inherit it."""
    try:
        before = os.sched_getscheduler(0), os.sched_getparam(0)
        os.sched_setscheduler(0, os.SCHED_RR | os.SCHED_RESET_ON_FORK, os.sched_param(1))
    except (OSError, AttributeError):
        yield
        return
    try:
        yield
    finally:
        os.sched_setscheduler(0, *before)


def group_plans(rig: Rig, inputs: Sequence[LiveInput], config: LiveConfig, plan: OutputPlan) -> list[GroupPlan]:
    """Cameras dealt out to groups, see `dealing`."""
    cores = len(os.sched_getaffinity(0))
    count = config.groups or max(1, min(cores, len(inputs) // 2))
    count = min(count, len(inputs))
    detector = config.detector
    if detector.name == "blazepose":
        streams = max(1, cores // count)
        detector = replace(detector, options={"streams": streams, **detector.options})
    by_name = {entry.camera: entry for entry in inputs}
    return [
        GroupPlan(
            group, rig, tuple(by_name[name] for name in cameras), detector, plan.clock, config.track.max_people,
            config.search_every_s, config.preview_hz if plan.view or plan.ros else 0.0,
        )
        for group, cameras in enumerate(dealt(rig, list(by_name), count))
    ]  # fmt: skip


def ready_tracker(rig: Rig, skeleton: Skeleton, config: LiveConfig) -> Tracker:
    """A tracker whose kernels are compiled: one made for the purpose has already seen a made-up person."""
    solve = build_solve(rig, replace(config.associate, max_people=config.track.max_people), config.fuse)
    warm_tracker(build_tracker(rig, skeleton, config.track, solve), rig, skeleton)
    return build_tracker(rig, skeleton, config.track, solve)


def ready_joints(skeleton: Skeleton, config: LiveConfig) -> JointTracker | None:
    """Joint angles for outputs, their kernels compiled; None where none are wanted."""
    if not config.angles:
        return None
    k = len(skeleton)
    xyz, cov = np.random.default_rng(0).normal(size=(1, k, 3)), np.tile(np.eye(3) * 1e-4, (1, k, 1, 1))
    made_up = Pose3D(10**15, skeleton, np.zeros(1), xyz, cov, np.ones((1, k)), np.full((1, k), 3), np.ones((1, k)))
    JointTracker(skeleton, config.joints).step(made_up)
    return JointTracker(skeleton, config.joints)


def warm_tracker(tracker: Tracker, rig: Rig, skeleton: Skeleton) -> None:
    """Show it a made-up person in front of the cameras for a moment."""
    for detections in made_up_detections(rig, skeleton, _WARM_UP_INSTANTS, start_ns=10**15):
        for view in detections:
            tracker.add(view)
            tracker.at(view.t_ns + 20_000_000)


def new_board(rig: Rig) -> Board:
    """An empty board for all cameras of the rig."""
    import multiprocessing

    return Board(multiprocessing.get_context("spawn"), len(rig))


@contextmanager
def stop_requests() -> Iterator[list[str]]:
    """A list that stays empty until Ctrl-C or a request to terminate; a second one interrupts as usual."""
    stopped: list[str] = []

    def note(number: int, frame: Any) -> None:
        if stopped:
            raise KeyboardInterrupt
        stopped.append(signal.Signals(number).name)

    before = {number: signal.signal(number, note) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield stopped
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
