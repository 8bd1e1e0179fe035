"""Figures of docs/evidence/teleoperation.md, which explains each step; tables on stderr, one JSON object on stdout.

    python bench/teleoperation.py faults [--robot own] [--first 0] [--count 20000] [--workers 2]    ends with 1 if any is breached
    python bench/teleoperation.py follow
    python bench/teleoperation.py boxes [--seeds 3]
    python bench/teleoperation.py live --session FOLDER [--networks NAME]
    python bench/teleoperation.py kill [--repeats 5]

faults, follow and boxes run in simulated time, so that the load of the machine does not matter. FOLDER is a session of
`posefuse simulate` of examples/scenes/operator.yaml.
"""

from __future__ import annotations

import multiprocessing
import sys
import time
from argparse import Namespace
from collections import Counter
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from harness import Row, answer, arguments, truth_of
from rehearsal.boxes import move_boxes
from rehearsal.faults import Outcome, run_many
from rehearsal.figures import jitter_m, lag_and_rms, rms_jerk, spectral_arc_length
from rehearsal.killed import OF_OPERATOR, Held, of_operator
from rehearsal.operator import RATE_HZ, MadeUpHand, operated
from rehearsal.person import HandPath, sine
from rehearsal.robots import with_joints

import posefuse as pf
from posefuse.core import Truth
from posefuse.core.skeleton import pick_keypoints
from posefuse_teleop.follower import Driver
from posefuse_teleop.gate import Beat
from posefuse_teleop.settings import RobotSettings, TeleoperationSettings
from posefuse_teleop.values import Phase

Tables = dict[str, list[Row]]
SETTINGS = TeleoperationSettings(robot=RobotSettings(position_xy_m=(2.5, 0.0)))
NOISE_MM = (0.0, 5.0, 10.0, 20.0)
# of a synthetic hand: largest speed in m/s, and noise in mm
HANDS = ((0.1, 0.0), (0.3, 0.0), (0.5, 0.0), (0.3, 2.0), (0.3, 5.0))
# the hand rests before it follows its path; the robot is at rest in the middle of that
_REST_S, _PATH_S = 6.0, 16.0


