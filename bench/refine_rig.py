"""What `track --refine-rig` gains: cameras displaced by chance from where they are, and the error with and without.

    python bench/refine_rig.py SESSION ... [--draws 3] [--fit]

Sessions are rendered ones (truth known). The detector looks once, with the true rig; the solve is repeated with rigs whose
cameras are displaced by chance. Error of 14 joints against the truth in mm, median over the draws. `--fit` tries other values
of `refine.together`. Tables on stderr, one JSON object on stdout.
"""

import argparse
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from posefuse.calibration.settings import RefineSettings
from posefuse.core import SE3, Recording, Rig
from posefuse.evaluation.metrics import joint_errors
from posefuse.formats.truth import read_truth
from posefuse.pipeline.clock import StageClock
from posefuse.pipeline.config import TrackConfig
from posefuse.pipeline.run import track_session
from posefuse.pipeline.session import find_session
from posefuse.pipeline.solve import REFINED, solve_again

# standard deviation per axis: position in mm, orientation in degrees
DISPLACED = ((0.0, 0.0), (3.0, 0.05), (5.0, 0.1), (10.0, 0.25), (20.0, 0.5))
TOGETHER = (3.0, 10.0, 30.0)


def displaced(rig: Rig, move_m: float, turn_rad: float, seed: int) -> Rig:
    """Every camera moved and turned by chance."""
    rng = np.random.default_rng(seed)
    cameras = []
    for camera, centre in zip(rig, rig.centres_world(), strict=True):
        vector, shift = rng.normal(size=(2, 3))
        R = SE3.from_rotvec(vector * turn_rad, np.zeros(3)).matrix() @ camera.cam_from_world.matrix()
        cameras.append(replace(camera, cam_from_world=SE3.from_matrix(R, -R @ (centre + shift * move_m))))
    return replace(rig, cameras=tuple(cameras))


def tracked(session: Path) -> tuple[Recording, TrackConfig]:
    """`posefuse track` with the true rig."""
    config = TrackConfig(outputs={})
    silent = lambda *_: None  # noqa: E731
    return track_session(find_session(session, config), config, StageClock(), silent, silent, silent).recording, config


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sessions", type=Path, nargs="+")
    parser.add_argument("--draws", type=int, default=3)
    parser.add_argument("--fit", action="store_true")
    args = parser.parse_args()
    ways = [RefineSettings(together=value) for value in TOGETHER] if args.fit else [RefineSettings()]
    rows = []
    for session in args.sessions:
        (recording, config), truth = tracked(session), read_truth(session / "truth" / "truth.npz")
        for move_mm, turn_deg in DISPLACED:
            found: dict[str, list[float]] = {}
            for draw in range(args.draws if move_mm else 1):
                rig = displaced(recording.rig, move_mm / 1e3, np.deg2rad(turn_deg), draw)
                wrong = replace(recording, rig=rig)
                plain = solve_again(wrong, config)
                found.setdefault("as calibrated", []).append(joint_errors(plain.poses, truth).mpjpe_mm)
                for way in ways:
                    solved = solve_again(wrong, replace(config, refine_rig=True, refine=way))
                    about = solved.provenance[REFINED]
                    name = f"refined, together {way.together:g}"
                    found.setdefault(name, []).append(joint_errors(solved.poses, truth).mpjpe_mm)
                    found.setdefault(f"{name}: px before", []).append(about["before_px"])
                    found.setdefault(f"{name}: px after", []).append(about["after_px"])
            rows.append({"session": session.name, "moved mm": move_mm, "turned deg": turn_deg}
                        | {name: float(np.median(values)) for name, values in found.items()})  # fmt: skip
    table = Table(*rows[0], title="cameras displaced by chance, error in mm", title_justify="left")
    for row in rows:
        table.add_row(*(f"{value:.3g}" if isinstance(value, float) else str(value) for value in row.values()))
    Console(stderr=True, width=180).print(table)
    print(json.dumps({"rows": rows}, indent=2))


if __name__ == "__main__":
    main()
