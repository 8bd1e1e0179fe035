"""What `track --refine-rig` gains: cameras displaced by chance from where they are, and the error with and without.

    python bench/refine_rig.py [SESSION ...] [--draws 3] [--fit]

Sessions are rendered ones (truth known). The detector looks once, with the true rig; the solve is repeated with rigs whose
cameras are displaced by chance. Error of 14 joints against the truth in mm, median over the draws. `--fit` tries other values
of `refine.together`. Tables on stderr, one JSON object on stdout.
"""

from dataclasses import replace

import numpy as np
from harness import DEMO, answer, arguments, medians, tracked, truth_of

from posefuse.calibration.settings import RefineSettings
from posefuse.core import SE3, Recording, Rig, Truth
from posefuse.evaluation.metrics import joint_errors
from posefuse.pipeline.config import TrackConfig
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


def measured(wrong: Recording, truth: Truth, ways: list[RefineSettings]) -> dict[str, float]:
    config = TrackConfig(outputs={})
    row = {"as calibrated": joint_errors(solve_again(wrong, config).poses, truth).mpjpe_mm}
    for way in ways:
        solved = solve_again(wrong, replace(config, refine_rig=True, refine=way))
        row[f"refined, together {way.together:g}"] = joint_errors(solved.poses, truth).mpjpe_mm
        row |= {f"{way.together:g}: px {when}": solved.provenance[REFINED][f"{when}_px"] for when in ("before", "after")}
    return row


def main() -> None:
    args = arguments(__doc__, positional=("sessions",), sessions=(DEMO,), draws=3, fit=False)
    ways = [RefineSettings(together=value) for value in TOGETHER] if args.fit else [RefineSettings()]
    rows = []
    for session in args.sessions:
        recording, truth = tracked(session), truth_of(session)
        for move_mm, turn_deg in DISPLACED:
            rigs = [displaced(recording.rig, move_mm / 1e3, np.deg2rad(turn_deg), i) for i in range(args.draws if move_mm else 1)]
            found = medians([measured(replace(recording, rig=rig), truth, ways) for rig in rigs])
            rows.append({"session": session.name, "moved mm": move_mm, "turned deg": turn_deg, **found})
    answer(args, {"Cameras displaced by chance, error in mm": rows})


if __name__ == "__main__":
    main()
