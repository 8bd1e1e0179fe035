"""Fit where joint centres lie beside what the BlazePose network marks, on rendered people whose joint centres are known exactly.

    python bench/fit_joint_centres.py render OUT            draw people moving all their joints about (minutes; resumes)
    python bench/fit_joint_centres.py fit OUT [MORE ...] [--card NAME]
                                                            run the pipeline, fit, judge by bodies left out, write the card

MORE are folders of other rendered scenes, e.g. those of `fit_blazepose_noise.py render`. Bodies and motions are drawn for these
two fits alone (bodies of random seeds 7000 to 7207); none of them appears in a reported measurement.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.spatial.transform import Rotation

from posefuse.core import PoseSequence, Truth
from posefuse.core.skeleton import pick_keypoints
from posefuse.detection.models import read_any_card
from posefuse.evaluation.metrics import true_xyz_at
from posefuse.formats.trc import TrcData, write_trc
from posefuse.formats.truth import read_truth
from posefuse.tracking import to_joint_centres
from posefuse.tracking.joint_centres import JOINTS, MOST_LONGER_M, SIDES, JointCentres, directions
from posefuse.tracking.segments import SEGMENTS, segment_lengths

# Directions each joint may be moved along, as found to pay by bodies left out. The hip is not moved along the spine as a whole:
# the mesh says 12 mm down, real footage (bench/real_footage.py) says up; "sinking" is nothing when standing, and grows as the
# thigh is lifted.
WANTED = {
    "shoulder": ("forward", "up", "outward", "arm", "raising"),
    "elbow": ("upper_arm", "bend", "lowering"),
    "wrist": ("forearm", "hand", "palm"),
    "hip": ("forward", "outward", "sinking"),
    "knee": ("thigh", "bend", "outward", "forward"),
    "ankle": ("shank", "foot", "outward"),
}
ARM = ("shoulder", "elbow", "wrist")
# Joints whose offsets also depend on how long somebody's segments are, as found to pay by bodies left out.
BY_LENGTH = ("shoulder", "hip", "knee", "ankle")
# what a slope of 1 costs, in instants whose lengths are a metre off: keeps slopes small that bodies do not tell
RIDGE = 0.3
Range = tuple[Sequence[float], Sequence[float]]
# least and most degrees of legs (abduction, flexion, knee) and arms (abduction, flexion, turn about the vertical, elbow): all
# joints through most of their ranges; and standing with arms raised. Eight scenes of either, of bodies of their own
MOVES: tuple[tuple[Range, Range], ...] = (
    (((0, -20, 2), (25, 60, 80)), ((5, -40, -60, 2), (140, 120, 60, 120))),
    (((0, -8, 1), (14, 8, 12)), ((45, -20, -30, 1), (130, 35, 30, 60))),
)
SCENES_EACH = 8
Run = tuple[PoseSequence, Truth]
DURATION_S, RATE_HZ = 8.0, 2.5
FLOORS = ("wood", "concrete", "tiles", "plain")
# an error larger than this is a confusion, not an offset
MOST_M = 0.15
# errors beyond this pull with constant force
HUBER_M = 0.015
PARTS = 4


def smooth_path(rng: np.random.Generator, low: Sequence[float], high: Sequence[float], t_s: np.ndarray) -> np.ndarray:
    """(T, n) angles in radians through a random pose every 0.8 s, from limits (n,) in degrees."""
    knots = np.arange(0.0, DURATION_S + 1.6, 0.8)
    return np.asarray(np.deg2rad(PchipInterpolator(knots, rng.uniform(low, high, (len(knots), len(low))))(t_s)))


def moving(seed: int, legs: Range, arms: Range) -> TrcData:
    """Keypoints of somebody standing in place who moves trunk, legs and arms between limits.

    Rest: +X ahead, +Y left, +Z up, arms down.
    """
    rng = np.random.default_rng(seed)
    t_s = np.arange(0.0, DURATION_S + 0.4, 1 / 30)
    points: dict[str, np.ndarray] = {}
    turn = Rotation.from_euler("z", np.linspace(*rng.uniform(0, 2 * np.pi, 2), len(t_s))[:, None])
    trunk = turn * Rotation.from_euler("zyx", smooth_path(rng, np.array([-25, -10, -12]), np.array([25, 25, 12]), t_s))
    for side, sign in (("left", 1.0), ("right", -1.0)):
        hip = turn.apply([0.0, sign * 0.09, 0.0])
        # abduction, flexion; then the bend of the knee
        leg = smooth_path(rng, *legs, t_s)
        thigh = turn * Rotation.from_euler("xy", np.stack([sign * leg[:, 0], -leg[:, 1]], axis=-1))
        shank = thigh * Rotation.from_euler("y", leg[:, 2:])
        knee = hip + thigh.apply([0, 0, -0.42])
        ankle = knee + shank.apply([0, 0, -0.4])
        shoulder = trunk.apply([0, sign * 0.18, 0.5])
        arm = smooth_path(rng, *arms, t_s)
        upper = trunk * Rotation.from_euler("yxz", np.stack([-arm[:, 1], sign * arm[:, 0], arm[:, 2]], axis=-1))
        lower = upper * Rotation.from_euler("y", -arm[:, 3:])
        elbow = shoulder + upper.apply([0, 0, -0.29])
        wrist = elbow + lower.apply([0, 0, -0.26])
        points |= {f"{side}_{name}": xyz for name, xyz in zip(JOINTS, (shoulder, elbow, wrist, hip, knee, ankle), strict=True)}
    xyz = np.stack(list(points.values()), axis=1) + [0, 0, 0.9]
    return TrcData(names=tuple(points), t_s=t_s, xyz_world=xyz, rate_hz=30.0)


def scene_settings(i: int, motion_file: Path) -> dict:
    rng = np.random.default_rng(91_000 + i)
    body = 7100 + 100 * (i // SCENES_EACH) + i % SCENES_EACH
    return {
        "duration_s": DURATION_S,
        "rate_hz": RATE_HZ,
        "seed": 600 + i,
        "cameras": {
            "kind": "ring",
            "count": 4,
            "radius_m": round(rng.uniform(3.2, 5.2), 2),
            "height_m": round(rng.uniform(1.0, 2.7), 2),
            "first_angle_deg": float(rng.integers(0, 90)),
            "image": {"size_px": [640, 480], "horizontal_fov_deg": float(rng.integers(58, 72))},
            "sensor": {"noise_dn": 1.5},
        },
        "people": [{"body": {"random_seed": body}, "motion": {"kind": "trc", "file": str(motion_file)}}],
        "room": {"floor": FLOORS[i % 4], "walls": ("office", "plain")[i // 2 % 2], "brightness": round(rng.uniform(0.7, 1.2), 2)},
        "record": {"kind": "jpeg", "quality": 90},
    }


def render(out: Path) -> None:
    from posefuse.foundation.settings import settings_from_mapping
    from posefuse.simulation.scene import Scene
    from posefuse.simulation.session import simulate

    out.mkdir(parents=True, exist_ok=True)
    for i in range(SCENES_EACH * len(MOVES)):
        folder = out / f"scene{i:02d}"
        if (folder / "truth" / "truth.npz").exists() and not (folder / "INCOMPLETE").exists():
            continue
        motion_file = out.absolute() / f"motion{i:02d}.trc"
        write_trc(motion_file, moving(i, *MOVES[i // SCENES_EACH]))
        simulate(settings_from_mapping(scene_settings(i, motion_file), Scene, where=f"scene {i}"), folder, processes=1)
        print(f"{folder.name}: done", flush=True)


def tracked(folder: Path, card_name: str) -> tuple[PoseSequence, Truth]:
    """What the pipeline makes of a scene, instant by instant and uncorrected, and the truth."""
    from posefuse.detection.build import DetectorChoice
    from posefuse.pipeline.clock import StageClock
    from posefuse.pipeline.config import CameraInput, TrackConfig
    from posefuse.pipeline.run import track_session
    from posefuse.pipeline.session import find_session

    truth = read_truth(folder / "truth" / "truth.npz")
    inputs = {name: CameraInput(images=f"videos/{name}") for name in truth.rig.names}
    detector = DetectorChoice(options={"landmarks": card_name})
    config = TrackConfig(detector=detector, raw=True, joint_centres=False, rate_hz=RATE_HZ, cameras=inputs)

    def silent(*_: object) -> None: ...

    done = track_session(find_session(folder, config), config, StageClock(), silent, silent, silent)
    return done.recording.poses, truth


def samples(poses: PoseSequence, truth: Truth, joint: str) -> tuple[np.ndarray, np.ndarray]:
    """Directions (M, D, 3) and what is missing to the joint centre (M, 3) of both sides over time, confusions left out."""
    inside = (poses.t_ns >= truth.t_ns[0]) & (poses.t_ns <= truth.t_ns[-1])
    xyz, true_xyz = poses.xyz_world[inside, 0], true_xyz_at(truth, poses.t_ns[inside])[:, 0]
    along, missing = [], []
    for side in SIDES:
        known = directions(xyz, poses.skeleton, side)[joint]
        rows = np.stack([known[name] for name in WANTED[joint]], axis=-2)
        name = [f"{side}_{joint}"]
        away = (pick_keypoints(true_xyz, truth.skeleton, name) - pick_keypoints(xyz, poses.skeleton, name))[:, 0]
        good = np.isfinite(rows).all(axis=(-1, -2)) & (np.linalg.norm(away, axis=-1) < MOST_M)
        along.append(rows[good])
        missing.append(away[good])
    return np.concatenate(along), np.concatenate(missing)


def solve(along: np.ndarray, missing: np.ndarray, ridge: float = 0.0) -> np.ndarray:
    """(D,) metres along each direction (M, D, 3) of least Huber-like loss; `ridge` pulls them to zero."""
    design = along.swapaxes(-1, -2).reshape(-1, along.shape[1])
    weight = np.ones(len(missing))
    metres = np.zeros(along.shape[1])
    for _ in range(20):
        w = np.repeat(weight, 3)[:, None]
        normal = (design * w).T @ design + ridge * np.eye(along.shape[1])
        metres = np.linalg.solve(normal, (design * w).T @ missing.reshape(-1))
        weight = HUBER_M / np.maximum(np.linalg.norm(missing - left(along, metres), axis=-1), HUBER_M)
    return np.asarray(metres)


def left(along: np.ndarray, metres: np.ndarray) -> np.ndarray:
    return np.asarray(np.einsum("mdx,d->mx", along, metres))


def fitted(runs: list[Run]) -> JointCentres:
    """Constants first; then, of what they leave, slopes on how much longer than usual each body is by those constants."""
    each = {joint: [samples(poses, truth, joint) for poses, truth in runs] for joint in JOINTS}
    offsets, by_length = {}, {}
    for joint, parts in each.items():
        along, missing = (np.concatenate(rows) for rows in zip(*parts, strict=True))
        offsets[joint] = dict(zip(WANTED[joint], solve(along, missing).tolist(), strict=True))
    plain = JointCentres(made_by="", offsets=offsets)
    lengths = np.concatenate([segment_lengths(to_joint_centres(p, plain).xyz_world, p.skeleton) for p, _ in runs])
    usual = np.nanmean(lengths, axis=0)
    longer = np.clip(np.nan_to_num(lengths - usual), -MOST_LONGER_M, MOST_LONGER_M)
    for joint in BY_LENGTH:
        metres = np.array([offsets[joint][name] for name in WANTED[joint]])
        along = [(a[:, :, None] * own[:, None]).reshape(len(a), -1, 3) for (a, _), own in zip(each[joint], longer, strict=True)]
        slopes = solve(np.concatenate(along), np.concatenate([m - left(a, metres) for a, m in each[joint]]), RIDGE)
        rows = zip(WANTED[joint], slopes.reshape(-1, len(SEGMENTS)).tolist(), strict=True)
        by_length[joint] = {name: dict(zip(SEGMENTS, row, strict=True)) for name, row in rows}
    return JointCentres(
        made_by="", offsets=offsets, lengths=dict(zip(SEGMENTS, usual.tolist(), strict=True)), by_length=by_length
    )


def errors_mm(poses: PoseSequence, truth: Truth, table: JointCentres) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Per joint, what is missing to the truth from both sides' landmarks and from the joints moved by the table, (M, 3) along
    forward, up and outward of the chest (arms) or the pelvis (legs); confusions left out."""
    inside = (poses.t_ns >= truth.t_ns[0]) & (poses.t_ns <= truth.t_ns[-1])
    true_xyz = true_xyz_at(truth, poses.t_ns[inside])[:, 0]
    moved = to_joint_centres(poses, table)
    found: dict[str, list[list[np.ndarray]]] = {joint: [[], []] for joint in JOINTS}
    for side in SIDES:
        known = directions(poses.xyz_world[inside, 0], poses.skeleton, side)
        for joint in JOINTS:
            trunk = known["shoulder" if joint in ARM else "hip"]
            axes = np.stack([trunk[name] for name in ("forward", "up", "outward")], axis=-2)
            name = [f"{side}_{joint}"]
            wanted = pick_keypoints(true_xyz, truth.skeleton, name)[:, 0]
            away = [1000 * (wanted - pick_keypoints(p.xyz_world[inside, 0], p.skeleton, name)[:, 0]) for p in (poses, moved)]
            good = np.isfinite(axes).all(axis=(-1, -2)) & (np.linalg.norm(away[0], axis=-1) < 1000 * MOST_M)
            for kept, one in zip(found[joint], away, strict=True):
                kept.append(np.einsum("tij,tj->ti", axes, one)[good])
    return {joint: (np.concatenate(before), np.concatenate(after)) for joint, (before, after) in found.items()}


