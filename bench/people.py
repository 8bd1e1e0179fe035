"""Several people who keep their identity: recorded and live tracking of simulated crowds whose identities are exact.

    python bench/people.py [--reported] [--only crossing] [--kept FOLDER]

2, 4 and 6 people; 4 and 8 cameras on a ring; walking, crossing, standing close, hugging, behind furniture, leaving and returning
elsewhere. The 2D keypoints are exact ones with the real network's error statistics, confusions and duplicates
(`crowd_scenes.Network`); nothing is rendered. Development uses bodies and scenes of seed 11, reported figures (`--reported`)
those of seed 47. A result is a person when it is less than 0.5 m from it (mean over keypoints), which is also where the
similarity of HOTA ends. A table on stderr, one JSON object on stdout.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from crowd_scenes import CASES, DEVELOPMENT_SEED, RATE_HZ, REPORTED_SEED, Crowd, Network, crowd
from rich.console import Console
from rich.table import Table

from posefuse.association import AssociateSettings
from posefuse.core import Pose3D
from posefuse.core.skeleton import PAPER14, pick_keypoints
from posefuse.evaluation.crowds import crowd_figures, frame_matches, person_distances, returned_right
from posefuse.fusion import FuseSettings
from posefuse.pipeline.clock import StageClock
from posefuse.pipeline.following import Follower
from posefuse.realtime.fusion import build_solve
from posefuse.realtime.identity import NamedTracker
from posefuse.tracking.online import LiveSettings, build_tracker

SEARCH_EVERY_S = 1.0
# away for a second is gone; then the id is read after half a second, over as much
AWAY, SETTLED = round(RATE_HZ), round(RATE_HZ / 2)


def recorded(made: Crowd, network: Network, people: int) -> tuple[list[Pose3D], list[float]]:
    """Poses of the first pass, and the seconds of each time step outside the network."""
    clock = StageClock()
    settings = AssociateSettings(max_people=people)
    follower = Follower(skeleton=network.skeleton, rig=network.rig, associating=settings, fusing=FuseSettings(), clock=clock)
    followed, spent = [], [0.0]
    for one in follower.follow(network.steps()):
        followed.append(one)
        spent.append(clock.seconds["fuse"])
    return [one.pose for one in follower.identified(followed)], np.diff(spent).tolist()


def live(made: Crowd, network: Network, people: int) -> tuple[list[Pose3D], list[float]]:
    """Poses at every frame, and the seconds of each frame's views in the tracker."""
    solve = build_solve(network.rig, AssociateSettings(max_people=people), FuseSettings())
    settings = LiveSettings(max_people=people)
    tracker = NamedTracker(build_tracker(network.rig, network.skeleton, settings, solve), settings)
    poses, spent = [], []
    searched_s = np.full(len(network.rig), -1e9)
    expected = np.zeros((0, len(network.skeleton), 3))
    for i, t_ns in enumerate(network.t_ns):
        views = []
        for c in range(len(network.rig)):
            due = len(expected) < people and t_ns / 1e9 - searched_s[c] >= SEARCH_EVERY_S
            searched_s[c] = t_ns / 1e9 if due else searched_s[c]
            found = network.look(i, c, None if due or not len(expected) else network.regions(c, expected))
            views.append(found)
        began = time.perf_counter()
        for view in views:
            tracker.add(view)
        pose = tracker.at(int(t_ns))
        spent.append(time.perf_counter() - began)
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
    parser.add_argument("--only", help="one kind of scene")
    parser.add_argument("--how", choices=("recorded", "live"), action="append")
    kept = Path(tempfile.gettempdir()) / "posefuse_crowds"
    parser.add_argument("--kept", type=Path, default=kept, help="where scenes are kept between runs")
    args = parser.parse_args()
    seed = REPORTED_SEED if args.reported else DEVELOPMENT_SEED
    rows = []
    for kind, people, cameras in CASES:
        if args.only and args.only != kind:
            continue
        made = crowd(kind, people, cameras, seed, args.kept)
        for how in args.how or ("recorded", "live"):
            poses, spent = {"recorded": recorded, "live": live}[how](made, Network(made.truth, seed), people)
            rows.append({"scene": kind, "people": people, "cameras": cameras, "how": how, **figures_of(made, poses, spent)})
            print(json.dumps(rows[-1]), file=sys.stderr, flush=True)
    show(rows)
    print(json.dumps({"seed": seed, "load": os.getloadavg()[0], "cases": rows}, indent=1))


def show(rows: list[dict]) -> None:
    table = Table(title="Several people")
    names = ("idf1", "hota", "switches", "switches_per_min", "missed", "false", "mpjpe_mm", "ids", "median_ms", "p99_ms")
    for name in ("scene", "how", *names, "returns"):
        table.add_column(name, justify="left" if name in ("scene", "how") else "right")
    for row in rows:
        figures = [f"{row[name]:.3f}" if name in ("idf1", "hota", "missed", "false") else f"{row[name]:.3g}" for name in names]
        scene, returns = f"{row['scene']} {row['people']}x{row['cameras']}", f"{row['returns_right']}/{row['returns']}"
        table.add_row(scene, row["how"], *figures, returns)
    for how in sorted({row["how"] for row in rows}):
        mine = [row for row in rows if row["how"] == how]
        figures = [f"{np.mean([row[name] for row in mine]):.3f}" for name in names]
        figures[3] = f"{sum(r['switches'] for r in mine) / sum(r['person_s'] for r in mine) * 60:.2f}"
        table.add_row("all", how, *figures, f"{sum(r['returns_right'] for r in mine)}/{sum(r['returns'] for r in mine)}")
    Console(stderr=True, width=160).print(table)


if __name__ == "__main__":
    main()
