"""Fit the offsets of joint centres from what the BlazePose network marks, on rendered people whose joint centres are known
exactly.

    python bench/fit_joint_centres.py render OUT            draw people moving all their joints about (minutes; resumes)
    python bench/fit_joint_centres.py render-varied OUT     draw walks and other motions; cameras, lenses, light, images vary
    python bench/fit_joint_centres.py fit OUT [MORE ...] [--card NAME] [--only ear,nose]
                                                            run the pipeline, fit, judge by bodies left out, write the card

MORE are folders of other rendered scenes, e.g. those of `fit_blazepose_noise.py`. Bodies and motions are drawn for these
two fits alone (bodies of random seeds 7000 to 7429); none of them appears in a reported measurement.
Tables on stderr, one JSON object on stdout, and the table of joint centres next to the card.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from harness import Row, Use, answer, arguments, checked, note, rendered, scene_from, tracked, truth_of
from scenes import walk

from posefuse.core import JointCentres, PoseSequence, Truth
from posefuse.core.skeleton import SIDES, pick_keypoints
from posefuse.detection.card import NetworkCard, read_card
from posefuse.evaluation.metrics import true_xyz_at
from posefuse.formats.joint_centres import read_joint_centres
from posefuse.tracking import to_joint_centres
from posefuse.tracking.body_directions import HEAD, keypoint_of
from posefuse.tracking.joint_centres import JOINTS, joint_directions
from posefuse_sim.files import joint_centres_text
from posefuse_sim.fitting import ARM, FLOORS, MOST_M, MOVES, RATE_HZ, SCENES_EACH, fit_joint_centres, is_rendered, render_moving
from posefuse_sim.scene import read_scene
from posefuse_sim.session import SessionPaths

Run = tuple[PoseSequence, Truth]
PARTS = 4
VARIED = 30


def varied_scene(i: int) -> dict[str, Any]:
    """A walk (two of three scenes) or another motion, before cameras, in light and in images of its own."""
    rng = np.random.default_rng(94_000 + i)
    turn = rng.uniform(0, 360)
    cameras = []
    for c in range(4):
        angle, radius_m = np.radians(turn + 90 * c + rng.uniform(-25, 25)), rng.uniform(3.2, 5.8)
        cameras.append({
            "name": f"cam{c:02d}",
            "position_m": [radius_m * np.cos(angle), radius_m * np.sin(angle), rng.uniform(0.9, 2.9)],
            "look_at_m": [*rng.uniform(-0.2, 0.2, 2), rng.uniform(0.8, 1.1)], "roll_deg": rng.uniform(-7, 7),
            "image": {"size_px": [640, 480], "horizontal_fov_deg": rng.uniform(58, 85),
                      "distortion": [rng.uniform(-0.2, 0.05), 0, 0, 0]},
            "sensor": {"noise_dn": rng.uniform(0, 5)},
        })  # fmt: skip
    paths = (
        {"shape": "random", "low_m": [-1.6, -1.6], "high_m": [1.6, 1.6]},
        {"shape": "circle", "radius_m": rng.uniform(1.15, 1.5), "clockwise": bool(i % 2)},
        {"shape": "back_forth", "start_m": [-1.4, -0.8], "end_m": [1.3, 0.9]},
    )
    walking = walk(paths[i % 3], rng.uniform(0.7, 1.6))
    others = (
        {"kind": "turn", "period_s": 4.6},
        {"kind": "sit", "period_s": 3.6},
        {"kind": "overhead", "period_s": 2.2},
        {"kind": "reach", "side": SIDES[i % 2], "period_s": 1.7},
    )
    return {
        "duration_s": 8.0,
        "rate_hz": RATE_HZ,
        "seed": 800 + i,
        "cameras": {"kind": "list", "cameras": cameras},
        "people": [{"body": {"random_seed": 7400 + i}, "motion": others[i // 3 % 4] if i % 3 == 2 else walking}],
        "room": {
            "floor": FLOORS[int(rng.integers(4))],
            "walls": ("office", "plain", "none")[int(rng.integers(3))],
            "brightness": rng.uniform(0.45, 1.5),
            "shadows": bool(rng.integers(2)),
        },
        "record": {"kind": "jpeg", "quality": int(rng.integers(55, 96))},
    }


def render_varied(out: Path) -> None:
    """Minutes; resumes."""
    for i in range(VARIED):
        note(rendered(scene_from(varied_scene(i), Use.FIT), out / f"scene{i:02d}", Use.FIT).name)


def run_of(folder: Path, card_name: str) -> Run:
    """What the pipeline makes of a scene, time step by time step and uncorrected, and the truth."""
    truth = truth_of(folder)
    inputs = {name: {"images": f"videos/{name}"} for name in truth.rig.names}
    detector = {"options": {"landmarks": card_name}}
    recording = tracked(folder, detector=detector, raw=True, joint_centres=False, rate_hz=RATE_HZ, cameras=inputs)
    return recording.poses, truth


def errors_mm(poses: PoseSequence, truth: Truth, table: JointCentres) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Per joint, what is missing to the truth from both sides' landmarks and from the joints moved by the table, (M, 3) along
    forward, up and outward of the chest (arms), the pelvis (legs) or the head; confusions left out."""
    inside = (poses.t_ns >= truth.t_ns[0]) & (poses.t_ns <= truth.t_ns[-1])
    true_xyz = true_xyz_at(truth, poses.t_ns[inside])[:, 0]
    moved = to_joint_centres(poses, table)
    found: dict[str, list[list[np.ndarray]]] = {joint: [[], []] for joint in JOINTS}
    for side in SIDES:
        known = joint_directions(poses.xyz_world[inside, 0], poses.skeleton, side)
        for joint in JOINTS:
            about = known["ear" if joint in HEAD else "shoulder" if joint in ARM else "hip"]
            names = ("face", "crown", "outward") if joint in HEAD else ("forward", "up", "outward")
            axes = np.stack([about[name] for name in names], axis=-2)
            name = [keypoint_of(side, joint)]
            wanted = pick_keypoints(true_xyz, truth.skeleton, name)[:, 0]
            away = [1000 * (wanted - pick_keypoints(p.xyz_world[inside, 0], p.skeleton, name)[:, 0]) for p in (poses, moved)]
            good = np.isfinite(axes).all(axis=(-1, -2)) & (np.linalg.norm(away[0], axis=-1) < 1000 * MOST_M)
            for kept, one in zip(found[joint], away, strict=True):
                kept.append(np.einsum("tij,tj->ti", axes, one)[good])
    return {joint: (np.concatenate(before), np.concatenate(after)) for joint, (before, after) in found.items()}