def parts(errors: list[np.ndarray]) -> str:
    """What (M, 3) errors of each body are made of: a mean that all bodies share, each body's own, and what changes."""
    means = np.array([one.mean(axis=0) for one in errors])
    common = means.mean(axis=0)
    changing = np.concatenate([one - one.mean(axis=0) for one in errors])
    own = np.linalg.norm(means - common, axis=1)
    return f"common {np.linalg.norm(common):4.1f}  own {own.mean():4.1f}  changing {np.linalg.norm(changing, axis=1).mean():4.1f}"


def fit(folders: list[Path], card_name: str) -> None:
    scenes = [path for folder in folders for path in sorted(folder.glob("scene*")) if (path / "truth" / "truth.npz").exists()]
    runs = [tracked(path, card_name) for path in scenes]
    raised = {folders[0] / f"scene{i:02d}" for i in range(SCENES_EACH, 2 * SCENES_EACH)}
    found: dict[Path, dict[str, tuple[np.ndarray, np.ndarray]]] = {}
    for part in range(PARTS):
        table = fitted([run for i, run in enumerate(runs) if i % PARTS != part])
        found |= {scenes[i]: errors_mm(*run, table) for i, run in enumerate(runs) if i % PARTS == part}
    table = fitted(runs)
    print(f"{len(runs)} scenes; each judged by a fit to the bodies of the other three quarters; mean mm before -> after")
    for joint in JOINTS:
        before, after = (np.linalg.norm(np.concatenate([one[joint][k] for one in found.values()]), axis=1) for k in (0, 1))
        told = "  ".join(f"{name} {1000 * metres:+.1f}" for name, metres in table.offsets[joint].items())
        print(f"{joint:9s} {before.mean():5.1f} -> {after.mean():5.1f}   {told}")
    print(f"standing with arms raised, {len(raised & found.keys())} bodies: what errors are made of, before -> after")
    for joint in JOINTS:
        before_parts, after_parts = (parts([one[joint][k] for path, one in found.items() if path in raised]) for k in (0, 1))
        print(f"{joint:9s} {before_parts}  ->  {after_parts}")
    write_card(card_name, table, len(runs), sum(len(poses) for poses, _ in runs))


