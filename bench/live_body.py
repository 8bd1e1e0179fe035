"""`posefuse live --body off` and `--body on` side by side, on rendered people with the default network's own errors.

    PYTHONPATH=. python bench/live_body.py --keep DIR [--seeds 7300,7301] [--rows walk,idle] [--session DIR]
    PYTHONPATH=. python bench/live_body.py --time [--runs 5]

Scenes and arrivals are those of `bench/live_rendered.py` (which see), views 20 to 60 ms late, from 1.5 s on: before, a
skeleton is still learnt. By row: mean error of 12 joints at output time; NEES, 3 where the stated covariance is honest; the
share of joints that came out; the standard deviation over time of the lengths of arms and legs; the largest distance between
two places of a foot that in truth stands, over all of the stance and without its first 0.2 s, in which no causal tracker
knows of it. ``--time`` measures what the fit adds to an output tick, per person, for 4 and 8 cameras: median over ticks, over
those in which lengths are learnt or refined, and the dearest of all; median of runs, in processor time. Tables on stderr (each
body, means), one JSON object on stdout.
"""

import argparse
import json
import os
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from body_figures import skate_mm
from fit_tracker import JOINTS, Trial, arrivals_of, seen, seen_in, table_of
from rich.console import Console
from rich.table import Table

from posefuse.core import Detections2D, Pose3D, PoseSequence, Recording, Truth
from posefuse.core.joint_centres import SEGMENT_ENDS
from posefuse.core.skeleton import ANATOMICAL23, pick_keypoints
from posefuse.evaluation.metrics import true_xyz_at
from posefuse.foundation.settings import settings_from_mapping
from posefuse.realtime.config import LiveConfig
from posefuse.realtime.estimator import warmed_up
from posefuse.simulation.build import live_scene
from posefuse.simulation.scene import Scene

ROWS = ("idle", "walk", "reach", "squat", "turn", "screen", "false_arm")
WAYS = ("off", "on")
BONES = [
    [end.format(side=side) for end in SEGMENT_ENDS[bone]]
    for side in ("left", "right")
    for bone in ("upper_arm", "forearm", "thigh", "shank")
]
LATER_S = 0.2
# by then the first lengths are learnt; before, both ways give the same
LEARNT_S = 1.5
COLUMNS = ("error mm", "NEES", "joints %", "lengths sd mm", "slide mm", "slide later mm")


def figures(poses: list[Pose3D], truth: Truth) -> tuple[float, ...]:
    """As `COLUMNS`."""
    skeleton = poses[0].skeleton
    xyz = np.array([pose.xyz_world[0] for pose in poses])
    true = true_xyz_at(truth, np.array([pose.t_ns for pose in poses]))[:, 0]
    at = [skeleton.index(name) for name in JOINTS]
    error = xyz[:, at] - pick_keypoints(true, truth.skeleton, JOINTS)
    found = np.isfinite(error).all(axis=-1)
    cov = np.array([pose.cov_world[0, at] for pose in poses])[found]
    nees = np.einsum("ni,nij,nj->n", error[found], np.linalg.inv(cov), error[found]).mean()
    lengths = [np.linalg.norm(xyz[:, skeleton.index(a)] - xyz[:, skeleton.index(b)], axis=-1) for a, b in BONES]
    spread = np.nanmean(np.nanstd(lengths, axis=1))
    sequence = PoseSequence.from_poses(poses)
    slides = (skate_mm(sequence, truth, after_s=after_s) for after_s in (0.0, LATER_S))
    return (1000 * np.linalg.norm(error[found], axis=-1).mean(), nees, 100 * found.mean(), 1000 * spread, *slides)


def measured(recording: Recording, truth: Truth, seed: int) -> dict[str, tuple[float, ...]]:
    """By way."""
    trial = Trial(recording, truth, table_of(recording), arrivals_of(recording, "late", seed))
    begin_ns = int(truth.t_ns[0]) + round(1e9 * LEARNT_S)
    ways = {way: trial.poses(replace(LiveConfig(), body=way)) for way in WAYS}
    return {way: figures([pose for pose in poses if pose.t_ns >= begin_ns], truth) for way, poses in ways.items()}


