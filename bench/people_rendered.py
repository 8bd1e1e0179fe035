"""Two rendered people who cross at 0.28 m, five cameras, the bundled network: are they kept apart, and as exact as alone?

    python bench/people_rendered.py [--seconds 4] [--alone] [--kept FOLDER]

Figures as in `bench/people.py`; `--alone` renders and tracks each person alone, too. What is rendered is kept between runs. A
JSON object on stdout.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path

import numpy as np
from crowds import crowd_figures, person_distances

from posefuse.core import Kind, Truth
from posefuse.core.skeleton import PAPER14, pick_keypoints
from posefuse.evaluation.metrics import true_xyz_at
from posefuse.formats.truth import read_truth
from posefuse.foundation.settings import settings_from_mapping
from posefuse.pipeline.clock import StageClock
from posefuse.pipeline.config import TrackConfig
from posefuse.pipeline.run import Tracked, track_session
from posefuse.pipeline.session import find_session
from posefuse.simulation import simulate
from posefuse.simulation.scene import Scene

RATE_HZ = 30.0
PATHS = (((-1.6, -0.14), (1.6, -0.14)), ((1.6, 0.14), (-1.6, 0.14)))
MATCHED_M = 0.5


def scene(people: tuple[int, ...], seconds: float) -> Scene:
    persons = [
        {
            "body": {"random_seed": 4700 + n},
            "motion": {
                "kind": "walk",
                "speed_mps": 1.2,
                "path": {"shape": "back_forth", "start_m": PATHS[n][0], "end_m": PATHS[n][1]},
            },
        }
        for n in people
    ]
    cameras = {"kind": "ring", "count": 5, "radius_m": 4.5, "height_m": 2.2, "image": {"horizontal_fov_deg": 65.0}}
    content = {"duration_s": seconds, "rate_hz": RATE_HZ, "seed": 47, "cameras": cameras, "people": persons}
    return settings_from_mapping(content, Scene, "bench")


def measured(people: tuple[int, ...], seconds: float, folder: Path) -> dict[str, float]:
    session = folder / f"{'_'.join(str(n) for n in people)}-{seconds:g}s"
    if not (session / "truth" / "truth.npz").exists():
        simulate(scene(people, seconds), session)
    config = settings_from_mapping({"associate": {"max_people": len(people)}}, TrackConfig, "bench")

    def note(line: str) -> None:
        print(line, file=sys.stderr)

    done = track_session(find_session(session, config), config, StageClock(), lambda *_: None, note, note)
    return figures_of(done, read_truth(session / "truth" / "truth.npz"))


def figures_of(done: Tracked, truth: Truth) -> dict[str, float]:
    poses = done.recording.poses
    true_xyz = pick_keypoints(true_xyz_at(truth, poses.t_ns), truth.skeleton, PAPER14.keypoints)
    xyz = pick_keypoints(poses.xyz_world, poses.skeleton, PAPER14.keypoints)
    there = (poses.kind != Kind.MISSING).mean(axis=-1) >= MATCHED_M
    asked = np.isfinite(true_xyz[..., 0]).all(axis=-1)
    figures = crowd_figures(person_distances(true_xyz, np.where(there[..., None, None], xyz, np.nan)), asked, there, RATE_HZ)
    return {
        "steps": len(poses),
        "both_share": float((there.sum(axis=1) >= true_xyz.shape[1]).mean()),
        "idf1": figures.idf1,
        "hota": figures.hota,
        "switches": figures.switches,
        "missed": figures.missed,
        "false": figures.false,
        "mpjpe_mm": figures.mpjpe_mm,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=4.0)
    parser.add_argument("--alone", action="store_true")
    parser.add_argument("--kept", type=Path, default=Path(tempfile.gettempdir()) / "posefuse_rendered_people")
    args = parser.parse_args()
    cases = [(0, 1), (0,), (1,)] if args.alone else [(0, 1)]
    print(json.dumps({str(case): measured(case, args.seconds, args.kept) for case in cases}, indent=1))


if __name__ == "__main__":
    main()
