"""Live tracking of moving people: how far the skeleton is from the truth at the moment it comes out.

    python bench/live_tracking.py [--seconds 20] [--cameras 4] [--seed 0]

Cameras of 30 frames/s that are not synchronised (random phases), every view 25 to 125 ms old when it arrives, 5 % lost; output
at 100 Hz. Noise as the default network's on the demo clip: its size, and how much of it lasts from frame to frame. A table
on stderr, one JSON object on stdout. NEES is the squared error in units of the stated covariance: 3 when it is honest.

Two more rows show what limits the tracker: *exact views* leaves what cannot be foreseen while views are on their
way, *at once* (views without latency) what noise leaves.
"""

import argparse
import json
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from live_motions import Place, jumping, swinging
from rich.console import Console
from rich.table import Table

from posefuse.association import AssociateSettings
from posefuse.core import Detections2D, Pose3D, Rig, Skeleton
from posefuse.core.skeleton import ANATOMICAL23
from posefuse.foundation.settings import settings_from_mapping
from posefuse.fusion import FuseSettings
from posefuse.realtime.estimator import build_fuse, build_solve
from posefuse.simulation.build import live_scene
from posefuse.simulation.scene import Scene
from posefuse.tracking.online import LiveSettings, Tracker, build_tracker

RATE_HZ, OUTPUT_HZ = 30.0, 100.0
LATENCY_S, LOST = (0.025, 0.125), 0.05
# of the default network on the demo clip, in px of 640 x 480: standard deviation, and how its variance divides
SIGMA_PX, CONSTANT, SLOW, SLOW_S = 2.4, 0.15, 0.6, 0.25
OUTLIERS, OUTLIER_PX, SWAPS = 0.01, 60.0, 0.01
WARM_UP_S = 1.0
MOTIONS = {
    "stand": {"kind": "idle"},
    "walk": {"kind": "walk", "path": {"shape": "circle", "radius_m": 1.4}, "speed_mps": 1.35},
    "arm swing": {"kind": "idle"},
    "jump": {"kind": "idle"},
}
# where each motion is fast: the keypoints whose error counts as moving; others: all
FAST = {
    "walk": ("left_ankle", "right_ankle", "left_wrist", "right_wrist"),
    "arm swing": ("left_wrist", "right_wrist", "left_elbow", "right_elbow"),
}

# the least noise the tracker reckons with, and no confusions
LIMITS: dict[str, dict] = {"exact views": {"sigma_px": 0.3}, "at once": {"latency_s": (0.0, 0.001)}}


@dataclass(frozen=True)
class Arrival:
    """A view and when it reaches the tracker."""

    at_ns: int
    view: Detections2D


def scene_of(motion: str, cameras: int, seconds: float, seed: int) -> tuple[Rig, Place]:
    """Cameras on a ring, and where the person of a reported motion is."""
    rig, place = scene_of_person(MOTIONS[motion], cameras, seconds, seed)
    return rig, {"jump": jumping, "arm swing": swinging}.get(motion, lambda same: same)(place)


def scene_of_person(motion: dict, cameras: int, seconds: float, seed: int) -> tuple[Rig, Place]:
    """Cameras on a ring, and the keypoints (T, 23, 3) at any times (T,) in seconds of a person who moves like that."""
    content = {"duration_s": seconds, "seed": seed, "cameras": {"kind": "ring", "count": cameras}, "people": [{"motion": motion}]}
    live = live_scene(settings_from_mapping(content, Scene, "bench"))
    return live.rig, lambda t_s: live.keypoints(t_s)[:, 0]


def noise(rng: np.random.Generator, t_s: np.ndarray, keypoints: int) -> np.ndarray:
    """(T, K, 2) errors of one camera in sigmas: a constant, a slowly wandering and a white part."""
    shape = (len(t_s), keypoints, 2)
    slow = rng.standard_normal(shape)
    for i in range(1, len(t_s)):
        keep = np.exp(-(t_s[i] - t_s[i - 1]) / SLOW_S)
        slow[i] = keep * slow[i - 1] + np.sqrt(1 - keep**2) * slow[i]
    constant = rng.standard_normal(shape[1:])
    return np.sqrt(CONSTANT) * constant + np.sqrt(SLOW) * slow + np.sqrt(1 - CONSTANT - SLOW) * rng.standard_normal(shape)


