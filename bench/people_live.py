"""Two people in a whole live session: processes, clock, search, tracker, names; at what rate poses come, and which person is
which.

    python bench/people_live.py [--scene returning] [--seed 483]
    python bench/people_live.py --session FOLDER [--networks auto]

The cameras play blank videos; `detection.oracle` answers from the truth of a scene of `bench/people.py` with 2 px of noise. So
all but the network and its colours is the session that users run. With ``--session``, a rendered one of two people (such as
`bench/people_rendered.py` keeps), the network is in it, too. One JSON object on stdout.
"""

from __future__ import annotations

import os
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from crowd_scenes import RATE_HZ, REPORTED_SEEDS, crowd
from crowds import crowd_row
from harness import answer, arguments, live, sources_of, truth_of
from people import KEPT
from people_rendered import compared

from posefuse.core import Truth
from posefuse.formats.rig import write_rig
from posefuse.formats.truth import write_truth
from posefuse.formats.video import VideoWriter
from posefuse_ros.live_recording import read as read_live_recording

OUTPUT_HZ, NOISE_PX, PEOPLE, CAMERAS = 100.0, 2.0, 2, 4
# the session's clock against the truth's, in frames: the first frames may have been missed
SHIFTS = range(-20, 40)


def write_session(truth: Truth, folder: Path) -> Path:
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


def oracle(truth: Path) -> list[str]:
    """Options with which the truth stands in for the network."""
    settings = {"detector.name": "oracle", "detector.options.truth": truth, "detector.options.noise.sigma_px": NOISE_PX}
    return [word for key, value in settings.items() for word in ("--set", f"{key}={value}")]


def figures_of(truth: Truth, path: Path) -> dict[str, float]:
    recording = read_live_recording(path)
    poses, seen = recording.poses, recording.observations
    first_ns = int(seen.frame_t_ns[seen.frame_camera == 0][0] - truth.t_ns[0])
    found = []
    for shift in SHIFTS:
        t_ns = poses.t_ns - first_ns + round(shift * 1e9 / RATE_HZ)
        inside = (t_ns >= truth.t_ns[0]) & (t_ns <= truth.t_ns[-1])
        if inside.mean() >= 0.5:
            part = {name: getattr(poses, name)[inside] for name in ("xyz_world", "cov_world", "reproj_px", "n_views", "kind")}
            found.append(compared(truth, replace(poses, t_ns=t_ns[inside], **part)))
    distance, asked, there = min(found, key=lambda one: _usual_m(one[0]))
    everybody = float((there.sum(axis=1) >= asked.sum(axis=1)).mean())
    return {**crowd_row(distance, asked, there, OUTPUT_HZ), "everybody_share": everybody}


def _usual_m(distance: np.ndarray) -> float:
    nearest = distance.min(axis=2)
    return float(np.median(nearest[np.isfinite(nearest)]))


def main() -> None:
    args = arguments(__doc__, scene="returning", seed=REPORTED_SEEDS[0], kept=KEPT, session=Path, networks="auto")
    with tempfile.TemporaryDirectory() as name:
        record, options = Path(name) / "live.mcap", ["--networks", args.networks]
        session = args.session
        if not session:
            session = write_session(crowd(args.scene, PEOPLE, CAMERAS, args.seed, args.kept).truth, Path(name) / "session")
            options = oracle(session / "truth" / "truth.npz")
        ran = live(session / "rig.toml", sources_of(session), *options, "--people", PEOPLE, "--record", record)
        found = figures_of(truth_of(session), record)
    about = {
        "session": args.session.name if args.session else f"{args.scene}, seed {args.seed}",
        "poses_per_s": ran["poses_per_s"],
    }
    latency = ran["latency"]["all_cameras_total_ms"]
    about |= {"poses_per_s": ran["poses_per_s"], "frames_used": ran["used_share"], "load": os.getloadavg()[0]}
    row = {**about, "latency_ms": latency, **found}
    answer(args, {"Two people, live": [row]})


if __name__ == "__main__":
    main()
