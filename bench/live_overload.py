"""The output of an overloaded session: poses far from the truth, and how many of them state a large uncertainty.

    python bench/live_overload.py [--seconds 60] [--seed 0]

A person walks a circle in front of four cameras; the clip is cut every 4.3 s, as a looped video is. Only every second frame is
used, views are up to 0.3 s old, and every 6 s all cameras but one fall silent for 1.2 s. Poses go out 100 times a second, once
as the tracker makes them and once through the gate of the settings. A hip is impossible where it is more than 0.5 m from
all places of the clip. Table on stderr, one JSON object on stdout.
"""

import argparse
import json
import sys

import numpy as np
from live_tracking import OUTPUT_HZ, WARM_UP_S, Arrival, arrivals, new_tracker, scene_of
from rich.console import Console
from rich.table import Table

from posefuse.core import Pose3D
from posefuse.core.skeleton import ANATOMICAL23
from posefuse.realtime.config import KeypointGateSettings
from posefuse.realtime.gate import KeypointGate
from posefuse.tracking.online import LiveSettings

LATENCY_S, USED = (0.05, 0.3), 0.5
CUT_S, ALONE_EVERY_S, ALONE_S = 4.3, 6.0, 1.2
IMPOSSIBLE_M = 0.5
SIGMAS_M = (0.1, 0.15, 0.3, 1.0)


def overloaded(come: list[Arrival], cameras: int, seed: int) -> list[Arrival]:
    """The views that are left."""
    rng, left = np.random.default_rng(seed), []
    for one in come:
        t_s = one.view.t_ns / 1e9
        only = f"cam{int(t_s / ALONE_EVERY_S) % cameras:02d}" if t_s % ALONE_EVERY_S > ALONE_EVERY_S - ALONE_S else None
        if rng.random() < USED and only in (None, one.view.camera):
            left.append(one)
    return left


def outcome(poses: list[Pose3D], place) -> dict:
    """Shares of hips that are stated unsure, and that are impossible, by what is stated."""
    hips = ANATOMICAL23.indices(("left_hip", "right_hip"))
    clip = place(np.arange(0, CUT_S, 0.02))[:, hips]
    missing = np.full((2, 3), np.nan)
    got = np.array([pose.xyz_world[0, hips] if len(pose.person_id) else missing for pose in poses])
    cov = np.array([pose.cov_world[0, hips] if len(pose.person_id) else np.full((2, 3, 3), np.nan) for pose in poses])
    there = np.isfinite(got[..., 0])
    sigma = np.sqrt(np.trace(cov, axis1=-2, axis2=-1) / 3)[there]
    away = np.linalg.norm(got[:, None] - clip, axis=-1).min(axis=1)[there]
    return {
        "found": float(there.mean()),
        "unsure": {f"{limit:g} m": float((sigma > limit).mean()) for limit in SIGMAS_M},
        "impossible": float((away > IMPOSSIBLE_M).mean()),
        "impossible_of_sure": float((away[sigma < 0.1] > IMPOSSIBLE_M).mean()),
        "p99_m": float(np.percentile(away, 99)),
        "farthest_m": float(away.max()),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    rig, whole = scene_of("walk", 4, args.seconds, args.seed)

    def place(t_s: np.ndarray) -> np.ndarray:
        return whole(np.asarray(t_s) % CUT_S)

    come = overloaded(arrivals(rig, place, args.seconds, args.seed, latency_s=LATENCY_S), len(rig), args.seed)
    tracker, waiting = new_tracker(rig, ANATOMICAL23, LiveSettings()), iter(come)
    gate, made, sent = KeypointGate(KeypointGateSettings()), [], []
    head = next(waiting, None)
    for tick in range(int(args.seconds * OUTPUT_HZ)):
        t_ns = round(tick / OUTPUT_HZ * 1e9)
        while head is not None and head.at_ns <= t_ns:
            tracker.add(head.view)
            head = next(waiting, None)
        pose = tracker.at(t_ns)
        passed = gate.passed(pose)
        if t_ns >= WARM_UP_S * 1e9:
            made.append(pose)
            sent.append(passed)
    figures = {"tracker": outcome(made, place), "sent": outcome(sent, place), "withheld": gate.figures()}
    table = Table(title="Hips of an overloaded session", title_justify="left")
    for column in ("", "there", *(f"sigma > {limit:g} m" for limit in SIGMAS_M), "impossible", "p99 m", "farthest m"):
        table.add_column(column)
    for name in ("tracker", "sent"):
        row = figures[name]
        shares = (row["found"], *row["unsure"].values(), row["impossible"])
        table.add_row(name, *(f"{share:.1%}" for share in shares), f"{row['p99_m']:.2f}", f"{row['farthest_m']:.2f}")
    Console(stderr=True, width=120).print(table)
    print(json.dumps(figures, indent=2))


if __name__ == "__main__":
    sys.exit(main())