def arrivals(
    rig: Rig, place: Place, seconds: float, seed: int, sigma_px: float = SIGMA_PX, latency_s: tuple[float, float] = LATENCY_S
) -> list[Arrival]:
    """Every view of every camera in the order of arrival."""
    found = []
    confused = sigma_px == SIGMA_PX
    for c, camera in enumerate(rig):
        rng = np.random.default_rng([seed, c])
        t_s = rng.uniform(0, 1 / RATE_HZ) + np.arange(int(seconds * RATE_HZ) - 1) / RATE_HZ
        t_s = t_s[rng.random(len(t_s)) >= LOST]
        exact = camera.project(place(t_s))
        xy = exact + sigma_px * noise(rng, t_s, exact.shape[1])
        wild = rng.random(xy.shape[:2]) < OUTLIERS * confused
        xy[wild] = exact[wild] + rng.uniform(-OUTLIER_PX, OUTLIER_PX, (wild.sum(), 2))
        swapped = rng.random(len(t_s)) < SWAPS * confused
        xy[swapped] = xy[swapped][:, ANATOMICAL23.mirror]
        late_s = rng.uniform(*latency_s, len(t_s))
        for i, t in enumerate(t_s):
            view = view_of(camera.name, round(t * 1e9), ANATOMICAL23, xy[i], sigma_px)
            found.append(Arrival(round((t + late_s[i]) * 1e9), view))
    return sorted(found, key=lambda one: one.at_ns)


def view_of(camera: str, t_ns: int, skeleton: Skeleton, xy: np.ndarray, sigma_px: float = SIGMA_PX) -> Detections2D:
    """One person in one view."""
    k = len(skeleton)
    box = np.concatenate([xy.min(axis=0), xy.max(axis=0)])
    return Detections2D(
        camera=camera,
        t_ns=t_ns,
        skeleton=skeleton,
        xy_img=xy[None],
        score=np.full((1, k), 0.9),
        sigma_px=np.full((1, k), sigma_px),
        box_img=box[None],
    )


def new_tracker(rig: Rig, skeleton: Skeleton, settings: LiveSettings) -> Tracker:
    """With association and fusion of one time step as the live pipeline has them."""
    solve, fuse = build_solve(rig, AssociateSettings(), FuseSettings()), build_fuse(rig, FuseSettings())
    return build_tracker(rig, skeleton, settings, solve, fuse)


def tracked(rig: Rig, come: Sequence[Arrival], seconds: float, settings: LiveSettings) -> Iterator[Pose3D]:
    """What comes out at 100 Hz after the warm-up."""
    tracker = new_tracker(rig, ANATOMICAL23, settings)
    waiting = iter(come)
    head = next(waiting, None)
    for tick in range(int(seconds * OUTPUT_HZ)):
        t_ns = round(tick / OUTPUT_HZ * 1e9)
        while head is not None and head.at_ns <= t_ns:
            tracker.add(head.view)
            head = next(waiting, None)
        pose = tracker.at(t_ns)
        if t_ns >= WARM_UP_S * 1e9:
            yield pose