def faults(args: Namespace) -> Tables:
    """Random fault sequences through mapping, gate, link and limits."""
    total, share = Outcome(), max(1, args.count // 500)
    parts = [(int(part[0]), len(part), args.robot) for part in np.array_split(args.first + np.arange(args.count), share)]
    with multiprocessing.get_context("spawn").Pool(args.workers) as pool:
        for outcome in pool.starmap(run_many, parts, chunksize=1):
            total.add(outcome)
    kinds = Counter(" ".join(breach.what.split()[:2]) for breach in total.breaches)
    row = {
        "robot": args.robot,
        "first": args.first,
        "sequences": args.count,
        "breaches": len(total.breaches),
        "kinds": dict(kinds),
    }
    first = [asdict(breach) for breach in total.breaches[:10]]
    return {"Fault sequences": [{**row, "moved in": total.moved}], "First breaches": first}


def smooth(path: np.ndarray, name: str = "") -> Row:
    return {f"{name}sparc": spectral_arc_length(path, RATE_HZ), f"{name}jerk_m_s3": rms_jerk(path, RATE_HZ)}


def lag(hand: np.ndarray, path: np.ndarray) -> Row:
    lag_s, rms_m = lag_and_rms(hand, path, RATE_HZ)
    return {"lag_ms": 1e3 * lag_s, "rms_mm": 1e3 * rms_m}


def follow(args: Namespace) -> Tables:
    """How well the robot follows a synthetic hand."""
    about = [{"m/s": speed, "noise_mm": noise_mm} for speed, noise_mm in HANDS]
    return {"Following": [{**one, **followed(sine(one["m/s"]), 1e-3 * one["noise_mm"])} for one in about]}


def followed(path: HandPath, noise_m: float) -> Row:
    made, hand = with_joints(SETTINGS), MadeUpHand(noise_m, seed=1)
    hands, measured, robot, steps = [], [], [], (0.0, 0.0)

    def look(k: int, now_ns: int) -> tuple[Any, tuple[Beat, ...]]:
        hands.append(path(max(k / RATE_HZ - _REST_S, 0.0)))
        view = hand.view(k, hands[-1], now_ns)
        measured.append(hands[-1] + hand.noise)
        return view, (Beat(seq=k, sent_ns=now_ns),) if k > 0.5 * RATE_HZ else ()

    for tick in operated(Driver(made, SETTINGS), SETTINGS, round((_PATH_S + _REST_S) * RATE_HZ), look):
        robot.append(tick.robot.measured_xyz_world[0])
        if tick.operator.gate.phase is Phase.ENGAGED and tick.before.gate.phase is Phase.READY:
            now, before = tick.robot, tick.robot_before
            moved = np.linalg.norm(now.measured_xyz_world - before.measured_xyz_world)
            steps = (1e3 * float(moved), float(np.abs(now.q_rad - before.q_rad).max()))
    counted, standing = slice(round((_REST_S + 1) * RATE_HZ) + 1, None), slice(round(2 * RATE_HZ) + 1, round(_REST_S * RATE_HZ))
    true, seen, followed_ = (np.array(one)[counted] for one in (hands, measured, robot))
    return {
        **lag(true, followed_),
        "jitter_mm": 1e3 * jitter_m(np.array(robot)[standing], RATE_HZ),
        **dict(zip(("step_mm", "step_rad"), steps, strict=True)),
        **smooth(seen, "hand_"), **smooth(followed_, "robot_"),
    }  # fmt: skip


def boxes(args: Namespace) -> Tables:
    """Success, time and path error compared with perfect tracking."""
    rows = []
    for noise_mm in NOISE_MM:
        done = [move_boxes(MadeUpHand(1e-3 * noise_mm, seed)) for seed in range(args.seeds if noise_mm else 1)]
        means = {name: float(np.mean([one[name] for one in done])) for name in ("seconds", "path_rms_mm", "lag_ms")}
        rows.append(
            {"noise_mm": noise_mm, **{name: sum(one[name] for one in done) for name in ("placed", "of", "holds")}, **means}
        )
    return {"Boxes": rows}


def live(args: Namespace) -> Tables:
    """The live pipeline in the loop; the true hand is that of the simulated session."""
    rows, truth = [], truth_of(args.session)

    def watch(operator: Any, order: Any) -> None:
        view, robot = operator.view, operator.robot
        if view is not None and robot is not None:
            places = (view.t_ns, *view.xyz_world[0], robot.sent_ns, *robot.measured_xyz_world[0])
            rows.append((time.monotonic_ns(), *places, view.sigma_m[0], operator.gate.phase == "engaged"))

    cameras = pf.live(args.session / "rig.toml", [f"sim:{args.session}"], networks=args.networks)
    done = pf.teleoperate(cameras, deadman=Held(1.0), settings=SETTINGS, watch=watch, progress=True)
    table, sessions = np.array(rows, float), {"phases": dict(done.ticks), "engaged": done.engagements, "fault": str(done.fault)}
    of_latency, of_sigma = (one if len(one) else [np.nan] for one in (done.latency_ms, 1e3 * table[:, 9]))
    shares = {f"latency_p{share}_ms": float(np.percentile(of_latency, share)) for share in (50, 95)}
    shares |= {f"sigma_p{share}_mm": float(np.nanpercentile(of_sigma, share)) for share in (50, 95)}
    session = {**sessions, "held because": dict(done.reasons.most_common(5)), "commands": len(done.latency_ms), **shares}
    return {"Session": [session], "Compared with the true hand": list(against_truth(table, truth))}


def against_truth(table: np.ndarray, truth: Truth) -> list[Row]:
    """Robot and fused hand, over the longest time engaged; session time 0 is found by the fused hand."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], table[:, -1] > 0, [0]])))
    begin, end = max(edges.reshape(-1, 2), key=lambda pair: pair[1] - pair[0], default=(0, 0))
    part = table[begin:end]
    if end - begin < 1.5 * RATE_HZ:
        return [{"path": "engaged for too short a time", "ticks": int(end - begin)}]
    t_s = np.arange(part[0, 0], part[-1, 0], 1e9 / RATE_HZ) / 1e9
    hand = pick_keypoints(truth.xyz_world[:, 0], truth.skeleton, ["right_wrist"])[:, 0]

    def at(times_ns: np.ndarray, xyz: np.ndarray, zero_s: float = 0.0) -> np.ndarray:
        return np.stack([np.interp(t_s - zero_s, times_ns / 1e9, xyz[:, i]) for i in range(3)], axis=1)

    fused, robot = at(part[:, 1], part[:, 2:5]), at(part[:, 5], part[:, 6:9])
    guesses_s = t_s[0] - np.arange(0.0, truth.t_ns[-1] / 1e9, 0.005)
    tries = [at(truth.t_ns, hand, zero_s) for zero_s in guesses_s]
    true = min(tries, key=lambda one: float((one - fused - (one - fused).mean(axis=0)).std()))
    rows = [{"path": name, **lag(true, path), **smooth(path)} for name, path in (("fused hand", fused), ("robot", robot))]
    slow = np.linalg.norm(np.gradient(true, axis=0), axis=1) * RATE_HZ < 0.01
    rows[1]["jitter_mm"] = 1e3 * jitter_m(robot[slow], RATE_HZ) if slow.sum() > RATE_HZ else None
    return [{"path": "true hand", "seconds": len(t_s) / RATE_HZ, **smooth(true)}, *rows]


def kill(args: Namespace) -> Tables:
    """Real processes, one of which is killed while the robot moves."""
    rows = []
    for fault in OF_OPERATOR:
        times_ms = [of_operator(fault) for _ in range(args.repeats)]
        rows.append({"fault": fault, "median_ms": float(np.median(times_ms)), "worst_ms": max(times_ms)})
    return {"Until the robot stands": rows}


STEPS = {step.__name__: step for step in (faults, follow, boxes, live, kill)}


def main() -> None:
    args = arguments(
        __doc__, positional=("step",), step=str, robot="own", first=0, count=20_000, workers=2, seeds=3,
        networks=str, repeats=5, session=Path,
    )  # fmt: skip
    if args.step not in STEPS:
        raise SystemExit(f"{args.step}: expected one of {', '.join(STEPS)}")
    tables = {title: rows for title, rows in STEPS[args.step](args).items() if rows}
    answer(args, tables, mark=f"teleoperation {args.step}")
    sys.exit("First breaches" in tables)


if __name__ == "__main__":
    main()
