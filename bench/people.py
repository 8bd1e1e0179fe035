"""Several people who keep their identity: recorded and live tracking of crowds whose identities are exact.

    python bench/people.py [--reported] [--seed 11] [--only crossing] [--how live] [--kept FOLDER]     simulated keypoints
    python bench/people.py --rendered [--alone] [--seconds 4]       two rendered people who cross at 0.28 m, and each alone
    python bench/people.py --played [--networks auto]               the same two, played to `posefuse live`

2, 4 and 6 people; 4 and 8 cameras on a ring; crossing, hugging, leaving and returning elsewhere. The 2D keypoints are exact ones
with the real network's error statistics, confusions and duplicates (`crowd_scenes.Network`), and so are the colours of clothes;
nothing is rendered. Development uses bodies and scenes of seed 11, reported figures (`--reported`) those of other seeds. Times
are processor time of all that is not the network. A result is a person when it is less than 0.5 m from it (mean over
keypoints), which is also where the similarity of HOTA ends. Rendered people are seen by five cameras and the bundled network;
FOLDER keeps them. Tables on stderr (means of seeds; of times, the worst), one JSON
object on stdout.
"""

from __future__ import annotations

import itertools
import json
import os
import tempfile
import time
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from crowd_scenes import CASES, DEVELOPMENT_SEED, RATE_HZ, REPORTED_SEEDS, Crowd, Network, crowd
from crowds import crowd_row, person_distances
from harness import Row, answer, arguments, live_recording, medians, note, rendered, scene_from, tracked, truth_of
from scenes import OUTPUT_HZ, new_tracker, walk

from posefuse.association import AssociateSettings, with_persons
from posefuse.core import Pose3D, PoseSequence, Truth
from posefuse.core.skeleton import PAPER14, pick_keypoints
from posefuse.evaluation.metrics import true_xyz_at
from posefuse.fusion import FuseSettings
from posefuse.pipeline.following import PeopleFollower
from posefuse.realtime.config import LiveConfig
from posefuse.realtime.estimator import NamedTracker
from posefuse.tracking.online import LiveSettings

KEPT = Path(tempfile.gettempdir()) / "posefuse_crowds"
# of two rendered people: where they walk to and fro
PATHS = (((-1.6, -0.14), (1.6, -0.14)), ((1.6, 0.14), (-1.6, 0.14)))
SHOWN = (
    "idf1", "hota", "switches", "per_person_minute", "missed", "false", "mpjpe_mm", "ids", "returns_right",
    "returns", "median_ms",
)  # fmt: skip


def recorded(network: Network, people: int) -> tuple[list[Pose3D], list[float]]:
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
    return [_with_people(one.pose, follower) for one in followed], spent


def _with_people(pose: Pose3D, follower: PeopleFollower) -> Pose3D:
    """People instead of tracks, by all that is known at the end."""
    people = follower.people_of(pose.person_id, np.full(len(pose.person_id), pose.t_ns))
    return with_persons(pose, people.tolist())


def live(network: Network, people: int) -> tuple[list[Pose3D], list[float]]:
    """Poses at every frame, and the processor seconds of each frame's views in the tracker."""
    tracker = NamedTracker(new_tracker(network.rig, network.skeleton, people=people), LiveSettings(max_people=people))
    poses, spent = [], []
    searched_s = np.full(len(network.rig), -1e9)
    expected = np.zeros((0, len(network.skeleton), 3))
    for i, t_ns in enumerate(network.t_ns):
        views = []
        for c in range(len(network.rig)):
            due = len(expected) < people and t_ns / 1e9 - searched_s[c] >= LiveConfig().search_every_s
            searched_s[c] = t_ns / 1e9 if due else searched_s[c]
            views.append(network.look(i, c, None if due or not len(expected) else network.regions(c, expected)))
        began = time.thread_time()
        for view in views:
            tracker.add(view)
        poses.append(tracker.at(int(t_ns)))
        spent.append(time.thread_time() - began)
        expected = tracker.looked_for(int(t_ns)).xyz_world
        expected = expected[np.isfinite(expected).any(axis=(1, 2))]
    return poses, spent


HOW = {"recorded": recorded, "live": live}