def write_card(card_name: str, table: JointCentres, scenes: int, instants: int) -> None:
    card = read_any_card(card_name)
    lines = [
        "# metres from the fused landmark to the joint centre along directions of the body itself, see tracking/joint_centres.py",
        f'made_by = "bench/fit_joint_centres.py: {scenes} rendered scenes of as many bodies, {instants} instants"',
        *section("lengths", table.lengths, 3),
    ]
    for joint, offsets in table.offsets.items():
        lines += section(f"offsets.{joint}", offsets, 4)
    for joint, directions_ in table.by_length.items():
        for name, slopes in directions_.items():
            lines += section(f"by_length.{joint}.{name}", slopes, 3)
    path = card.folder / f"{card.name}.joint_centres.toml"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    print(f"written: {path.name}")


def section(name: str, values: dict[str, float], digits: int) -> list[str]:
    return ["", f"[{name}]", *(f"{key} = {value:.{digits}f}" for key, value in values.items())]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("step", choices=("render", "fit"))
    parser.add_argument("out", type=Path)
    parser.add_argument("more", type=Path, nargs="*")
    parser.add_argument("--card", default="blazepose_full", help="landmark network or ensemble to fit")
    arguments = parser.parse_args()
    if arguments.step == "render":
        render(arguments.out)
    else:
        fit([arguments.out, *arguments.more], arguments.card)


if __name__ == "__main__":
    main()
