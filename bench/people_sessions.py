"""Whole sessions of two people: are they kept apart, at what rate do poses come, and are people as exact as alone?

    python bench/people_sessions.py [--alone] [--seconds 4] [--kept FOLDER]     recorded: two rendered people cross at 0.28 m
    python bench/people_sessions.py --live [--networks auto]                    the same, played to `posefuse live`

Five cameras and the bundled network; FOLDER keeps what is rendered, `--alone` renders and tracks each person alone, too. Figures
as in `bench/people.py`; a table on stderr, one JSON object on stdout.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from crowd_scenes import RATE_HZ
from crowds import crowd_row, person_distances
from harness import Row, answer, arguments, live_recording, rendered, scene_from, tracked, truth_of
from people import KEPT
from scenes import walk

from posefuse.core import PoseSequence, Truth
from posefuse.core.skeleton import PAPER14, pick_keypoints
from posefuse.evaluation.metrics import true_xyz_at

PATHS = (((-1.6, -0.14), (1.6, -0.14)), ((1.6, 0.14), (-1.6, 0.14)))
# a person is there with half of the joints
FOUND = 0.5
OUTPUT_HZ, PEOPLE = 100.0, 2


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


def compared(truth: Truth, poses: PoseSequence) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Distances (T, N, M), who is in the room (T, N), and which results there are (T, M)."""
    true_xyz = pick_keypoints(true_xyz_at(truth, poses.t_ns), truth.skeleton, PAPER14.keypoints)
    xyz = pick_keypoints(poses.xyz_world, poses.skeleton, PAPER14.keypoints)
    there = np.isfinite(xyz[..., 0]).mean(axis=-1) >= FOUND
    distance = person_distances(true_xyz, np.where(there[..., None, None], xyz, np.nan))
    return distance, np.isfinite(true_xyz[..., 0]).all(axis=-1), there


def row_of(found: tuple[np.ndarray, np.ndarray, np.ndarray], rate_hz: float) -> Row:
    _, asked, there = found
    return {"everybody_share": float((there.sum(axis=1) >= asked.sum(axis=1)).mean()), **crowd_row(*found, rate_hz)}


def recorded(people: tuple[int, ...], seconds: float, kept: Path) -> Row:
    session = crossing(people, seconds, kept)
    poses = tracked(session, associate__max_people=len(people)).poses
    return {"people": str(people), "steps": len(poses), **row_of(compared(truth_of(session), poses), RATE_HZ)}


def played(session: Path, *options: object) -> Row:
    """A session played live and recorded, compared at its own times."""
    truth = truth_of(session)
    recording, ran = live_recording(session, *options, "--people", PEOPLE)
    poses = recording.poses
    found = compared(truth, poses.part((poses.t_ns >= truth.t_ns[0]) & (poses.t_ns <= truth.t_ns[-1])))
    about = {"poses_per_s": ran["poses_per_s"], "frames_used": ran["used_share"], "load": os.getloadavg()[0]}
    return {**about, "latency_ms": ran["latency"]["all_cameras_total_ms"], **row_of(found, OUTPUT_HZ)}


def main() -> None:
    args = arguments(__doc__, seconds=4.0, alone=False, live=False, networks="auto", kept=KEPT)
    if args.live:
        rows = [played(crossing((0, 1), args.seconds, args.kept), "--networks", args.networks)]
    else:
        rows = [recorded(case, args.seconds, args.kept) for case in ([(0, 1), (0,), (1,)] if args.alone else [(0, 1)])]
    answer(args, {"Two people": rows})


if __name__ == "__main__":
    main()
