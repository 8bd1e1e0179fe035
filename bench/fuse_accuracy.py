"""Accuracy of the weightings on synthetic people with outliers: a table on stderr, one JSON object on stdout.

    python bench/fuse_accuracy.py [--steps 300]

26 points of a body, pixel noise that follows the score (as in real detections: sigma = 3 px / score, scores 0.3 to 1),
and a share of views that are simply elsewhere with a score of 0.2 to 0.9. `exclusion` is the idea of dropping the subset
of cameras whose removal brings the reprojection error under a threshold, written here from its description.
"""

import argparse
import json
import sys
import time
from itertools import combinations

import numpy as np
from fuse import ring
from rich.console import Console
from rich.table import Table

from posefuse.core import SKELETONS, Rig
from posefuse.fusion import FuseSettings, triangulate

POINTS = 26
EXCLUDE_ABOVE_PX = 15.0


def scene(rig: Rig, instants: int, wrong: float, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Truth (T, K, 3), raw pixels (T, C, K, 2), score and true sigma (T, C, K)."""
    rng = np.random.default_rng(seed)
    xyz = rng.normal(size=(instants, POINTS, 3)) * [0.25, 0.25, 0.45] + [0, 0, 1]
    score = rng.uniform(0.3, 1.0, (instants, len(rig), POINTS))
    sigma = 3.0 / score
    xy = np.moveaxis(rig.project(xyz), 0, 1) + rng.normal(size=(*score.shape, 2)) * sigma[..., None]
    elsewhere = rng.random(score.shape) < wrong
    count = int(elsewhere.sum())
    turn = rng.uniform(0, 2 * np.pi, count)
    xy[elsewhere] += rng.uniform(40, 300, (count, 1)) * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    score[elsewhere] = rng.uniform(0.2, 0.9, count)
    return xyz, xy, score, sigma


def exclusion(rig: Rig, xy: np.ndarray, score: np.ndarray) -> np.ndarray:
    """(T, K, 3) by score-weighted least squares over the largest camera subset under the threshold, best of its size."""
    best = triangulate(rig, xy, score, weights="score", settings=FuseSettings(score_threshold=0.3))
    xyz, error = best.xyz, np.where(np.isnan(best.reproj), np.inf, best.reproj)
    for left_out in range(1, len(rig) - 1):
        pending = error > EXCLUDE_ABOVE_PX
        if not pending.any():
            break
        for cameras in combinations(range(len(rig)), left_out):
            fewer = score.copy()
            fewer[:, list(cameras)] = 0
            trial = triangulate(rig, xy, fewer, weights="score", settings=FuseSettings(score_threshold=0.3))
            better = pending & (trial.reproj < error)
            xyz, error = np.where(better[..., None], trial.xyz, xyz), np.where(better, trial.reproj, error)
    return xyz


def measure(cameras: int, wrong: float, instants: int) -> list[dict[str, float | str | int]]:
    rig = ring(cameras)
    truth, xy, score, sigma = scene(rig, instants, wrong, seed=cameras)
    rows = []
    for name in ("none", "score", "all", "exclusion", "robust", "robust, true sigma"):
        start = time.perf_counter()
        cov = None
        if name == "exclusion":
            xyz = exclusion(rig, xy, score)
        else:
            skeleton = SKELETONS["body_25"] if name == "all" else None
            if name == "all":
                # 25 named keypoints; the 26th has no segment and keeps its plain score weight
                found = triangulate(rig, xy[:, :, :25], score[:, :, :25], weights="all", skeleton=skeleton)
                rest = triangulate(rig, xy[:, :, 25:], score[:, :, 25:], weights="score")
                xyz = np.concatenate([found.xyz, rest.xyz], axis=1)
            else:
                found = triangulate(rig, xy, score, sigma if "true" in name else None, "robust" if "robust" in name else name)
                xyz, cov = found.xyz, found.cov
        taken = time.perf_counter() - start
        off = np.linalg.norm(xyz - truth, axis=-1)
        error = xyz - truth
        nees = np.nan if cov is None else np.nanmean(np.einsum("tki,tkij,tkj->tk", error, np.linalg.inv(cov), error))
        rows.append(
            {
                "cameras": cameras, "outliers": wrong, "weights": name, "mean_mm": float(np.nanmean(off)) * 1e3,
                "median_mm": float(np.nanmedian(off)) * 1e3, "p99_mm": float(np.nanquantile(off, 0.99)) * 1e3,
                "missing": float(np.isnan(off).mean()), "nees": float(nees), "ms_per_instant": taken / instants * 1e3,
            }
        )  # fmt: skip
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=300)
    instants = parser.parse_args().steps
    rows = [row for cameras, wrong in ((4, 0.0), (4, 0.05), (8, 0.1)) for row in measure(cameras, wrong, instants)]
    table = Table(title=f"{POINTS} points, millimetres")
    for column in ("cameras", "outliers", "weights", "mean", "median", "p99", "missing", "NEES", "ms/time step"):
        table.add_column(column, justify="right")
    for row in rows:
        table.add_row(
            str(row["cameras"]), f"{row['outliers']:.0%}", str(row["weights"]), f"{row['mean_mm']:.1f}",
            f"{row['median_mm']:.1f}", f"{row['p99_mm']:.0f}", f"{row['missing']:.2%}", f"{row['nees']:.1f}",
            f"{row['ms_per_instant']:.2f}",
        )  # fmt: skip
    Console(stderr=True).print(table)
    json.dump(rows, sys.stdout, indent=1)
    print()


if __name__ == "__main__":
    main()
