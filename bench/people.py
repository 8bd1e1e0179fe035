"""Several people who keep their identity: recorded and live tracking of simulated crowds whose identities are exact.

    python bench/people.py [--reported] [--seed 11] [--only crossing] [--how live] [--kept FOLDER]

2, 4 and 6 people; 4 and 8 cameras on a ring; walking, crossing, standing close, hugging, behind furniture, leaving and returning
elsewhere, walking while cameras drop out and come back. The 2D keypoints are exact ones with the real network's error
statistics, confusions and duplicates (`crowd_scenes.Network`), and so are the colours of clothes; nothing is rendered.
Development uses bodies and scenes of seed 11, reported figures (`--reported`) those of other seeds. Times are processor time of
all that is not the network. A result is a person when it is less than 0.5 m from it (mean over keypoints), which is also where
the similarity of HOTA ends. A table on stderr, one JSON object on stdout.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from crowd_scenes import CASES, DEVELOPMENT_SEED, RATE_HZ, REPORTED_SEEDS, Crowd, Network, crowd
from crowds import crowd_figures, frame_matches, person_distances, returned_right
from rich.console import Console
from rich.table import Table

from posefuse.association import AssociateSettings
from posefuse.core import Pose3D
from posefuse.core.skeleton import PAPER14, pick_keypoints
from posefuse.fusion import FuseSettings
from posefuse.pipeline.following import PeopleFollower
from posefuse.realtime.config import LiveConfig
from posefuse.realtime.estimator import build_fuse, build_solve
from posefuse.realtime.identity import NamedTracker
from posefuse.tracking.online import LiveSettings, build_tracker

# away for a second is gone; then the id is read after half a second, over as much
AWAY, SETTLED = round(RATE_HZ), round(RATE_HZ / 2)


def recorded(made: Crowd, network: Network, people: int) -> tuple[list[Pose3D], list[float]]:
    """Poses of the first pass, and the processor seconds of each time step outside the network."""
    settings = AssociateSettings(max_people=people)
    follower = PeopleFollower(skeleton=network.skeleton, rig=network.rig, associating=settings, fusing=FuseSettings())
    followed, spent = [], []
    began, looked = time.thread_time(), network.spent_s
    for one in follower.follow(network.steps()):
        followed.append(one)
        now = time.thread_time()
        spent.append(now - began - (network.spent_s - looked))
        began, looked = now, network.spent_s
    return [one.pose for one in follower.identified(followed)], spent


def live(made: Crowd, network: Network, people: int) -> tuple[list[Pose3D], list[float]]:
    """Poses at every frame, and the processor seconds of each frame's views in the tracker."""
    solve = build_solve(network.rig, AssociateSettings(max_people=people), FuseSettings())
    settings = LiveSettings(max_people=people)
    fuse = build_fuse(network.rig, FuseSettings())
    tracker = NamedTracker(build_tracker(network.rig, network.skeleton, settings, solve, fuse), settings)
    poses, spent = [], []
    searched_s = np.full(len(network.rig), -1e9)
    expected = np.zeros((0, len(network.skeleton), 3))
    for i, t_ns in enumerate(network.t_ns):
        views = []
        for c in range(len(network.rig)):
            due = len(expected) < people and t_ns / 1e9 - searched_s[c] >= LiveConfig().search_every_s
            searched_s[c] = t_ns / 1e9 if due else searched_s[c]
            found = network.look(i, c, None if due or not len(expected) else network.regions(c, expected))
            if network.works(i, c):
                views.append(found)
        began = time.thread_time()
        for view in views:
            tracker.add(view)
        pose = tracker.at(int(t_ns))
        spent.append(time.thread_time() - began)
        expected = tracker.looked_for(int(t_ns)).xyz_world
        expected = expected[np.isfinite(expected).any(axis=(1, 2))]
        poses.append(pose)
    return poses, spent