def fit(folders: list[Path], card_name: str, only: tuple[str, ...]) -> dict[str, list[Row]]:
    scenes = [path for folder in folders for path in sorted(folder.glob("scene*")) if is_rendered(path)]
    for path in scenes:
        checked(read_scene(SessionPaths(path).scene), Use.FIT)
    runs = [run_of(path, card_name) for path in scenes]
    found: dict[Path, dict[str, tuple[np.ndarray, np.ndarray]]] = {}
    for part in range(PARTS):
        table = fit_joint_centres([run for i, run in enumerate(runs) if i % PARTS != part])
        found |= {scenes[i]: errors_mm(*run, table) for i, run in enumerate(runs) if i % PARTS == part}
    table = fit_joint_centres(runs, f"{card_name}, fitted to {len(runs)} simulated bodies")
    rows = []
    for joint in JOINTS:
        before, after = (np.linalg.norm(np.concatenate([one[joint][k] for one in found.values()]), axis=1) for k in (0, 1))
        offsets = {name: 1000 * metres for name, metres in table.offsets[joint].items()}
        rows.append({"joint": joint, "before": float(before.mean()), "after": float(after.mean()), "offsets": offsets})
    write_card(card_name, table, only, len(runs))
    return {f"mm, {len(runs)} scenes, each judged by a fit to the bodies of the other three quarters": rows}


def write_card(card_name: str, table: JointCentres, only: tuple[str, ...], bodies: int) -> None:
    """Write the table of a card; with `only`, the other joints stay as the card has them."""
    card: NetworkCard = read_card(card_name)
    path = card.folder / f"{card.name}.joint_centres.toml"
    if only:
        before = read_joint_centres(path)
        offsets = {**before.offsets, **{joint: table.offsets[joint] for joint in only}}
        table = replace(before, made_by=f"{before.made_by} ({', '.join(only)}: {bodies})", offsets=offsets)
    path.write_text(joint_centres_text(table), encoding="utf-8")
    note(f"written: {path.name}")


def main() -> None:
    args = arguments(
        __doc__, positional=("step", "out", "more"), step=str, out=Path, more=(Path,), card="blazepose_full", only=""
    )
    if args.step == "render":
        render_moving(args.out, SCENES_EACH * len(MOVES), print)
    elif args.step == "render-varied":
        render_varied(args.out)
    elif args.step == "fit":
        answer(args, fit([args.out, *args.more], args.card, tuple(filter(None, args.only.split(",")))))
    else:
        raise SystemExit(f"{args.step}: expected render, render-varied or fit")


if __name__ == "__main__":
    main()
