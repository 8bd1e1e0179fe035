"""Joint centres by people's proportions, with and without: simulated people whose marks are off, and real OpenPose files.

    python bench/proportions.py [--data ../shared/data/pose2sim_single]

Simulated: bodies and motions of `evaluation.fitting.scenes`, their joint centres known, marks moved towards the trunk.
Real: the reference is another pipeline's result from the same marks, so it shares what is wrong with them; and what networks
with a fitted table of their own give for the same man. Tables on stderr, one JSON object on stdout.
"""

import argparse
import json
import tempfile
from pathlib import Path

import numpy as np
from real_footage import LIMBS, REFERENCE, keypoint, tracked
from rich.console import Console
from rich.table import Table

from posefuse.core import SKELETONS, Kind, PoseSequence
from posefuse.core.joint_centres import SEGMENT_ENDS
from posefuse.core.skeleton import pick_keypoints
from posefuse.evaluation.fitting.scenes import everyday_scene
from posefuse.formats.trc import read_trc
from posefuse.foundation.settings import settings_from_mapping
from posefuse.simulation.exact import truth_of
from posefuse.simulation.scene import Scene
from posefuse.tracking import proportional_joint_centres, to_joint_centres
from posefuse.tracking.segments import lengths_at

COCO = SKELETONS["coco17"]
JOINTS = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
# metres that marks lie too close to the trunk: wrist along the forearm, elbow along the upper arm, knee along the thigh
MARKS = {"marks at the joints": (0.0, 0.0, 0.0), "arms short": (0.05, 0.04, 0.0), "forearms a fifth short": (0.05, 0.0, 0.0)}
MARKS |= {"arms and knees off": (0.05, 0.04, 0.02)}
SCENES = 16


def marked(xyz: np.ndarray, wrist_m: float, elbow_m: float, knee_m: float) -> np.ndarray:
    """Keypoints (T, K, 3) of a detector that errs along the limbs."""
    out = xyz.copy()
    for side in ("left", "right"):
        for start, end, metres in (("elbow", "wrist", wrist_m), ("shoulder", "elbow", elbow_m), ("hip", "knee", knee_m)):
            a, b = (COCO.index(f"{side}_{joint}") for joint in (start, end))
            along = xyz[:, b] - xyz[:, a]
            out[:, b] -= metres * along / np.linalg.norm(along, axis=-1, keepdims=True)
    return out


def moved(marks: np.ndarray) -> np.ndarray:
    """The marks moved by the table of their set."""
    shape = (len(marks), 1, len(COCO))
    cov = np.broadcast_to(np.eye(3) * 1e-4, (*shape, 3, 3))
    kind = np.full(shape, Kind.FUSED)
    poses = PoseSequence(
        t_ns=np.arange(len(marks)),
        skeleton=COCO,
        person_id=np.arange(1),
        xyz_world=marks[:, None],
        cov_world=cov,
        reproj_px=np.ones(shape),
        n_views=np.full(shape, 4),
        kind=kind,
    )
    return to_joint_centres(poses, proportional_joint_centres(COCO)).xyz_world[:, 0]


def simulated() -> dict:
    """Mean error in mm of the twelve limb joints and of wrists, before and after."""
    figures: dict = {name: [] for name in MARKS}
    limbs = COCO.indices([f"{side}_{joint}" for side in ("left", "right") for joint in JOINTS])
    wrists = COCO.indices(["left_wrist", "right_wrist"])
    for i in range(SCENES):
        scene = everyday_scene(i) | {"duration_s": 4.0, "rate_hz": 10.0, "occluders": []}
        truth = truth_of(settings_from_mapping(scene, Scene, where=f"scene {i}"))
        xyz = truth.xyz_world[:, 0, : len(COCO)]
        for name, metres in MARKS.items():
            marks = marked(xyz, *metres)
            off = [1000 * np.linalg.norm(one - xyz, axis=-1) for one in (marks, moved(marks))]
            figures[name].append([one[:, part].mean() for part in (limbs, wrists) for one in off])
    names = ("all_before_mm", "all_after_mm", "wrists_before_mm", "wrists_after_mm")
    return {name: dict(zip(names, np.mean(rows, axis=0).tolist(), strict=True)) for name, rows in figures.items()}


def real(data: Path) -> dict:
    """Limb joints to the reference and to BlazePose's joint centres in mm, and segment lengths, with and without."""
    reference = read_trc(data / REFERENCE)
    every = tuple(keypoint(name) for name in reference.names)
    limbs = reference.xyz_world[:, [every.index(name) for name in LIMBS]]
    files = ("--input", "pose2d", "--rate", "60")
    figures: dict = {}
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "result"
        network = pick_keypoints((poses := tracked(data, out).poses).xyz_world[: len(limbs), 0], poses.skeleton, LIMBS)
        for name, options in {"without": ("--set", "joint_centres=false"), "with": ()}.items():
            poses = tracked(data, out, *files, *options).poses
            got = pick_keypoints(poses.xyz_world[: len(limbs), 0], poses.skeleton, LIMBS)
            lengths = 1000 * np.nanmedian(lengths_at(poses.xyz_world[:, 0], poses.skeleton), axis=0).mean(axis=0)
            figures[name] = {
                "to_reference_mm": float(np.nanmedian(1000 * np.linalg.norm(got - limbs, axis=-1), axis=0).mean()),
                "to_blazepose_mm": float(np.nanmedian(1000 * np.linalg.norm(got - network, axis=-1), axis=0).mean()),
                "lengths_mm": dict(zip(SEGMENT_ENDS, lengths.tolist(), strict=True)),
            }
    return figures


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path("../shared/data/pose2sim_single"))
    data = parser.parse_args().data
    console, figures = Console(stderr=True), {"simulated": simulated()}
    table = Table("marks", "all mm", "moved mm", "wrists mm", "moved mm", title=f"{SCENES} simulated people")
    for name, row in figures["simulated"].items():
        table.add_row(name, *(f"{value:.1f}" for value in row.values()))
    console.print(table)
    if data.is_dir():
        figures["real"] = real(data)
        for name, row in figures["real"].items():
            lengths = ", ".join(f"{segment} {mm:.0f}" for segment, mm in row["lengths_mm"].items())
            apart = f"{row['to_reference_mm']:.1f} mm to the reference, {row['to_blazepose_mm']:.1f} to BlazePose"
            console.print(f"{name}: {apart}; {lengths}")
    print(json.dumps(figures))


if __name__ == "__main__":
    main()
