"""Time of fusing one person of 33 keypoints, and of whole recordings: a table on stderr, one JSON object on stdout.

    OPENBLAS_NUM_THREADS=1 python bench/fuse.py [--repeat 2000]

Processor time, so that other programs on the machine matter little. Undistortion, covariance and reprojection error are
included. "bad" cameras report every keypoint somewhere else.
"""

import time
from collections.abc import Callable
from itertools import product

import numpy as np
from harness import answer, arguments
from scenes import ring

from posefuse.core import SKELETONS, Rig, Views
from posefuse.fusion import FuseSettings, fuse, triangulate

KEYPOINTS = 33
SIGMA_PX = 2.0
LENS = (-0.2, 0.05, 0.001, -0.002, 0.01)
BLAZEPOSE = SKELETONS["blazepose33"]


def scene(rig: Rig, steps: int, bad: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Raw pixels (T, C, K, 2), score and sigma (T, C, K) of random bodies, the first `bad` cameras wrong."""
    rng = np.random.default_rng(seed)
    xyz = rng.normal(size=(steps, KEYPOINTS, 3)) * [0.3, 0.3, 0.5] + [0, 0, 1]
    xy = np.moveaxis(rig.project(xyz), 0, 1) + rng.normal(size=(steps, len(rig), KEYPOINTS, 2)) * SIGMA_PX
    xy[:, :bad] += rng.normal(size=xy[:, :bad].shape) * 100
    return xy, rng.uniform(0.5, 1.0, xy.shape[:-1]), np.full(xy.shape[:-1], SIGMA_PX)


def microseconds(call: Callable[..., object], inputs: list[tuple], repeat: int) -> tuple[float, float]:
    """Median and 99th percentile of call(*inputs[i])."""
    for given in inputs[:50]:
        call(*given)
    taken = np.empty(repeat)
    for i in range(repeat):
        given = inputs[i % len(inputs)]
        start = time.process_time_ns()
        call(*given)
        taken[i] = time.process_time_ns() - start
    return float(np.median(taken)) / 1e3, float(np.quantile(taken, 0.99)) / 1e3


def single(repeat: int) -> list[dict]:
    rows = []
    for cameras, bad in ((4, 0), (8, 0), (8, 4), (16, 0), (16, 4)):
        rig = ring(cameras, (1280, 720), 1000.0, lens=LENS)
        seen = list(zip(*scene(rig, 200, bad), strict=True))
        about = {"t_ns": 0, "skeleton": BLAZEPOSE, "camera_names": rig.names, "person_id": [0]}
        views = [Views(**about, xy_img=xy[None], score=score[None], sigma_px=sigma[None]) for xy, score, sigma in seen]
        for weights in ("score", "robust"):
            settings, row = FuseSettings(weights=weights), {"cameras": cameras, "bad": bad, "weights": weights}
            row["triangulate_us"], row["triangulate_p99_us"] = microseconds(
                triangulate, [(rig, *planes, weights) for planes in seen], repeat
            )
            row["fuse_us"], row["fuse_p99_us"] = microseconds(fuse, [(view, rig, settings) for view in views], repeat)
            rows.append(row)
    return rows


def batched(steps: int = 4000) -> list[dict]:
    rows = []
    for cameras, weights in product((4, 8), ("score", "robust")):
        rig = ring(cameras, (1280, 720), 1000.0, lens=LENS)
        xy, score, sigma = scene(rig, steps, 0)
        median_us, _ = microseconds(triangulate, [(rig, xy, score, sigma, weights)], 5)
        rows.append({"cameras": cameras, "weights": weights, "million keypoints per s": steps * KEYPOINTS / median_us})
    return rows


def main() -> None:
    args = arguments(__doc__, repeat=2000)
    solves = f"One person, {KEYPOINTS} keypoints, microseconds of processor time: median and 99th percentile"
    answer(args, {solves: single(args.repeat), "Whole recording, one core": batched()})


if __name__ == "__main__":
    main()
