"""Is the stated uncertainty right? Errors against exact truth, next to the recording's own statement.

The bundled clip is simulated, so the truth is known. The length of an error in space has the variance ``trace(cov)``; if the
covariance is honest, 95 of 100 errors are shorter than 1.6 times its root (a chi-squared law of three degrees of freedom).
"""

from pathlib import Path

import numpy as np
from matplotlib import pyplot

import posefuse as pf
from posefuse.core.skeleton import PAPER14, pick_keypoints
from posefuse.evaluation.metrics import true_xyz_at
from posefuse.formats.truth import read_truth

EXPECTED_95 = 1.61


def main(session: Path, out: Path) -> float:
    recording = pf.track(session, end_s=4.0)
    truth = read_truth(session / "truth" / "truth.npz")
    poses = recording.poses
    true_xyz = pick_keypoints(true_xyz_at(truth, poses.t_ns)[:, 0], truth.skeleton, PAPER14.keypoints)
    got_xyz = pick_keypoints(poses.xyz_world[:, 0], poses.skeleton, PAPER14.keypoints)
    variance = np.trace(poses.cov_world[:, 0], axis1=-2, axis2=-1)[..., None]
    sigma_m = np.sqrt(pick_keypoints(variance, poses.skeleton, PAPER14.keypoints)[..., 0])
    error_m = np.linalg.norm(got_xyz - true_xyz, axis=-1)

    figure, axes = pyplot.subplots(figsize=(6, 4.5), layout="constrained")
    axes.scatter(1000 * sigma_m.ravel(), 1000 * error_m.ravel(), s=4, alpha=0.3)
    limit = 1000 * float(np.nanpercentile(sigma_m, 99))
    axes.plot([0, limit], [0, limit], color="black", linewidth=1, label="error = one standard deviation")
    axes.set_xlabel("stated standard deviation [mm]")
    axes.set_ylabel("true error [mm]")
    axes.legend()
    figure.savefig(out / "uncertainty.png")

    within = float(np.nanmean(error_m < EXPECTED_95 * sigma_m))
    print(f"{within:.0%} of the errors are shorter than {EXPECTED_95} stated standard deviations; 95% would be exact")
    return within


if __name__ == "__main__":
    folder = Path("out/gallery")
    folder.mkdir(parents=True, exist_ok=True)
    main(Path("examples/demo"), folder)
