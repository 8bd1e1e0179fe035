"""The whole pipeline on the demo clip, as a user runs it: speed, shares, memory, and accuracy of every weighting.

    python bench/pipeline.py [--repeat 3] [--session examples/demo]

A table on stderr, one JSON object on stdout. Times are medians over the runs; `track` writes nothing but the lossless result,
`everything` all default outputs with the overlay video.
"""

import json
import resource
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

from harness import DEMO, POSEFUSE, answer, arguments, medians, tracked, truth_of

from posefuse.detection.card import CARDS_FOLDER
from posefuse.evaluation.metrics import joint_errors
from posefuse.formats.joint_centres import read_joint_centres
from posefuse.fusion import WEIGHTS, FuseSettings
from posefuse.pipeline.second_pass import poses_over_time
from posefuse.tracking import SmoothSettings

JOINT_CENTRES = CARDS_FOLDER / "blazepose_full.joint_centres.toml"


def speed(session: Path, out: Path, repeat: int, *options: str) -> dict:
    """Medians over `repeat` runs of `posefuse track`."""
    command = [*POSEFUSE, "track", str(session), "--out", str(out), "--force", "--json", *options]
    runs = [json.loads(subprocess.run(command, check=True, capture_output=True).stdout) for _ in range(repeat)]
    row = medians([{name: run[name] for name in ("time_steps_per_s", "detect_ms_per_image")} for run in runs])
    stages = medians([run["stage_ms_per_time_step"] for run in runs])
    return {**row, "images_per_s": runs[0]["cameras"] * row["time_steps_per_s"], "ms per time step and stage": stages}


def accuracy(session: Path) -> Iterator[dict]:
    """MPJPE over the paper's 14 joints per weighting, from the same 2D, every time step by itself and smoothed."""
    recording, truth = tracked(session), truth_of(session)
    centres = read_joint_centres(JOINT_CENTRES)
    for weights in WEIGHTS:
        settings = FuseSettings(weights=weights)
        raw, smoothed = (
            joint_errors(poses_over_time(recording.views, recording.rig, settings, smoothing, centres), truth)
            for smoothing in (None, SmoothSettings())
        )
        worst = {"worst_joint_mm": float(smoothed.mean_mm.max())}
        yield {"weights": weights, "raw_mpjpe_mm": raw.mpjpe_mm, "mpjpe_mm": smoothed.mpjpe_mm, **worst}


def main() -> None:
    args = arguments(__doc__, repeat=3, session=DEMO)
    with tempfile.TemporaryDirectory() as folder:
        ways = {"track": ("--outputs", ""), "everything": ()}
        rows = [{"run": way, **speed(args.session, Path(folder) / "result", args.repeat, *ways[way])} for way in ways]
    peak_mb = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
    errors = {"Demo clip: error against the truth, mm (14 joints)": list(accuracy(args.session))}
    answer(args, {"Demo clip: speed (start-up not counted)": rows, **errors}, peak_memory_mb=peak_mb)


if __name__ == "__main__":
    main()