def spent_ms(cameras: int, seconds: float = 6.0) -> dict[str, float]:
    """What the fit of one person who walks takes in an output tick: the usual, where lengths are learnt, and at most."""
    content = {
        "duration_s": seconds, "cameras": {"kind": "ring", "count": cameras},
        "people": [{"motion": {"kind": "walk", "path": {"shape": "circle", "radius_m": 1.4}, "speed_mps": 1.35}}],
    }  # fmt: skip
    scene = live_scene(settings_from_mapping(content, Scene, "bench"))
    config = replace(LiveConfig(), body="on")
    estimator = warmed_up(scene.rig, ANATOMICAL23, config)
    tracker, bodies = estimator.tracker, estimator.bodies
    rng, spent, learns = np.random.default_rng(0), [], []
    score = np.full((1, len(ANATOMICAL23)), 0.9)
    for tick in range(round(100 * seconds)):
        t_s = 0.01 * tick
        # a third of the cameras has a new frame at each output tick
        for c in range(tick % 3, cameras, 3):
            xy = scene.rig.cameras[c].project(scene.keypoints(np.array([t_s]))[0, 0])
            view = Detections2D(
                camera=scene.rig.names[c], t_ns=round(1e9 * t_s), skeleton=ANATOMICAL23,
                xy_img=xy[None] + rng.normal(0, 2.0, (1, *xy.shape)), score=score, sigma_px=score * 2, box_img=np.zeros((1, 4)),
            )  # fmt: skip
            tracker.add(view)
        pose = tracker.at(round(1e9 * (t_s + 0.04)))
        lengths, begun_s = bodies.lengths, time.process_time()
        bodies.step(tracker, pose)
        spent.append(1000 * (time.process_time() - begun_s))
        learns.append(any(new is not lengths.get(person) for person, new in bodies.lengths.items()))
    # one tick in three fits rays: the mean of three is what a tick takes
    usual = np.array(spent[len(spent) // 2 :])
    groups = usual[: len(usual) // 3 * 3].reshape(-1, 3).mean(axis=1)
    return {"tick": float(np.median(groups)), "learning": float(np.median(np.array(spent)[learns])), "dearest": max(spent)}


def show(rows: dict[str, dict[str, tuple[float, ...]]]) -> None:
    table = Table(title="live, --body off -> on", title_justify="left")
    for column in ("motion", *COLUMNS):
        table.add_column(column)
    for row, ways in rows.items():
        table.add_row(row, *("{:.1f} -> {:.1f}".format(*pair) for pair in zip(*(ways[way] for way in WAYS), strict=True)))
    Console(stderr=True, width=140).print(table)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--keep", type=Path)
    parser.add_argument("--seeds", default="7300,7301", help="of the bodies; the default is of the development")
    parser.add_argument("--rows", default=",".join(ROWS))
    parser.add_argument("--session", type=Path)
    parser.add_argument("--time", action="store_true")
    parser.add_argument("--runs", type=int, default=5)
    args = parser.parse_args()
    if args.time:
        ms = {}
        for cameras in (4, 8):
            runs = [spent_ms(cameras) for _ in range(args.runs)]
            ms[cameras] = {name: float(np.median([run[name] for run in runs])) for name in runs[0]}
        print(json.dumps({"ms_per_person": ms, "load": os.getloadavg()[0]}))
        return
    rows, each = {}, {}
    seeds = [int(seed) for seed in args.seeds.split(",") if seed]
    for row in filter(None, args.rows.split(",")):
        each |= {f"{row} {seed}": measured(*seen(args.keep, row, seed), seed) for seed in seeds}
        bodies = [each[f"{row} {seed}"] for seed in seeds]
        rows[row] = {way: tuple(np.nanmean([body[way] for body in bodies], axis=0).tolist()) for way in WAYS}
    if args.session:
        rows[args.session.name] = each[args.session.name] = measured(*seen_in(args.keep, args.session), seed=0)
    show(each)
    show(rows)
    print(json.dumps({"seeds": seeds, "columns": COLUMNS, "rows": rows}, indent=2))


if __name__ == "__main__":
    main()
