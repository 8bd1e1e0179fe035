"""The live pipeline on this machine, as a user runs it: latencies, beat, frames used, and the error at output time.

    python bench/live.py [--repeat 3] [--seconds 8] [--session examples/demo]

A simulated session is played at the pace of the clock. Medians over the runs; tables on stderr, one JSON object on stdout.
Scenarios: four cameras; eight (each film given twice, as two cameras at one place); the paper's ``latest`` tracker.
"""

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from posefuse.core import Kind, Pose3D
from posefuse.core.skeleton import PAPER14, pick_keypoints
from posefuse.evaluate.metrics import true_xyz_at
from posefuse.files.rig import read_rig, write_rig
from posefuse.files.truth import read_truth
from posefuse.wire.bags import read_poses

# the tracker needs a moment to know speeds and bones
_SETTLED_S = 1.5


def live(rig: Path, sources: list[str], seconds: float, *options: str) -> dict:
    """Figures of one `posefuse live`."""
    command = [sys.executable, "-m", "posefuse.app.cli", "live", str(rig), "--json", "--duration", str(seconds), *options]
    command += [part for source in sources for part in ("--source", source)]
    return json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


def error_mm(recording: Path, session: Path, zero_ns: int) -> dict:
    """Error of the 14 joints against the truth at output time, mm, and share of outputs with the person."""
    truth = read_truth(session / "truth" / "truth.npz")
    apart: list[np.ndarray] = []
    shown: list[bool] = []
    for pose, _ in read_poses(recording):
        t_ns = pose.t_ns - zero_ns
        if not _SETTLED_S * 1e9 <= t_ns <= truth.t_ns[-1]:
            continue
        shown.append(len(pose.person_id) > 0)
        if shown[-1]:
            apart.append(distances_mm(pose, true_xyz_at(truth, np.array([t_ns]))[0, 0], truth.skeleton))
    together = np.array(apart)
    return {
        "mean_mm": float(np.nanmean(together)),
        "p95_mm": float(np.nanpercentile(together, 95)),
        "shown_share": float(np.mean(shown)),
    }


def distances_mm(pose: Pose3D, true_xyz: np.ndarray, true_skeleton: object) -> np.ndarray:
    """(14,) of the first person."""
    known = np.where((pose.kind[0] != Kind.MISSING)[:, None], pose.xyz_world[0], np.nan)
    got = pick_keypoints(known, pose.skeleton, PAPER14.keypoints)
    return 1000 * np.linalg.norm(got - pick_keypoints(true_xyz, true_skeleton, PAPER14.keypoints), axis=-1)


def scenario(name: str, rig: Path, sources: list[str], session: Path, args: argparse.Namespace, *options: str) -> dict:
    """Medians over the runs of one scenario."""
    runs = []
    with tempfile.TemporaryDirectory() as scratch:
        for i in range(args.repeat):
            recording = Path(scratch) / f"{i}.mcap"
            figures = live(rig, sources, args.seconds, "--record", str(recording), *options)
            runs.append({**flat(figures), **error_mm(recording, session, figures["zero_ns"])})
    return {"scenario": name, **{key: statistics.median(run[key] for run in runs) for key in runs[0]}}


def flat(figures: dict) -> dict:
    """The figures that go into the table."""
    total, beat = figures["latency"]["all_cameras_total_ms"], figures["latency"]["output"]
    return {
        "p50_ms": total["p50"],
        "p95_ms": total["p95"],
        "p99_ms": total["p99"],
        "beat_p99_ms": beat["period_deviation_ms"]["p99"],
        "poses_per_s": figures["poses_per_s"],
        "used_share": figures["used_share"],
        "cpu_share": figures["cpu_fusion_share"] + figures["cpu_children_share"],
        "memory_mb": figures["memory_mb"],
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=9.0)
    parser.add_argument("--session", type=Path, default=Path(__file__).resolve().parents[1] / "examples" / "demo")
    args = parser.parse_args()
    session = args.session
    rig = session / "rig.toml"
    with tempfile.TemporaryDirectory() as scratch:
        doubled = Path(scratch) / "rig.toml"
        twin_sources = twins(session, doubled)
        rows = [
            scenario("4 cameras", rig, [f"sim:{session}"], session, args),
            scenario("4 cameras, latest", rig, [f"sim:{session}"], session, args, "--tracker", "latest"),
            scenario("8 cameras", doubled, twin_sources, session, args),
        ]
    table = Table(*rows[0])
    for row in rows:
        table.add_row(*(value if isinstance(value, str) else f"{value:.2f}" for value in row.values()))
    Console(stderr=True, width=200).print(table)
    print(json.dumps({"seconds": args.seconds, "repeat": args.repeat, "scenarios": rows}, indent=2))


def twins(session: Path, path: Path) -> list[str]:
    """A rig with every camera twice, and the films as its sources."""
    from dataclasses import replace

    rig = read_rig(session / "rig.toml")
    write_rig(path, replace(rig, cameras=(*rig.cameras, *(replace(c, name=f"{c.name}_twin") for c in rig.cameras))))
    films = {camera.name: session / "videos" / f"{camera.name}.mp4" for camera in rig}
    return [f"{name}{twin}=video:{film}" for name, film in films.items() for twin in ("", "_twin")]


if __name__ == "__main__":
    main()
