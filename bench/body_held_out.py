"""The whole-body fit on rendered people who are used in no fit and no choice: errors with it and without it.

    python bench/body_held_out.py OUT [--for-s 500]     render and measure what is not there yet, then print the table

Twelve bodies of random seeds that were fixed before any of them was looked at; five motions each. OUT keeps the rendered scenes
and one line of figures per scene, so that the work can be done in slices; with another version of the code, delete
OUT/figures.jsonl. A table on stderr, one JSON object on stdout.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from posefuse.core import PoseSequence, Recording, Truth
from posefuse.core.skeleton import PAPER14, pick_keypoints
from posefuse.evaluation.metrics import joint_errors, true_xyz_at, typical_nees
from posefuse.formats.truth import read_truth
from posefuse.foundation.settings import settings_from_mapping
from posefuse.kinematics import JOINT_NAMES, joints_from_poses
from posefuse.pipeline.clock import StageClock
from posefuse.pipeline.config import changed_config, read_config
from posefuse.pipeline.run import track_session
from posefuse.pipeline.session import find_session
from posefuse.pipeline.solve import config_of, solve_again
from posefuse.simulation.scene import Scene
from posefuse.simulation.session import simulate
from posefuse.tracking.segments import SEGMENTS, segment_lengths

SEEDS = tuple(range(9101, 9113))
SIDES = ("left", "right")
JOINTS = tuple(joint for joint in PAPER14.keypoints if joint not in ("neck", "mid_hip"))
FLEXIONS = ("hip", "knee", "elbow")
SIGMAS_90 = 1.645
WALK = {"kind": "walk", "speed_mps": 1.35, "path": {"shape": "random", "low_m": [-1.8, -1.8], "high_m": [1.8, 1.8]}}
OCCLUDERS = (
    {"kind": "wall", "from_m": [1.5, -0.6], "to_m": [1.4, 0.8], "height_m": 1.3},
    {"kind": "wall", "from_m": [-0.5, 1.6], "to_m": [-1.4, 1.2], "height_m": 1.5},
    {"kind": "box", "position_m": [-1.6, -0.8, 0.6], "size_m": [0.5, 0.7, 1.2], "yaw_deg": 20},
)


def scene_of(seed: int, motion: str) -> Scene:
    """One body doing one thing; the rest of the scene is drawn by the same seed."""
    side = SIDES[seed % 2]
    moves: dict[str, dict[str, Any]] = {
        "walk": WALK,
        "T-pose": {"kind": "tpose"},
        "T-pose, occluded": {"kind": "tpose"},
        "squat": {"kind": "squat", "period_s": 2.7, "heading_deg": float(seed * 53 % 360)},
        "reach": {"kind": "reach", "side": side, "period_s": 1.5, "heading_deg": float(seed * 31 % 360)},
    }
    still = motion.startswith("T-pose")
    image = {"size_px": [640, 480], "horizontal_fov_deg": 60 if still else 66}
    content = {
        "duration_s": 0.5 if still else 4.0 if motion == "walk" else 2.0,
        "rate_hz": 10,
        "seed": seed,
        "cameras": {"kind": "ring", "count": 8 if still else 4, "radius_m": 4.5, "height_m": 2.2, "image": image},
        "people": [{"body": {"random_seed": seed}, "motion": moves[motion]}],
        "occluders": list(OCCLUDERS) if "occluded" in motion else [],
    }
    return settings_from_mapping(content, Scene, where=f"{motion} {seed}")


MOTIONS = ("walk", "T-pose", "T-pose, occluded", "reach", "squat")


def recordings(folder: Path) -> dict[str, Recording]:
    """Tracked once, solved without and with the whole-body fit."""
    config = replace(read_config(None, ()), outputs=(), body="off")

    def silent(*_: object) -> None: ...

    off = track_session(find_session(folder, config), config, StageClock(), silent, silent, silent).recording
    return {"off": off, "on": solve_again(off, changed_config(config_of(off), {"body": "on"}))}


def figures(poses: PoseSequence, truth: Truth) -> dict[str, Any]:
    """What the table is made of, of one scene."""
    errors = joint_errors(poses, truth)
    inside = (poses.t_ns >= truth.t_ns[0]) & (poses.t_ns <= truth.t_ns[-1])
    true_xyz = true_xyz_at(truth, poses.t_ns[inside])[:, 0]
    away = poses.xyz_world[inside, 0][:, poses.skeleton.indices(JOINTS)] - pick_keypoints(true_xyz, truth.skeleton, JOINTS)
    sigma = np.sqrt(np.diagonal(poses.cov_world[inside, 0][:, poses.skeleton.indices(JOINTS)], axis1=-2, axis2=-1))
    lengths, true_lengths = (segment_lengths(one.xyz_world, one.skeleton)[0] for one in (poses, truth))
    return {
        "mean_mm": errors.mpjpe_mm,
        "joints_mm": dict(zip(errors.joints, errors.mean_mm.tolist(), strict=True)),
        "nees": typical_nees(poses, truth, JOINTS),
        "within_90": dict(zip(JOINTS, np.mean(np.abs(away) < SIGMAS_90 * sigma, axis=(0, 2)).tolist(), strict=True)),
        "length_off": dict(zip(SEGMENTS, (np.abs(lengths - true_lengths) / true_lengths).tolist(), strict=True)),
        "flexion_deg": flexion_errors(poses, truth, inside, true_xyz),
    }


def flexion_errors(poses: PoseSequence, truth: Truth, inside: np.ndarray, true_xyz: np.ndarray) -> dict[str, float]:
    """RMSE of flexion angles in degrees, both sides together."""
    shape = true_xyz.shape[:2]
    exact = PoseSequence(
        t_ns=poses.t_ns[inside],
        skeleton=truth.skeleton,
        person_id=np.arange(1),
        xyz_world=true_xyz[:, None],
        cov_world=np.broadcast_to(np.eye(3) * 1e-8, (shape[0], 1, shape[1], 3, 3)),
        reproj_px=np.ones((shape[0], 1, shape[1])),
        n_views=np.full((shape[0], 1, shape[1]), 4),
        kind=np.ones((shape[0], 1, shape[1])),
    )
    got, wanted = joints_from_poses(poses).angle_rad[inside, 0], joints_from_poses(exact).angle_rad[:, 0]
    out = {}
    for joint in FLEXIONS:
        at = [JOINT_NAMES.index(f"{side}_{joint}") for side in SIDES]
        out[joint] = float(np.degrees(np.sqrt(np.nanmean((got[:, at, 0] - wanted[:, at, 0]) ** 2))))
    return out


def measured(out: Path, for_s: float) -> list[dict[str, Any]]:
    """A line per scene; renders and measures what is missing, for so long."""
    kept, began_s = out / "figures.jsonl", time.monotonic()
    lines = [json.loads(line) for line in kept.read_text().splitlines()] if kept.exists() else []
    done = {(line["seed"], line["motion"]) for line in lines}
    for motion in MOTIONS:
        for seed in SEEDS:
            if (seed, motion) in done or time.monotonic() - began_s > for_s:
                continue
            folder = out / f"{seed}-{motion.replace(', ', '-')}"
            if not (folder / "truth" / "truth.npz").exists() or (folder / "INCOMPLETE").exists():
                simulate(scene_of(seed, motion), folder, processes=1)
            truth = read_truth(folder / "truth" / "truth.npz")
            line = {"seed": seed, "motion": motion, **{k: figures(r.poses, truth) for k, r in recordings(folder).items()}}
            lines.append(line)
            with kept.open("a") as file:
                file.write(json.dumps(line) + "\n")
            print(f"{seed} {motion}: measured", flush=True)
    return lines


def mean_of(lines: list[dict[str, Any]], which: str, key: str, *inner: str) -> float:
    values = [[line[which][key][name] for name in inner] if inner else line[which][key] for line in lines]
    return float(np.nanmean(values)) if np.isfinite(values).any() else float("nan")


def summary(lines: list[dict[str, Any]]) -> dict[str, Any]:
    """By motion, without and with the fit."""
    out: dict[str, Any] = {}
    for motion in MOTIONS:
        some = [line for line in lines if line["motion"] == motion]
        if not some:
            continue
        row: dict[str, Any] = {"bodies": len(some)}
        row["bodies_better"] = sum(line["on"]["mean_mm"] < line["off"]["mean_mm"] for line in some)
        for which in ("off", "on"):
            per_joint = {joint: mean_of(some, which, "within_90", *(f"{s}_{joint}" for s in SIDES)) for joint in ends()}
            row[which] = {
                "mean_mm": mean_of(some, which, "mean_mm"),
                "worst_joint_mm": max(mean_of(some, which, "joints_mm", joint) for joint in PAPER14.keypoints),
                "nees": mean_of(some, which, "nees"),
                "within_90": per_joint,
                "length_off": {segment: mean_of(some, which, "length_off", segment) for segment in SEGMENTS},
                "flexion_deg": {joint: mean_of(some, which, "flexion_deg", joint) for joint in FLEXIONS},
            }
        out[motion] = row
    return out


def ends() -> tuple[str, ...]:
    return tuple(joint.removeprefix("left_") for joint in JOINTS if joint.startswith("left_"))


def show(found: dict[str, Any]) -> None:
    console = Console(stderr=True, width=170)
    table = Table(title="Held-out bodies, without -> with the whole-body fit", title_justify="left")
    for column in (
        "motion",
        "bodies (better)",
        "mean mm",
        "worst joint mm",
        "NEES",
        "90 % intervals hold",
        "flexion deg: hip, knee, elbow",
    ):
        table.add_column(column)
    for motion, row in found.items():
        off, on = row["off"], row["on"]
        holds = " ".join(f"{joint} {100 * on['within_90'][joint]:.0f}" for joint in ends())
        bends = " -> ".join(", ".join(f"{one['flexion_deg'][joint]:.1f}" for joint in FLEXIONS) for one in (off, on))
        pairs = [f"{off[key]:.1f} -> {on[key]:.1f}" for key in ("mean_mm", "worst_joint_mm", "nees")]
        table.add_row(motion, f"{row['bodies']} ({row['bodies_better']})", *pairs, holds, bends)
    console.print(table)
    if "walk" in found:
        off, on = (found["walk"][which]["length_off"] for which in ("off", "on"))
        told = ", ".join(f"{segment} {100 * off[segment]:.1f} -> {100 * on[segment]:.1f}" for segment in SEGMENTS)
        console.print(f"walking, lengths off by %: {told}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--for-s", type=float, default=1e9, help="begin no scene after so many seconds")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    found = summary(measured(arguments.out, arguments.for_s))
    show(found)
    print(json.dumps(found))


if __name__ == "__main__":
    main()
