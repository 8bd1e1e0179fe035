"""Fit the noise model of the BlazePose landmark network on rendered people, whose keypoints are known exactly.

    python bench/fit_blazepose_noise.py render OUT     draw the scenes (minutes; may be interrupted and resumed)
    python bench/fit_blazepose_noise.py fit OUT        fit, print the calibration by score, write the model file

Bodies, motions and cameras are drawn for this purpose alone; none of them appears in a reported measurement.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

MOTIONS = [
    {"kind": "squat", "period_s": 5.3},
    {"kind": "reach", "side": "left", "period_s": 1.9},
    {"kind": "walk", "path": {"shape": "line", "start_m": [-1.6, -0.9], "end_m": [1.5, 1.1]}, "speed_mps": 0.8},
    {"kind": "idle", "sway": 2.0},
    {"kind": "wave", "side": "left", "period_s": 2.3},
    {"kind": "reach", "side": "right", "period_s": 2.3},
    {"kind": "walk", "path": {"shape": "circle", "radius_m": 1.0, "clockwise": True}, "speed_mps": 0.7},
    {"kind": "squat", "period_s": 3.7, "knee_flexion_deg": 115},
]
FLOORS = ("wood", "concrete", "tiles", "plain")


def scene_settings(i: int) -> dict:
    """One scene: its own body, motion, room, clutter and cameras."""
    rng = np.random.default_rng(90_000 + i)
    motion = dict(MOTIONS[i % len(MOTIONS)])
    if motion["kind"] != "walk":
        motion |= {"position_m": rng.uniform(-0.6, 0.6, 2).round(2).tolist(), "heading_deg": float(rng.integers(0, 360))}
    cameras = {
        "kind": "ring",
        "count": 4,
        "radius_m": round(rng.uniform(3.2, 5.5), 2),
        "height_m": round(rng.uniform(1.0, 2.7), 2),
        "first_angle_deg": float(rng.integers(0, 90)),
        "image": {"size_px": [[640, 480], [1280, 720]][i % 2], "horizontal_fov_deg": float(rng.integers(58, 75))},
        "sensor": {"noise_dn": 1.5},
    }
    clutter = [{"kind": "clutter", "count": 7, "area_m": [6, 6], "keep_clear_m": 0.9, "most_height_m": 1.3}] if i % 3 == 1 else []
    return {
        "duration_s": 8.0,
        "rate_hz": 2.5,
        "seed": 500 + i,
        "cameras": cameras,
        "people": [{"body": {"random_seed": 7000 + i}, "motion": motion}],
        "occluders": clutter,
        "room": {"floor": FLOORS[i % 4], "walls": ("office", "plain")[i // 2 % 2], "brightness": round(rng.uniform(0.7, 1.2), 2)},
        "record": {"kind": "jpeg", "quality": 90},
    }


def render(out: Path, scenes: int) -> None:
    from posefuse.files.settings import settings_from_mapping
    from posefuse.simulate.scene import Scene
    from posefuse.simulate.session import simulate

    for i in range(scenes):
        folder = out / f"scene{i:02d}"
        if (folder / "truth" / "truth.npz").exists() and not (folder / "INCOMPLETE").exists():
            continue
        simulate(settings_from_mapping(scene_settings(i), Scene, where=f"scene {i}"), folder, processes=1)
        print(f"{folder.name}: done", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("step", choices=("render", "fit"))
    parser.add_argument("out", type=Path)
    parser.add_argument("--scenes", type=int, default=24)
    arguments = parser.parse_args()
    if arguments.step == "render":
        render(arguments.out, arguments.scenes)


if __name__ == "__main__":
    main()
