"""Several people who keep their identity: rendered crowds, the default network, recorded and live.

    python bench/people.py [--scenes crossing-2x5 leaving-4x8 ...] [--seeds 47] [--seconds 11] [--kept FOLDER]
    python bench/people.py --played [--networks auto]     the same scenes, played to `posefuse live` at the pace of the clock

People who pass each other 0.3 m apart (and, alone, the first of them: what crossing costs), who walk up to each other until they
stand chest to chest, and who leave the room and return: people x cameras on a ring. A person counts where two cameras see 40 % of
the keypoints, and a result is a person when it is less than 0.5 m from it (mean over keypoints), which is also where the
similarity of HOTA ends. FOLDER keeps the scenes. A table on stderr, one JSON object on stdout.
"""

from __future__ import annotations

import os
import tempfile
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from crowds import crowd_row, person_distances
from harness import Row, answer, arguments, live_recording, note, rendered, scene_from, tracked, truth_of
from scenes import walk

from posefuse.core import PoseSequence, Truth
from posefuse.core.skeleton import PAPER14, pick_keypoints
from posefuse.core.view_sequences import nearest_frames
from posefuse.evaluation.metrics import true_xyz_at

KEPT = Path(tempfile.gettempdir()) / "posefuse_crowds"
RATE_HZ, OUTPUT_HZ, LEAST_VISIBLE = 30.0, 100.0, 0.4
SCENES = ("alone-1x5", "crossing-2x5", "crossing-4x5", "hugging-2x5", "hugging-4x8", "leaving-2x5", "leaving-4x8")


def motion_of(kind: str, n: int, cameras: int) -> dict[str, Any]:
    """How person `n` walks, in pairs: to and fro, towards the other one, or out between two cameras and back."""
    ahead, pair = 1 - 2 * (n % 2), np.array([0.0, 1.75 * ((n // 2 + 1) // 2) * (-1) ** (n // 2)])
    shape = "back_forth"
    if kind == "leaving":
        angle = 2 * np.pi * (n + 0.5) / cameras
        start, end = (radius_m * np.array([np.cos(angle), np.sin(angle)]) for radius_m in (0.8, 8.0 if n else 1.9))
    elif kind == "hugging":
        start, end, shape = pair - [2.2 * ahead, 0.0], pair - [0.15 * ahead, 0.0], "line"
    else:
        start, end = pair - [1.6 * ahead, 0.14 * ahead], pair + [1.6 * ahead, -0.14 * ahead]
    return walk({"shape": shape, "start_m": start.tolist(), "end_m": end.tolist()}, 1.2)


def session_of(name: str, seed: int, seconds: float, kept: Path) -> Path:
    """A rendered crowd."""
    kind, (people, cameras) = name.split("-")[0], map(int, name.split("-")[1].split("x"))
    ring = {"kind": "ring", "count": cameras, "radius_m": 4.5, "height_m": 2.2, "image": {"horizontal_fov_deg": 65.0}}
    persons = [{"body": {"random_seed": 100 * seed + n}, "motion": motion_of(kind, n, cameras)} for n in range(people)]
    # who leaves walks on, past the cameras
    room = {"size_m": [18.0, 18.0]} if kind == "leaving" else {}
    scene = {"duration_s": seconds, "rate_hz": RATE_HZ, "seed": seed, "cameras": ring, "people": persons, "room": room}
    return rendered(scene_from(scene), kept / f"{name}-{seed}-{seconds:g}s", processes=None)


def row_of(poses: PoseSequence, truth: Truth, rate_hz: float) -> Row:
    """Of a session's poses within the time of its truth."""
    poses = poses.part((poses.t_ns >= truth.t_ns[0]) & (poses.t_ns <= truth.t_ns[-1]))
    true_xyz = pick_keypoints(true_xyz_at(truth, poses.t_ns), truth.skeleton, PAPER14.keypoints)
    xyz = pick_keypoints(poses.xyz_world, poses.skeleton, PAPER14.keypoints)
    seen = np.stack([view.visible.mean(axis=-1) >= LEAST_VISIBLE for view in truth.views]).sum(axis=0) >= 2
    asked = seen[nearest_frames(truth.t_ns, poses.t_ns)] & np.isfinite(true_xyz[..., 0]).all(axis=-1)
    # fewer than half of the joints is no person
    there = np.isfinite(xyz[..., 0]).mean(axis=-1) >= 0.5
    distance_m = person_distances(true_xyz, np.where(there[..., None, None], xyz, np.nan))
    return {**crowd_row(distance_m, asked, there, rate_hz), "ids": len(poses.person_id)}


def played_row(session: Path, people: int, networks: str) -> Row:
    """A session played live and recorded, compared at its own times."""
    recording, ran = live_recording(session, "--networks", networks, "--people", people)
    about = {"frames_used": ran["used_share"], "load": os.getloadavg()[0], "latency_ms": ran["latency"]["all_cameras_total_ms"]}
    return {**about, **row_of(recording.poses, truth_of(session), OUTPUT_HZ)}


def main() -> None:
    args = arguments(__doc__, scenes=SCENES, seeds=(47,), seconds=11.0, kept=KEPT, played=False, networks="auto")
    rows = []
    for name, seed in product(args.scenes, args.seeds):
        session, people = session_of(name, seed, args.seconds, args.kept), int(name.split("-")[1].split("x")[0])
        if args.played:
            found = played_row(session, people, args.networks)
        else:
            found = row_of(tracked(session, associate__max_people=people).poses, truth_of(session), RATE_HZ)
        rows.append({"scene": name, "seed": seed, **found})
        note(rows[-1])
    answer(args, {"Several people": rows})


if __name__ == "__main__":
    main()