def figures_of(made: Crowd, poses: list[Pose3D], spent: list[float]) -> dict[str, float]:
    ids = sorted({int(person) for pose in poses for person in pose.person_id})
    xyz = np.full((len(poses), max(len(ids), 1), len(PAPER14.keypoints), 3), np.nan)
    for t, pose in enumerate(poses):
        for row, person in enumerate(pose.person_id):
            xyz[t, ids.index(int(person))] = pick_keypoints(pose.xyz_world[row], pose.skeleton, PAPER14.keypoints)
    # fewer than half of the joints is no person
    there = np.isfinite(xyz[..., 0]).mean(axis=-1) >= 0.5
    xyz[~there] = np.nan
    truth = pick_keypoints(made.truth.xyz_world, made.truth.skeleton, PAPER14.keypoints)
    distance = person_distances(truth, xyz)
    figures = crowd_figures(distance, made.asked, there, RATE_HZ)
    right, returns = returned_right(frame_matches(distance, made.asked), made.asked, AWAY, SETTLED)
    return {
        "idf1": figures.idf1, "hota": figures.hota, "switches": figures.switches,
        "switches_per_min": figures.per_person_minute, "missed": figures.missed, "false": figures.false,
        "mpjpe_mm": figures.mpjpe_mm, "ids": len(ids), "returns": returns, "returns_right": right,
        "median_ms": 1000 * float(np.median(spent)), "p99_ms": 1000 * float(np.quantile(spent, 0.99)),
        "person_s": float(made.asked.sum() / RATE_HZ),
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--reported", action="store_true", help="the scenes nothing was tuned on")
    parser.add_argument("--seed", type=int, action="append", help="these instead")
    parser.add_argument("--only", help="one kind of scene")
    parser.add_argument("--how", choices=("recorded", "live"), action="append")
    kept = Path(tempfile.gettempdir()) / "posefuse_crowds"
    parser.add_argument("--kept", type=Path, default=kept, help="where scenes are kept between runs")
    args = parser.parse_args()
    seeds = REPORTED_SEEDS if args.reported else (DEVELOPMENT_SEED,)
    rows = []
    for seed, (kind, people, cameras) in itertools.product(args.seed or seeds, CASES):
        if args.only and args.only != kind:
            continue
        made = crowd(kind, people, cameras, seed, args.kept)
        for how in args.how or ("recorded", "live"):
            poses, spent = {"recorded": recorded, "live": live}[how](made, Network(made, seed), people)
            about = {"scene": kind, "people": people, "cameras": cameras, "how": how, "seed": seed}
            rows.append({**about, **figures_of(made, poses, spent)})
            print(json.dumps(rows[-1]), file=sys.stderr, flush=True)
    show(rows)
    print(json.dumps({"load": os.getloadavg()[0], "cases": rows}, indent=1))


def show(rows: list[dict]) -> None:
    table = Table(title="Several people")
    names = ("idf1", "hota", "switches", "switches_per_min", "missed", "false", "mpjpe_mm", "ids", "median_ms", "p99_ms")
    for name in ("scene", "how", *names, "returns"):
        table.add_column(name, justify="left" if name in ("scene", "how") else "right")
    cases: dict[tuple, list[dict]] = {}
    for row in rows:
        cases.setdefault((row["scene"], row["people"], row["cameras"], row["how"]), []).append(row)
    for (scene, people, cameras, how), seeds in cases.items():
        # the mean of the seeds; of times, the worst
        figures = [(np.max if name == "p99_ms" else np.mean)([row[name] for row in seeds]) for name in names]
        texts = [
            f"{f:.3f}" if name in ("idf1", "hota", "missed", "false") else f"{f:.3g}"
            for f, name in zip(figures, names, strict=True)
        ]
        returns = f"{sum(r['returns_right'] for r in seeds)}/{sum(r['returns'] for r in seeds)}"
        table.add_row(f"{scene} {people}x{cameras}", how, *texts, returns)
    for how in sorted({row["how"] for row in rows}):
        mine = [row for row in rows if row["how"] == how]
        figures = [f"{np.mean([row[name] for row in mine]):.3f}" for name in names]
        figures[3] = f"{sum(r['switches'] for r in mine) / sum(r['person_s'] for r in mine) * 60:.2f}"
        table.add_row("all", how, *figures, f"{sum(r['returns_right'] for r in mine)}/{sum(r['returns'] for r in mine)}")
    Console(stderr=True, width=160).print(table)


if __name__ == "__main__":
    main()
