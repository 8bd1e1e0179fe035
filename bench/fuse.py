"""Time of fusing one person of 33 keypoints, and of whole recordings: a table on stderr, one JSON object on stdout.

    OPENBLAS_NUM_THREADS=1 python bench/fuse.py [--repeat 2000]

Processor time, so that other programs on the machine matter little. Undistortion, covariance and reprojection error are
included. "bad" cameras report every keypoint somewhere else.
"""

import argparse
import json
import sys
import time
from collections.abc import Callable

import numpy as np
from rich.console import Console
from rich.table import Table

from posefuse.core import SKELETONS, Camera, Rig, Views
from posefuse.fusion import FuseSettings, fuse, triangulate
from posefuse.simulation.cameras import looking_at

KEYPOINTS = 33
SIGMA_PX = 2.0
LENS = np.array([-0.2, 0.05, 0.001, -0.002, 0.01])
BLAZEPOSE = SKELETONS["blazepose33"]


def ring(count: int) -> Rig:
    """Cameras on a circle of 4.5 m that look at a point 1 m above its centre."""
    intrinsics = np.array([[1000.0, 0, 639.5], [0, 1000.0, 359.5], [0, 0, 1]])
    cameras = []
    for i in range(count):
        angle = 2 * np.pi * i / count
        centre = np.array([4.5 * np.cos(angle), 4.5 * np.sin(angle), 2.2])
        pose = looking_at(centre, np.array([0, 0, 1.0]))
        cameras.append(Camera(name=f"cam{i:02d}", size_wh=(1280, 720), K=intrinsics, cam_from_world=pose, distortion=LENS))
    return Rig(tuple(cameras))


def scene(rig: Rig, instants: int, bad: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Raw pixels (T, C, K, 2), score and sigma (T, C, K) of random bodies, the first `bad` cameras wrong."""
    rng = np.random.default_rng(seed)
    xyz = rng.normal(size=(instants, KEYPOINTS, 3)) * [0.3, 0.3, 0.5] + [0, 0, 1]
    xy = np.moveaxis(rig.project(xyz), 0, 1) + rng.normal(size=(instants, len(rig), KEYPOINTS, 2)) * SIGMA_PX
    xy[:, :bad] += rng.normal(size=xy[:, :bad].shape) * 100
    return xy, rng.uniform(0.5, 1.0, xy.shape[:-1]), np.full(xy.shape[:-1], SIGMA_PX)


def microseconds(call: Callable[..., object], inputs: list[tuple], repeat: int) -> tuple[float, float]:
    """Median and 99th percentile of call(*inputs[i])."""
    for arguments in inputs[:50]:
        call(*arguments)
    taken = np.empty(repeat)
    for i in range(repeat):
        arguments = inputs[i % len(inputs)]
        start = time.process_time_ns()
        call(*arguments)
        taken[i] = time.process_time_ns() - start
    return float(np.median(taken)) / 1e3, float(np.quantile(taken, 0.99)) / 1e3


def single(repeat: int) -> list[dict[str, float | str | int]]:
    rows = []
    for cameras, bad in ((4, 0), (8, 0), (8, 4), (16, 0), (16, 4)):
        rig = ring(cameras)
        seen = list(zip(*scene(rig, 200, bad), strict=True))
        views = [
            Views(
                t_ns=0,
                skeleton=BLAZEPOSE,
                camera_names=rig.names,
                person_id=[0],
                xy_img=xy[None],
                score=score[None],
                sigma_px=sigma[None],
            )
            for xy, score, sigma in seen
        ]
        for weights in ("score", "robust"):
            settings = FuseSettings(weights=weights)
            median, p99 = microseconds(triangulate, [(rig, *planes, weights) for planes in seen], repeat)
            fused, fused_p99 = microseconds(fuse, [(view, rig, settings) for view in views], repeat)
            rows.append(
                {
                    "cameras": cameras, "bad": bad, "weights": weights, "triangulate_us": median,
                    "triangulate_p99_us": p99, "fuse_us": fused, "fuse_p99_us": fused_p99,
                }
            )  # fmt: skip
    return rows


def batched(instants: int = 4000) -> list[dict[str, float | str | int]]:
    rows = []
    for cameras in (4, 8):
        rig = ring(cameras)
        xy, score, sigma = scene(rig, instants, 0)
        for weights in ("score", "robust"):
            triangulate(rig, xy[:2], score[:2], sigma[:2], weights)
            taken = []
            for _ in range(5):
                start = time.process_time()
                triangulate(rig, xy, score, sigma, weights)
                taken.append(time.process_time() - start)
            rows.append(
                {"cameras": cameras, "weights": weights, "keypoints_per_s": instants * KEYPOINTS / float(np.median(taken))}
            )
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeat", type=int, default=2000)
    repeat = parser.parse_args().repeat
    solves, rates = single(repeat), batched()
    console = Console(stderr=True)
    table = Table(title=f"one person, {KEYPOINTS} keypoints, microseconds of processor time: median (p99)")
    for column in ("cameras", "bad", "weights", "triangulate", "fuse"):
        table.add_column(column, justify="right")
    for row in solves:
        table.add_row(
            str(row["cameras"]), str(row["bad"]), str(row["weights"]),
            f"{row['triangulate_us']:.0f} ({row['triangulate_p99_us']:.0f})", f"{row['fuse_us']:.0f} ({row['fuse_p99_us']:.0f})",
        )  # fmt: skip
    console.print(table)
    table = Table(title="whole recording, one core: million 3D keypoints per second")
    for column in ("cameras", "weights", "rate"):
        table.add_column(column, justify="right")
    for row in rates:
        table.add_row(str(row["cameras"]), str(row["weights"]), f"{row['keypoints_per_s'] / 1e6:.2f}")
    console.print(table)
    json.dump({"solve": solves, "batch": rates}, sys.stdout, indent=1)
    print()


if __name__ == "__main__":
    main()
