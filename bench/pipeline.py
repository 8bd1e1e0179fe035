"""The whole pipeline on the demo clip, as a user runs it: speed, shares, memory, and accuracy of every weighting.

    python bench/pipeline.py [--repeat 3] [--session examples/demo]

A table on stderr, one JSON object on stdout. Times are medians over the runs; `track` writes nothing but the lossless result,
`everything` all default outputs with the overlay video.
"""

import argparse
import json
import resource
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

from rich.console import Console
from rich.table import Table

from posefuse.detection.card import CARDS_FOLDER
from posefuse.evaluation.metrics import joint_errors
from posefuse.formats.joint_centres import read_joint_centres
from posefuse.formats.recording import read_recording
from posefuse.formats.truth import read_truth
from posefuse.fusion import WEIGHTS, FuseSettings
from posefuse.pipeline.second_pass import poses_over_time
from posefuse.tracking import SmoothSettings

JOINT_CENTRES = CARDS_FOLDER / "blazepose_full.joint_centres.toml"


def tracked(session: Path, out: Path, *options: str) -> dict:
    """The figures of one `posefuse track`."""
    command = [sys.executable, "-m", "posefuse.cli.main", "track", str(session), "--out", str(out), "--force", "--json", *options]
    return json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


def speed(session: Path, out: Path, repeat: int, *options: str) -> dict:
    """Medians over `repeat` runs."""
    runs = [tracked(session, out, *options) for _ in range(repeat)]
    cameras = runs[0]["cameras"]
    return {
        "time_steps_per_s": statistics.median(run["time_steps_per_s"] for run in runs),
        "images_per_s": statistics.median(cameras * run["time_steps_per_s"] for run in runs),
        "detect_ms_per_image": statistics.median(run["detect_ms_per_image"] for run in runs),
        "stage_ms_per_time_step": {
            stage: statistics.median(run["stage_ms_per_time_step"][stage] for run in runs)
            for stage in runs[0]["stage_ms_per_time_step"]
        },
    }


def accuracy(session: Path, result: Path) -> dict:
    """MPJPE over the paper's 14 joints per weighting, from the same 2D, raw and smoothed."""
    recording, truth = read_recording(result), read_truth(session / "truth" / "truth.npz")
    views, rows = recording.views, {}
    centres = read_joint_centres(JOINT_CENTRES)
    for weights in WEIGHTS:
        settings = FuseSettings(weights=weights)
        raw = joint_errors(poses_over_time(views, recording.rig, settings, None, centres), truth)
        smoothed = joint_errors(poses_over_time(views, recording.rig, settings, SmoothSettings(), centres), truth)
        rows[weights] = {
            "raw_mpjpe_mm": raw.mpjpe_mm,
            "mpjpe_mm": smoothed.mpjpe_mm,
            "worst_joint_mm": float(smoothed.mean_mm.max()),
        }
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--session", type=Path, default=Path("examples/demo"))
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        result = Path(folder) / "result"
        figures = {
            "track": speed(args.session, result, args.repeat, "--outputs", ""),
            "everything": speed(args.session, result, args.repeat),
            "accuracy": accuracy(args.session, result),
        }
    figures["peak_memory_mb"] = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
    show(figures)
    print(json.dumps(figures, indent=2))


def show(figures: dict) -> None:
    console = Console(stderr=True, width=120)
    table = Table(title="Demo clip: speed (start-up not counted)", title_justify="left")
    for column in ("run", "time steps/s", "images/s", "2D ms/image", "ms per time step and stage"):
        table.add_column(column)
    for run in ("track", "everything"):
        row = figures[run]
        stages = ", ".join(f"{stage} {ms:.1f}" for stage, ms in row["stage_ms_per_time_step"].items())
        table.add_row(
            run, f"{row['time_steps_per_s']:.1f}", f"{row['images_per_s']:.0f}", f"{row['detect_ms_per_image']:.1f}", stages
        )
    console.print(table)
    console.print(f"peak memory {figures['peak_memory_mb']:.0f} MB")
    table = Table(title="Demo clip: error against the truth, mm (14 joints)", title_justify="left")
    for column in ("weights", "every time step by itself", "smoothed", "worst joint, smoothed"):
        table.add_column(column)
    for weights, row in figures["accuracy"].items():
        table.add_row(weights, f"{row['raw_mpjpe_mm']:.1f}", f"{row['mpjpe_mm']:.1f}", f"{row['worst_joint_mm']:.1f}")
    console.print(table)


if __name__ == "__main__":
    main()
