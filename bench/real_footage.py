"""Real footage against another pipeline's result: four cameras, a man on a beam, a bystander in view.

    python bench/real_footage.py [--data ../shared/data/pose2sim_single]

The reference (Pose2Sim's triangulation of OpenPose) is another markerless estimate, not the truth: distances show what
changes for better or worse, not how accurate either is. A table on stderr, one JSON object on stdout.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from posefuse.core import PoseSequence, Recording
from posefuse.core.skeleton import pick_keypoints
from posefuse.evaluation.biomechanics import BiomechanicsSettings, joints_of
from posefuse.formats.recording import read_recording
from posefuse.formats.trc import read_trc

LIMBS = tuple(f"{s}_{j}" for j in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle") for s in ("left", "right"))
SIDES = {"R": "right_", "L": "left_"}
REFERENCE = Path("reference") / "S00_P00_T01_BalancingTrial_0-100.trc"
JUMP_M = 0.15
# he is 600 px tall, and the bystander is further away than this
HIM_PX = 60.0
RATE_HZ = 60


def keypoint(marker: str) -> str:
    """``RBigToe`` is right_big_toe."""
    if marker in ("Neck", "Head", "Nose"):
        return marker.lower()
    words = "".join(f"_{letter.lower()}" if letter.isupper() else letter for letter in marker[1:])
    return SIDES[marker[0]] + words.removeprefix("_")


def tracked(session: Path, out: Path, *options: str) -> Recording:
    """The result of one `posefuse track`."""
    command = [sys.executable, "-m", "posefuse.cli.main", "track", str(session), "--out", str(out), "--force", "--json"]
    subprocess.run([*command, "--outputs", "", *options], check=True, capture_output=True, text=True)
    return read_recording(out)


def man_found(recording: Recording, xyz: np.ndarray) -> dict[str, int]:
    """Per camera, frames in which the keypoints seen are those of the man of the reference, whichever side is called left."""
    found = {}
    for c, camera in enumerate(recording.rig):
        seen = pick_keypoints(recording.views.xy_img[: len(xyz), 0, c], recording.poses.skeleton, LIMBS)
        expected = camera.project(xyz[: len(seen)]).reshape(len(seen), -1, 2, 2)
        pairs = seen.reshape(expected.shape)
        away = np.minimum(*(np.linalg.norm(pairs[:, :, ::step] - expected, axis=-1) for step in (1, -1))).reshape(len(seen), -1)
        found[camera.name] = int((np.nanmedian(np.where(np.isfinite(away), away, np.inf), axis=1) < HIM_PX).sum())
    return found


def distances_mm(poses: PoseSequence, names: tuple[str, ...], xyz: np.ndarray) -> np.ndarray:
    """(T, K) of the one person."""
    got = pick_keypoints(poses.xyz_world[: len(xyz), 0], poses.skeleton, names)
    return 1000 * np.linalg.norm(got - xyz[: len(got)], axis=-1)


def row(poses: PoseSequence, recording: Recording, limbs: np.ndarray) -> dict:
    """Figures of poses that were made of a recording's views."""
    medians = np.nanmedian(distances_mm(poses, LIMBS, limbs), axis=0)
    return {
        "mean_of_medians_mm": float(medians.mean()),
        "joints_mm": dict(zip(LIMBS, medians.tolist(), strict=True)),
        "found_of_100": man_found(recording, limbs),
    }


def jumps(poses: PoseSequence, names: tuple[str, ...], xyz: np.ndarray) -> int:
    """Steps over 150 mm between frames where the reference makes none."""
    got = pick_keypoints(poses.xyz_world[: len(xyz), 0], poses.skeleton, names)
    steps, expected = (np.linalg.norm(np.diff(one, axis=0), axis=-1) for one in (got, xyz[: len(got)]))
    return int(((steps > JUMP_M) & (expected < JUMP_M)).sum())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=Path("../shared/data/pose2sim_single"))
    args = parser.parse_args()
    console = Console(stderr=True, highlight=False, width=170)
    if not (args.data / REFERENCE).is_file():
        console.print(f"real footage: skipped, there is no {args.data / REFERENCE}", markup=False)
        print(json.dumps({"skipped": f"no {REFERENCE}"}))
        return
    reference = read_trc(args.data / REFERENCE)
    every = tuple(keypoint(name) for name in reference.names)
    limbs = reference.xyz_world[:, [every.index(name) for name in LIMBS]]
    figures: dict = {}
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "result"
        for name, options in {
            "default": (),
            "without joint centres": ("--set", "joint_centres=false"),
            "small network": ("--set", "detector.options.landmarks=blazepose_lite"),
            "larger network": ("--set", "detector.options.landmarks=blazepose_heavy"),
            "best networks": ("--set", "detector.options.landmarks=blazepose_best"),
            "not smoothed": ("--raw",),
            "not smoothed, without joint centres": ("--raw", "--set", "joint_centres=false"),
        }.items():
            recording = tracked(args.data, out, *options)
            figures[name] = row(recording.poses, recording, limbs)
            if name == "default":
                for fit in ("points", "rays"):
                    poses, _ = joints_of(recording, BiomechanicsSettings(fit=fit))
                    figures[f"default, whole-body fit to {fit}"] = row(poses, recording, limbs)
        for weights in ("score", "robust"):
            options = ("--input", "pose2d", "--set", f"rate_hz={RATE_HZ}", "--raw", "--weights", weights)
            poses = tracked(args.data, out, *options).poses
            figures[f"OpenPose's keypoints, {weights}"] = {
                "median_mm": float(np.nanmedian(distances_mm(poses, every, reference.xyz_world))),
                "jumps": jumps(poses, every, reference.xyz_world),
            }
    show(console, figures)
    print(json.dumps(figures))


def show(console: Console, figures: dict) -> None:
    table = Table(title="100 frames, 4 cameras, next to Pose2Sim on OpenPose", title_justify="left")
    for column in ("from", "mm", "what", "found in each view, %", "jumps"):
        table.add_column(column)
    for name, row in figures.items():
        if "joints_mm" in row:
            seen = " ".join(str(count) for count in row["found_of_100"].values())
            table.add_row(name, f"{row['mean_of_medians_mm']:.1f}", "mean of 12 limb joints' medians", seen, "")
        else:
            table.add_row(name, f"{row['median_mm']:.2f}", "median of all joints", "", str(row["jumps"]))
    console.print(table)
    joints = Table(title="medians per joint, mm", title_justify="left")
    names = [name for name, row in figures.items() if "joints_mm" in row]
    for column in ("joint", *names):
        joints.add_column(column)
    for joint in LIMBS:
        joints.add_row(joint.replace("_", " "), *(f"{figures[name]['joints_mm'][joint]:.0f}" for name in names))
    console.print(joints)


if __name__ == "__main__":
    main()
