"""`posefuse live --body off` and `--body on` side by side, on rendered people with the default network's own errors.

    python bench/live_body.py --keep DIR [--seeds 7300 7301] [--rows walk idle] [--session DIR]
    python bench/live_body.py --time [--runs 5]

Scenes and arrivals are those of `bench/live_rendered.py` (which see), views 20 to 60 ms late, from 1.5 s on: before, a
skeleton is still learnt. By row: mean error of 12 joints at output time; NEES, 3 where the stated covariance is honest; the
share of joints that came out; the standard deviation over time of the lengths of arms and legs; the largest distance between
two places of a foot that in truth stands, over all of the stance and without its first 0.2 s, in which no causal tracker
knows of it. ``--time`` measures what the fit adds to an output tick, per person, for 4 and 8 cameras: median over ticks, over
those in which lengths are learnt or refined, and the dearest of all; median of runs, in processor time.
"""

import os
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from bodies import MOVES, Trial, trial_session
from body_figures import skate_mm
from harness import OUT, Use, answer, arguments, covariances, errors, medians, scene_from, score
from scenes import circle, view_of

from posefuse.core import Pose3D, PoseSequence, Truth
from posefuse.core.joint_centres import SEGMENT_ENDS
from posefuse.core.skeleton import ANATOMICAL23
from posefuse.realtime.config import LiveConfig
from posefuse.realtime.estimator import warmed_up
from posefuse_sim.build import live_scene

WAYS = ("off", "on")
BONES = [
    [end.format(side=side) for end in SEGMENT_ENDS[bone]]
    for side in ("left", "right")
    for bone in ("upper_arm", "forearm", "thigh", "shank")
]
LATER_S = 0.2
# by then the first lengths are learnt; before, both ways give the same
LEARNT_S = 1.5


def figures(poses: list[Pose3D], truth: Truth) -> dict[str, float]:
    skeleton, xyz = poses[0].skeleton, np.array([pose.xyz_world[0] for pose in poses])
    lengths = [np.linalg.norm(xyz[:, skeleton.index(a)] - xyz[:, skeleton.index(b)], axis=-1) for a, b in BONES]
    found, sequence = score(errors(poses, truth), covariances(poses)), PoseSequence.from_poses(poses)
    return {
        **{name: found[name] for name in ("mean_mm", "nees", "found")},
        "lengths_sd_mm": 1000 * float(np.nanmean(np.nanstd(lengths, axis=1))),
        "slide_mm": skate_mm(sequence, truth),
        "slide_later_mm": skate_mm(sequence, truth, after_s=LATER_S),
    }


def measured(session: Path, seed: int, body: str) -> dict[str, float]:
    trial = Trial.of(session, "late", seed)
    begin_ns = int(trial.truth.t_ns[0]) + round(1e9 * LEARNT_S)
    return figures([pose for pose in trial.poses(replace(LiveConfig(), body=body)) if pose.t_ns >= begin_ns], trial.truth)


def spent_ms(cameras: int, seconds: float = 6.0) -> dict[str, float]:
    """What the fit of one person who walks takes in an output tick: the usual, where lengths are learnt, and at most."""
    content = {"duration_s": seconds, "cameras": {"kind": "ring", "count": cameras}, "people": [{"motion": circle(1.4)}]}
    scene = live_scene(scene_from(content))
    config = replace(LiveConfig(), body="on")
    estimator = warmed_up(scene.rig, ANATOMICAL23, config)
    tracker, bodies = estimator.tracker, estimator.bodies
    rng, spent, learns = np.random.default_rng(0), [], []
    for tick in range(round(100 * seconds)):
        t_s = 0.01 * tick
        # a third of the cameras has a new frame at each output tick
        for c in range(tick % 3, cameras, 3):
            xy = scene.rig.cameras[c].project(scene.keypoints(np.array([t_s]))[0, 0])
            xy = xy + rng.normal(0, 2.0, (1, *xy.shape))[0]
            tracker.add(view_of(scene.rig.names[c], round(1e9 * t_s), ANATOMICAL23, xy, 1.8))
        pose = tracker.at(round(1e9 * (t_s + 0.04)))
        lengths, begun_s = bodies.lengths, time.process_time()
        bodies.step(tracker, pose)
        spent.append(1000 * (time.process_time() - begun_s))
        learns.append(any(new is not lengths.get(person) for person, new in bodies.lengths.items()))
    # one tick in three fits rays: the mean of three is what a tick takes
    usual = np.array(spent[len(spent) // 2 :])
    groups = usual[: len(usual) // 3 * 3].reshape(-1, 3).mean(axis=1)
    return {"tick": float(np.median(groups)), "learning": float(np.median(np.array(spent)[learns])), "dearest": max(spent)}


def main() -> None:
    args = arguments(
        __doc__, keep=OUT / "scenes", seeds=(7300, 7301), rows=dict.fromkeys(MOVES), session=Path, time=False, runs=5
    )
    if args.time:
        rows = [{"cameras": n, **medians([spent_ms(n) for _ in range(args.runs)])} for n in (4, 8)]
        answer(args, {"ms per person": rows}, load=os.getloadavg()[0])
        return
    rows, each = [], []
    for row in [*args.rows, *([args.session] if args.session else [])]:
        for body in WAYS:
            seeds = [0] if row is args.session else args.seeds
            found = [measured(row if row is args.session else trial_session(args.keep, row, seed, Use.DEVELOP), seed, body)
                     for seed in seeds]  # fmt: skip
            about = {"motion": getattr(row, "name", row), "body": body}
            each += [{**about, "seed": seed, **one} for seed, one in zip(seeds, found, strict=True)]
            rows.append({**about, **medians(found, np.nanmean)})
    answer(args, {"Each body": each, "Means": rows})


if __name__ == "__main__":
    main()
