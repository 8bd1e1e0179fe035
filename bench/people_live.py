"""Two people in a whole live session: processes, clock, search, tracker, names; at what rate poses come, and which person is
which.

    python bench/people_live.py [--scene returning] [--seed 483]
    python bench/people_live.py --session FOLDER [--networks auto]

The cameras play blank videos; `detection.oracle` answers from the truth of a scene of `bench/people.py` with 2 px of noise. So
all but the network and its colours is the session that users run. With ``--session``, a rendered one of two people (such as
`bench/people_rendered.py` keeps), the network is in it, too. One JSON object on stdout.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from crowd_scenes import RATE_HZ, REPORTED_SEEDS, crowd
from crowds import crowd_figures, frame_matches, person_distances, returned_right

from posefuse.core import Truth
from posefuse.core.skeleton import PAPER14, pick_keypoints
from posefuse.evaluation.metrics import true_xyz_at
from posefuse.formats.rig import write_rig
from posefuse.formats.truth import read_truth, write_truth
from posefuse.formats.video import VideoWriter
from posefuse.pipeline.live_recording import read_live_recording

OUTPUT_HZ, NOISE_PX, PEOPLE, CAMERAS = 100.0, 2.0, 2, 4
# the session's clock against the truth's, in frames: the first frames may have been missed
SHIFTS = range(-20, 40)


def write_session(truth: Truth, folder: Path) -> list[str]:
    """Blank videos with the truth's times, rig and truth; the sources for `posefuse live`."""
    (folder / "truth").mkdir(parents=True)
    write_rig(folder / "rig.toml", truth.rig)
    write_truth(folder / "truth" / "truth.npz", truth)
    sources = []
    for camera, view in zip(truth.rig, truth.views, strict=True):
        video = VideoWriter(folder / f"{camera.name}.mp4", camera.size_wh, RATE_HZ, crf=40, preset="ultrafast")
        blank = np.full((camera.size_wh[1], camera.size_wh[0], 3), 90, np.uint8)
        for t_ns in view.t_ns:
            video.write(blank, int(t_ns))
        video.close()
        sources += ["--source", f"{camera.name}=video:{folder / camera.name}.mp4"]
    return sources


def oracle(truth: Path) -> list[str]:
    """Options with which the truth stands in for the network."""
    settings = {"detector.name": "oracle", "detector.options.truth": truth, "detector.options.noise.sigma_px": NOISE_PX}
    return [word for key, value in settings.items() for word in ("--set", f"{key}={value}")]


def sources_of(session: Path) -> list[str]:
    """The videos of a rendered session, for `posefuse live`."""
    videos = sorted((session / "videos").glob("*.mp4"))
    return [word for video in videos for word in ("--source", f"{video.stem}=video:{video}")]


def run(rig: Path, sources: list[str], options: list[str], record: Path) -> dict:
    """One session; its figures."""
    command = [sys.executable, "-m", "posefuse", "live", str(rig), *sources, *options, "--people", str(PEOPLE)]
    done = subprocess.run([*command, "--record", str(record), "--json"], stdout=subprocess.PIPE, check=True)
    return json.loads(done.stdout)


def figures_of(truth: Truth, path: Path) -> dict[str, float]:
    recording = read_live_recording(path)
    poses, seen = recording.poses, recording.observations
    first_ns = int(seen.frame_t_ns[seen.frame_camera == 0][0] - truth.t_ns[0])
    shifted = [_compared(truth, poses, first_ns - round(shift * 1e9 / RATE_HZ)) for shift in SHIFTS]
    distance, asked, there = min((one for one in shifted if one is not None), key=lambda one: _usual_m(one[0]))
    figures = crowd_figures(distance, asked, there, OUTPUT_HZ)
    right, returns = returned_right(frame_matches(distance, asked), asked, round(OUTPUT_HZ), round(OUTPUT_HZ / 2))
    return {
        "idf1": figures.idf1, "hota": figures.hota, "switches": figures.switches, "missed": figures.missed,
        "false": figures.false, "mpjpe_mm": figures.mpjpe_mm, "returns": returns, "returns_right": right,
        "everybody_share": float((there.sum(axis=1) >= asked.sum(axis=1)).mean()),
    }  # fmt: skip


def _compared(truth: Truth, poses, zero_ns: int) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    t_ns = poses.t_ns - zero_ns
    inside = (t_ns >= truth.t_ns[0]) & (t_ns <= truth.t_ns[-1])
    if inside.mean() < 0.5:
        return None
    true_xyz = pick_keypoints(true_xyz_at(truth, t_ns[inside]), truth.skeleton, PAPER14.keypoints)
    xyz = pick_keypoints(poses.xyz_world[inside], poses.skeleton, PAPER14.keypoints)
    there = np.isfinite(xyz[..., 0]).mean(axis=-1) >= 0.5
    xyz = np.where(there[..., None, None], xyz, np.nan)
    return person_distances(true_xyz, xyz), np.isfinite(true_xyz).all(axis=(2, 3)), there


def _usual_m(distance: np.ndarray) -> float:
    nearest = distance.min(axis=2)
    return float(np.median(nearest[np.isfinite(nearest)]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scene", default="returning")
    parser.add_argument("--seed", type=int, default=REPORTED_SEEDS[0])
    parser.add_argument("--kept", type=Path, default=Path(tempfile.gettempdir()) / "posefuse_crowds")
    parser.add_argument("--session", type=Path, help="rendered instead, with the network")
    parser.add_argument("--networks", default="auto", help="with --session: as of `posefuse live`")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        record = Path(name) / "live.mcap"
        if args.session:
            truth = read_truth(args.session / "truth" / "truth.npz")
            ran = run(args.session / "rig.toml", sources_of(args.session), ["--networks", args.networks], record)
        else:
            truth = crowd(args.scene, PEOPLE, CAMERAS, args.seed, args.kept).truth
            folder = Path(name) / "session"
            ran = run(folder / "rig.toml", write_session(truth, folder), oracle(folder / "truth" / "truth.npz"), record)
        found = figures_of(truth, record)
    what = {"session": args.session.name, "networks": args.networks} if args.session else {"scene": args.scene, "seed": args.seed}
    latency = ran["latency"]["all_cameras_total_ms"]
    about = {**what, "latency_ms": latency, "load": os.getloadavg()[0], "poses_per_s": ran["poses_per_s"]}
    print(json.dumps({**about, "frames_used": ran["used_share"], **found}, indent=1))


if __name__ == "__main__":
    main()
