"""Fit how much of a keypoint's error lasts from frame to frame, and for how long, on rendered people whose keypoints are known.

    python bench/fit_lasting_errors.py render OUT [--scenes 4]    draw the scenes at video rate (minutes; resumes)
    python bench/fit_lasting_errors.py fit OUT                    run the pipeline without smoothing, fit, print

The fit is the source of `tracking.settings`. Its scenes are those of `fit_blazepose_noise.py` (bodies of random seeds 7000 on:
none appears in a reported measurement) at 30 frames/s.
"""

import argparse
import subprocess
import sys
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

from posefuse.core.skeleton import pick_keypoints
from posefuse.evaluation.fitting.scenes import everyday_scene
from posefuse.evaluation.metrics import true_xyz_at
from posefuse.formats.recording import read_recording
from posefuse.formats.truth import read_truth

DURATION_S, RATE_HZ = 4.0, 30.0
JOINTS = tuple(f"{s}_{j}" for s in ("left", "right") for j in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle"))
MOST_LAG_S = 1.0
# an error of more sigmas is a confusion
MOST_SIGMAS = 5.0


def render(out: Path, scenes: int) -> None:
    """Every other scene of the noise fit, which take its motions by turns."""
    from posefuse.foundation.settings import settings_from_mapping
    from posefuse.simulation.scene import Scene
    from posefuse.simulation.session import simulate

    for i in range(scenes):
        folder = out / f"scene{i:02d}"
        if (folder / "truth" / "truth.npz").exists():
            continue
        content = everyday_scene(2 * i) | {"duration_s": DURATION_S, "rate_hz": RATE_HZ}
        simulate(settings_from_mapping(content, Scene, where=f"scene {i}"), folder, processes=1)
        print(f"{folder.name}: done", flush=True)


def whitened_errors(session: Path) -> np.ndarray:
    """(T, J, 3) errors of the fused joints, time step by time step, in units of their stated covariance."""
    out = session / "fused"
    command = [sys.executable, "-m", "posefuse.cli.main", "track", str(session), "--out", str(out), "--force", "--raw"]
    subprocess.run([*command, "--outputs", ""], check=True, capture_output=True)
    poses, truth = read_recording(out).poses, read_truth(session / "truth" / "truth.npz")
    at = poses.skeleton.indices(JOINTS)
    error = poses.xyz_world[:, 0][:, at] - pick_keypoints(true_xyz_at(truth, poses.t_ns)[:, 0], truth.skeleton, JOINTS)
    cov = poses.cov_world[:, 0][:, at]
    known = np.isfinite(error).all(-1) & np.isfinite(cov).all((-1, -2))
    factor = np.linalg.cholesky(np.where(known[..., None, None], cov, np.eye(3)))
    white = np.linalg.solve(factor, np.where(known[..., None], error, np.nan)[..., None])[..., 0]
    return np.where(np.linalg.norm(white, axis=-1, keepdims=True) < MOST_SIGMAS, white, np.nan)


def autocorrelation(errors: list[np.ndarray]) -> np.ndarray:
    """(L,) of lag 0, 1, ... frames, over all scenes, joints and axes; about zero, not about the mean."""
    lags = range(int(MOST_LAG_S * RATE_HZ))
    products = [np.nanmean(np.concatenate([(e[: len(e) - lag] * e[lag:]).ravel() for e in errors])) for lag in lags]
    return np.array(products) / products[0]


def fit(errors: list[np.ndarray]) -> tuple[float, float, float]:
    """Share of the variance that lasts, the part of it that stays for good, and the time in s in which the rest fades by e."""
    found = autocorrelation(errors)[1:]
    lag_s = np.arange(1, len(found) + 1) / RATE_HZ
    start, bounds = (0.4, 0.4, 0.3), ([0, 0, 0.01], [1, 1, 10])
    solved = least_squares(lambda p: p[0] + p[1] * np.exp(-lag_s / p[2]) - found, start, bounds=bounds)
    stays, fades, time_s = (float(value) for value in solved.x)
    return stays + fades, stays, time_s


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("step", choices=("render", "fit"))
    parser.add_argument("out", type=Path)
    parser.add_argument("--scenes", type=int, default=4)
    arguments = parser.parse_args()
    if arguments.step == "render":
        render(arguments.out, arguments.scenes)
        return
    errors = [whitened_errors(folder) for folder in sorted(arguments.out.glob("scene*"))]
    found = autocorrelation(errors)
    print("lag in frames: autocorrelation  " + "  ".join(f"{lag}: {found[lag]:.2f}" for lag in (1, 2, 4, 8, 15, 25)))
    for left_out in (None, *range(len(errors))):
        share, stays, time_s = fit([one for i, one in enumerate(errors) if i != left_out])
        which = f"{len(errors)} scenes" if left_out is None else f"  without scene {left_out}"
        print(f"{which}: share {share:.2f} ({stays:.2f} of it for good), time constant {time_s:.2f} s")


if __name__ == "__main__":
    main()