def compared(poses: PoseSequence, true_xyz: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distances (T, N, M) from the true keypoints (T, N, 14, 3), and (T, M) which results there are."""
    xyz = pick_keypoints(poses.xyz_world, poses.skeleton, PAPER14.keypoints)
    # fewer than half of the joints is no person
    there = np.isfinite(xyz[..., 0]).mean(axis=-1) >= 0.5
    return person_distances(true_xyz, np.where(there[..., None, None], xyz, np.nan)), there


def figures_of(made: Crowd, poses: list[Pose3D], spent: list[float]) -> dict[str, float]:
    found = PoseSequence.from_poses(poses)
    distance, there = compared(found, pick_keypoints(made.truth.xyz_world, made.truth.skeleton, PAPER14.keypoints))
    times = {"median_ms": 1000 * float(np.median(spent)), "p99_ms": 1000 * float(np.quantile(spent, 0.99))}
    about = {"ids": len(found.person_id), **times, "person_s": float(made.asked.sum() / RATE_HZ)}
    return {**crowd_row(distance, made.asked, there, RATE_HZ), **about}


def mean_of(rows: list[dict], scene: str, how: str) -> dict:
    """Of some cases; returns are summed up."""
    row = medians([{name: one[name] for name in SHOWN} for one in rows], np.mean)
    row |= {name: sum(one[name] for one in rows) for name in ("returns_right", "returns")}
    row["per_person_minute"] = sum(one["switches"] for one in rows) / sum(one["person_s"] for one in rows) * 60
    return {"scene": scene, "how": how, **row, "p99_ms": max(one["p99_ms"] for one in rows)}


def means(rows: list[dict]) -> Iterable[dict]:
    cases = [f"{row['scene']} {row['people']}x{row['cameras']}" for row in rows]
    for case, how in itertools.product([*dict.fromkeys(cases), "all"], dict.fromkeys(row["how"] for row in rows)):
        mine = [row for row, name in zip(rows, cases, strict=True) if case in (name, "all") and row["how"] == how]
        yield mean_of(mine, case, how)


def crossing(people: tuple[int, ...], seconds: float, folder: Path) -> Path:
    """The rendered session of one person or both."""
    persons = [
        {
            "body": {"random_seed": 4700 + n},
            "motion": walk({"shape": "back_forth", "start_m": PATHS[n][0], "end_m": PATHS[n][1]}, 1.2),
        }
        for n in people
    ]
    cameras = {"kind": "ring", "count": 5, "radius_m": 4.5, "height_m": 2.2, "image": {"horizontal_fov_deg": 65.0}}
    scene = scene_from({"duration_s": seconds, "rate_hz": RATE_HZ, "seed": 47, "cameras": cameras, "people": persons})
    return rendered(scene, folder / f"{'_'.join(map(str, people))}-{seconds:g}s", processes=None)


def row_of(poses: PoseSequence, truth: Truth, rate_hz: float) -> Row:
    """Of a session's poses; all who are in the room count."""
    true_xyz = pick_keypoints(true_xyz_at(truth, poses.t_ns), truth.skeleton, PAPER14.keypoints)
    asked, (distance, there) = np.isfinite(true_xyz[..., 0]).all(axis=-1), compared(poses, true_xyz)
    everybody = float((there.sum(axis=1) >= asked.sum(axis=1)).mean())
    return {"everybody_share": everybody, **crowd_row(distance, asked, there, rate_hz)}


def rendered_row(people: tuple[int, ...], seconds: float, kept: Path) -> Row:
    session = crossing(people, seconds, kept)
    poses = tracked(session, associate__max_people=len(people)).poses
    return {"people": str(people), "steps": len(poses), **row_of(poses, truth_of(session), RATE_HZ)}


def played_row(session: Path, *options: object) -> Row:
    """A session played live and recorded, compared at its own times."""
    truth = truth_of(session)
    recording, ran = live_recording(session, *options, "--people", 2)
    poses = recording.poses
    inside = (poses.t_ns >= truth.t_ns[0]) & (poses.t_ns <= truth.t_ns[-1])
    about = {"poses_per_s": ran["poses_per_s"], "frames_used": ran["used_share"], "load": os.getloadavg()[0]}
    return {**about, "latency_ms": ran["latency"]["all_cameras_total_ms"], **row_of(poses.part(inside), truth, OUTPUT_HZ)}


def main() -> None:
    args = arguments(
        __doc__, reported=False, seed=(int,), only=str, how=HOW, kept=KEPT, rendered=False, played=False, alone=False,
        seconds=4.0, networks="auto",
    )  # fmt: skip
    if args.rendered:
        cases = [(0, 1), (0,), (1,)] if args.alone else [(0, 1)]
        answer(args, {"Two people": [rendered_row(case, args.seconds, args.kept) for case in cases]})
        return
    if args.played:
        answer(args, {"Two people": [played_row(crossing((0, 1), args.seconds, args.kept), "--networks", args.networks)]})
        return
    rows = []
    for seed, (kind, people, cameras) in itertools.product(
        args.seed or (REPORTED_SEEDS if args.reported else (DEVELOPMENT_SEED,)), CASES
    ):
        if args.only in (None, kind):
            made = crowd(kind, people, cameras, seed, args.kept)
            for how in args.how:
                about = {"scene": kind, "people": people, "cameras": cameras, "how": how, "seed": seed}
                rows.append({**about, **figures_of(made, *HOW[how](Network(made, seed), people))})
                note(json.dumps(rows[-1]))
    answer(args, {"Several people": list(means(rows))}, load=os.getloadavg()[0], cases=rows)


if __name__ == "__main__":
    main()
