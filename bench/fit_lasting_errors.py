"""Fit how much of a keypoint's error lasts from frame to frame, and for how long, on rendered people whose keypoints are known.

    python bench/fit_lasting_errors.py OUT [--scenes 4]

draws the scenes at video rate into OUT (minutes; resumes), runs the pipeline without smoothing, fits and prints.
The fit is the source of `tracking.settings`. Its scenes are those of `fit_blazepose_noise.py` (bodies of random seeds 7000 on:
none appears in a reported measurement) at 30 frames/s. Tables on stderr, one JSON object on stdout.
"""

from pathlib import Path

import numpy as np
from harness import JOINTS, Use, answer, arguments, covariances, errors, rendered, scene_from, tracked, truth_of
from scipy.optimize import least_squares

from posefuse_sim.fitting import everyday_scene

DURATION_S, RATE_HZ = 4.0, 30.0
MOST_LAG_S = 1.0
# an error of more sigmas is a confusion
MOST_SIGMAS = 5.0


def session(out: Path, i: int) -> Path:
    """Every other scene of the noise fit, which take its motions by turns."""
    content = everyday_scene(2 * i) | {"duration_s": DURATION_S, "rate_hz": RATE_HZ}
    return rendered(scene_from(content, Use.FIT), out / f"scene{i:02d}", Use.FIT)


def whitened_errors(session: Path) -> np.ndarray:
    """(T, J, 3) errors of the fused joints, time step by time step, in units of their stated covariance."""
    poses = tracked(session, raw=True).poses
    single = [poses.at(i) for i in range(len(poses))]
    error, cov = errors(single, truth_of(session), JOINTS), covariances(single, JOINTS)
    known = np.isfinite(error).all(-1) & np.isfinite(cov).all((-1, -2))
    factor = np.linalg.cholesky(np.where(known[..., None, None], cov, np.eye(3)))
    white = np.linalg.solve(factor, np.where(known[..., None], error, np.nan)[..., None])[..., 0]
    return np.where(np.linalg.norm(white, axis=-1, keepdims=True) < MOST_SIGMAS, white, np.nan)


def autocorrelation(white: list[np.ndarray]) -> np.ndarray:
    """(L,) of lag 0, 1, ... frames, over all scenes, joints and axes; about zero, not about the mean."""
    lags = range(int(MOST_LAG_S * RATE_HZ))
    products = [np.nanmean(np.concatenate([(e[: len(e) - lag] * e[lag:]).ravel() for e in white])) for lag in lags]
    return np.array(products) / products[0]


def fit(white: list[np.ndarray]) -> tuple[float, float, float]:
    """Share of the variance that lasts, the part of it that stays for good, and the time in s in which the rest fades by e."""
    found = autocorrelation(white)[1:]
    lag_s = np.arange(1, len(found) + 1) / RATE_HZ
    start, bounds = (0.4, 0.4, 0.3), ([0, 0, 0.01], [1, 1, 10])
    solved = least_squares(lambda p: p[0] + p[1] * np.exp(-lag_s / p[2]) - found, start, bounds=bounds)
    stays, fades, time_s = (float(value) for value in solved.x)
    return stays + fades, stays, time_s


def main() -> None:
    args = arguments(__doc__, positional=("out",), out=Path, scenes=4)
    white = [whitened_errors(session(args.out, i)) for i in range(args.scenes)]
    found, rows = autocorrelation(white), []
    for left_out in (None, *range(len(white))):
        share, stays, time_s = fit([one for i, one in enumerate(white) if i != left_out])
        rows.append({"without scene": left_out, "share": share, "of it for good": stays, "time_constant_s": time_s})
    lags = [{"lag in frames": lag, "autocorrelation": float(found[lag])} for lag in (1, 2, 4, 8, 15, 25)]
    answer(args, {"Errors over time": lags, "Lasting errors": rows})


if __name__ == "__main__":
    main()
