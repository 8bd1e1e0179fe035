"""Sixty sessions without a fault that vary in blur, noise, clocks, coverage, cameras and kind: none may be refused."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from posefuse.calibration.extrinsics.pipeline import Options
from posefuse.calibration.targets.corners import CornerObservations

from .command_cases import GOOD_SESSIONS as RENDERED
from .person_cases import calibrate, person_rig
from .sessions import TIME_STEPS, Session, board_session, prop_session, solve
from .verdict import GOOD, Answer, Case
from .verify_cases import answer, held_board, room
from .walkers import gait_of, watch

_PROPS, _BOARDS, _PERSONS, _VERIFIED = 38, 10, 6, 4


def _varied(session: Session, number: int, seed: int) -> tuple[CornerObservations, str]:
    """One session in its own conditions, and the mode of its clocks."""
    random = np.random.default_rng([seed, number, 5])
    count, clocks = len(session.rig), ("together", "auto", "auto", "offset")[number % 4]
    late = random.uniform(-0.2, 0.2, count) if clocks in ("auto", "offset") and number % 3 else np.zeros(count)
    reach = random.uniform(0.5, 1.0) * np.array(session.motion.reach_m)
    seconds, rate_hz = random.uniform(20, 60), random.choice([10.0, 15.0, 20.0, 30.0])
    motion = replace(session.motion, seconds=float(seconds), rate_hz=float(rate_hz), reach_m=tuple(reach), swings_hz=0.3)
    seen = session.watch(
        motion=motion, noise_px=float(random.uniform(0.04, 0.8)), missed=float(random.uniform(0.02, 0.4)), delay_s=tuple(late)
    )
    return _with_uneven_exposure(session, seen, motion.rate_hz, float(random.uniform(0, 2e-3)), random), clocks


def _with_uneven_exposure(
    session: Session, seen: CornerObservations, rate_hz: float, jitter_s: float, random: np.random.Generator
) -> CornerObservations:
    """Frames stamped some ms from the moment of their exposure, each camera's by itself."""
    key = seen.camera * (1 << 40) + np.round(seen.t_ns * rate_hz / 1e9).astype(np.int64)
    _, frame = np.unique(key, return_inverse=True)
    off_ns = np.round(random.normal(0, jitter_s, frame.max() + 1) * 1e9).astype(np.int64)
    return replace(seen, t_ns=seen.t_ns + off_ns[frame])


def _waved(kind: str, make: Callable[[int, int], Session], counts: tuple[int, ...], number: int) -> Case:
    count = counts[number % len(counts)]

    def run(seed: int) -> Answer:
        session = make(100 * seed + number, count)
        seen, clocks = _varied(session, number, seed)
        return solve(session.rig, seen, session.rig.cameras, session.target, Options(time_steps=TIME_STEPS, clocks=clocks))

    return Case(f"{kind} {number}, {count} cameras", GOOD, "", run)


def _person(number: int) -> Case:
    def run(seed: int) -> Answer:
        truth, gait = person_rig(100 * seed + number), gait_of(100 * seed + number)
        late_s = (0.0, 0.1, -0.05, 0.03) if number % 3 == 2 else ()
        seen = watch(truth, gait, 20.0 + 8 * number, late_s=late_s, noise_px=1.0 + 0.3 * number, seed=seed)
        return calibrate(truth, seen, truth.cameras)

    return Case(f"person {number}", GOOD, "", run)


def _verified(number: int) -> Case:
    def run(seed: int) -> Answer:
        truth = room(100 * seed + number)
        return answer(truth, held_board(truth, seed, noise_px=(0.05, 0.15, 0.4, 0.8)[number % 4]), wrong=False)

    return Case(f"verify {number}", GOOD, "", run)


SESSIONS = (
    *(_waved("prop", prop_session, (2, 3, 4, 5, 6, 8), i) for i in range(_PROPS)),
    *(_waved("board", board_session, (2, 3, 4), i) for i in range(_BOARDS)),
    *(_person(i) for i in range(_PERSONS)),
    *(_verified(i) for i in range(_VERIFIED)),
    *RENDERED,
)