def accuracy(
    rig: Rig, place: Place, moving: Sequence[str], come: Sequence[Arrival], seconds: float, settings: LiveSettings
) -> dict:
    """Errors of the first person against the truth at output time, and of the keypoints `moving` fast."""
    poses = list(tracked(rig, come, seconds, settings))
    missing = np.full((len(ANATOMICAL23), 3), np.nan)
    got = np.array([pose.xyz_world[0] if len(pose.person_id) else missing for pose in poses])
    cov = np.array([pose.cov_world[0] if len(pose.person_id) else np.full((len(missing), 3, 3), np.nan) for pose in poses])
    error = got - place(np.array([pose.t_ns for pose in poses]) / 1e9)
    away_mm = 1000 * np.linalg.norm(error, axis=-1)
    nees = np.einsum("tki,tkij,tkj->tk", error, np.linalg.inv(np.where(np.isfinite(cov), cov, np.eye(3))), error)
    fast = ANATOMICAL23.indices(moving)
    found = np.isfinite(away_mm)
    return {
        "mean_mm": float(away_mm[found].mean()),
        "p95_mm": float(np.percentile(away_mm[found], 95)),
        "fast_mean_mm": float(np.nanmean(away_mm[:, fast])),
        "fast_p95_mm": float(np.nanpercentile(away_mm[:, fast], 95)),
        "nees": float(nees[found].mean()),
        "nees_median": float(np.median(nees[found])),
        "fast_nees": float(np.nanmean(nees[:, fast])),
        "found": float(found.mean()),
    }


def speed(seconds: float, keypoints_of: Skeleton, cameras: int, seed: int) -> dict:
    """Microseconds of one `add` and one `at` for one person of 33 keypoints who walks."""
    rig, place = scene_of("walk", cameras, seconds, seed)
    places = np.resize(np.arange(len(ANATOMICAL23)), len(keypoints_of))
    tracker = new_tracker(rig, keypoints_of, LiveSettings())
    come = arrivals(rig, place, seconds, seed)
    add_us, at_us = [], []
    tick = 0
    for one in come:
        view = view_of(one.view.camera, one.view.t_ns, keypoints_of, one.view.xy_img[0, places])
        began = time.perf_counter()
        tracker.add(view)
        add_us.append(1e6 * (time.perf_counter() - began))
        while tick / OUTPUT_HZ * 1e9 <= one.at_ns:
            began = time.perf_counter()
            tracker.at(round(tick / OUTPUT_HZ * 1e9))
            at_us.append(1e6 * (time.perf_counter() - began))
            tick += 1
    return {
        "add_us_median": float(np.median(add_us)),
        "add_us_p95": float(np.percentile(add_us, 95)),
        "at_us_median": float(np.median(at_us)),
        "at_us_p95": float(np.percentile(at_us, 95)),
    }


def show(figures: dict) -> None:
    console = Console(stderr=True, width=120)
    table = Table(title="Error against the truth at output time, mm", title_justify="left")
    for column in ("motion", "tracker", "mean", "p95", "fast mean", "fast p95", "NEES", "fast NEES", "found"):
        table.add_column(column)
    for motion, rows in figures["accuracy"].items():
        for tracker, row in rows.items():
            errors = [f"{row[key]:.1f}" for key in ("mean_mm", "p95_mm", "fast_mean_mm", "fast_p95_mm", "nees", "fast_nees")]
            table.add_row(motion, tracker, *errors, f"{row['found']:.1%}")
    console.print(table)
    took = figures["speed"]
    console.print(
        f"33 keypoints: add {took['add_us_median']:.0f} us (p95 {took['add_us_p95']:.0f}), "
        f"at {took['at_us_median']:.0f} us (p95 {took['at_us_p95']:.0f})"
    )


def main() -> None:
    from posefuse.core.skeleton import BLAZEPOSE33

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--cameras", type=int, default=4)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    figures: dict = {"cameras": args.cameras, "seconds": args.seconds, "accuracy": {}}
    for motion in MOTIONS:
        rig, place = scene_of(motion, args.cameras, args.seconds, args.seed)
        come = arrivals(rig, place, args.seconds, args.seed)
        moving = FAST.get(motion, ANATOMICAL23.keypoints)
        rows = {"as in use": accuracy(rig, place, moving, come, args.seconds, LiveSettings())}
        for limit, changes in LIMITS.items():
            easier = arrivals(rig, place, args.seconds, args.seed, **changes)
            rows[limit] = accuracy(rig, place, moving, easier, args.seconds, LiveSettings())
        figures["accuracy"][motion] = rows
    figures["speed"] = speed(min(args.seconds, 10.0), BLAZEPOSE33, args.cameras, args.seed)
    show(figures)
    print(json.dumps(figures, indent=2))


if __name__ == "__main__":
    sys.exit(main())
