"""Whole sessions of two people: are they kept apart, at what rate do poses come, and are people as exact as alone?

    python bench/people_sessions.py [--alone] [--seconds 4] [--kept FOLDER]     recorded: two rendered people cross at 0.28 m
    python bench/people_sessions.py --live [--networks auto]                    the same, played to `posefuse live`
    python bench/people_sessions.py --scene returning [--seed 483]              live, an oracle instead of the network

Rendered: five cameras and the bundled network; FOLDER keeps what is rendered, `--alone` renders and tracks each person alone,
too. With a scene of `bench/people.py` the cameras play blank videos, and `detection.oracle` answers from the truth with 2 px of
noise: all but the network and its colours is the session that users run. Figures as in `bench/people.py`; a table on stderr,
one JSON object on stdout.
"""

from __future__ import annotations

import os
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from crowd_scenes import RATE_HZ, REPORTED_SEEDS, crowd
from crowds import crowd_row, person_distances
from harness import Row, answer, arguments, live, rendered, scene_from, sources_of, tracked, truth_of
from people import KEPT
from scenes import walk

from posefuse.core import PoseSequence, Truth
from posefuse.core.skeleton import PAPER14, pick_keypoints
from posefuse.evaluation.metrics import true_xyz_at
from posefuse.formats.rig import write_rig
from posefuse.formats.truth import write_truth
from posefuse.formats.video import VideoWriter
from posefuse_ros.live_recording import read as read_live_recording

PATHS = (((-1.6, -0.14), (1.6, -0.14)), ((1.6, 0.14), (-1.6, 0.14)))
# a person is there with half of the joints
FOUND = 0.5
OUTPUT_HZ, NOISE_PX, PEOPLE, CAMERAS = 100.0, 2.0, 2, 4
# the session's clock against the truth's, in frames: the first frames may have been missed
SHIFTS = range(-20, 40)


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


def blank_session(truth: Truth, folder: Path) -> Path:
    """A session of blank videos with the truth's times, rig and truth."""
    for part in ("truth", "videos"):
        (folder / part).mkdir(parents=True)
    write_rig(folder / "rig.toml", truth.rig)
    write_truth(folder / "truth" / "truth.npz", truth)
    for camera, view in zip(truth.rig, truth.views, strict=True):
        blank = np.full((camera.size_wh[1], camera.size_wh[0], 3), 90, np.uint8)
        with VideoWriter(folder / "videos" / f"{camera.name}.mp4", camera.size_wh, RATE_HZ, crf=40, preset="ultrafast") as video:
            for t_ns in view.t_ns:
                video.write(blank, int(t_ns))
    return folder


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
    """A session played live and recorded; the shift of its clock is the one with which people are nearest to the truth."""
    truth = truth_of(session)
    with tempfile.TemporaryDirectory() as name:
        record = Path(name) / "live.mcap"
        ran = live(session / "rig.toml", sources_of(session), *options, "--people", PEOPLE, "--record", record)
        recording = read_live_recording(record)
    poses, seen = recording.poses, recording.observations
    first_ns = int(seen.frame_t_ns[seen.frame_camera == 0][0] - truth.t_ns[0])
    found = []
    for shift in SHIFTS:
        t_ns = poses.t_ns - first_ns + round(shift * 1e9 / RATE_HZ)
        inside = (t_ns >= truth.t_ns[0]) & (t_ns <= truth.t_ns[-1])
        if inside.mean() >= 0.5:
            part = {name: getattr(poses, name)[inside] for name in ("xyz_world", "cov_world", "reproj_px", "n_views", "kind")}
            found.append(compared(truth, replace(poses, t_ns=t_ns[inside], **part)))
    best = min(found, key=lambda one: float(np.median(one[0].min(axis=2)[np.isfinite(one[0].min(axis=2))])))
    about = {"poses_per_s": ran["poses_per_s"], "frames_used": ran["used_share"], "load": os.getloadavg()[0]}
    return {**about, "latency_ms": ran["latency"]["all_cameras_total_ms"], **row_of(best, OUTPUT_HZ)}


def main() -> None:
    args = arguments(__doc__, seconds=4.0, alone=False, live=False, networks="auto", scene=str, seed=REPORTED_SEEDS[0], kept=KEPT)
    if args.scene:
        truth = crowd(args.scene, PEOPLE, CAMERAS, args.seed, args.kept).truth
        with tempfile.TemporaryDirectory() as name:
            session = blank_session(truth, Path(name) / "session")
            options = {"truth": session / "truth" / "truth.npz", "noise.sigma_px": NOISE_PX}
            words = [word for key, value in options.items() for word in ("--set", f"detector.options.{key}={value}")]
            rows = [{"scene": args.scene, "seed": args.seed, **played(session, "--set", "detector.name=oracle", *words)}]
    elif args.live:
        rows = [played(crossing((0, 1), args.seconds, args.kept), "--networks", args.networks)]
    else:
        rows = [recorded(case, args.seconds, args.kept) for case in ([(0, 1), (0,), (1,)] if args.alone else [(0, 1)])]
    answer(args, {"Two people": rows})


if __name__ == "__main__":
    main()
