"""Real footage against another pipeline's result: four cameras, a man on a beam, a bystander in view.

    python bench/real_footage.py [--data ../shared/data/pose2sim_single] [--networks rtmpose_m ...]

The reference (Pose2Sim's triangulation of OpenPose) is another markerless estimate, not the truth: distances show what
changes for better or worse, not how accurate either is. A table on stderr, one JSON object on stdout.
"""

import json
from pathlib import Path

import numpy as np
from harness import DATA, answer, arguments, note, tracked

from posefuse.core import PoseSequence, Recording
from posefuse.core.skeleton import pick_keypoints
from posefuse.detection.build import network_settings
from posefuse.evaluation.biomechanics import BiomechanicsSettings, joints_of
from posefuse.evaluation.tracks import plain_name
from posefuse.formats.trc import read_trc

LIMBS = tuple(f"{s}_{j}" for j in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle") for s in ("left", "right"))
REFERENCE = Path("reference") / "S00_P00_T01_BalancingTrial_0-100.trc"
JUMP_M = 0.15
# he is 600 px tall, and the bystander is further away than this
HIM_PX = 60.0
RATE_HZ = 60.0
_NETWORK = "detector__options__landmarks"
SETTINGS: dict[str, dict] = {
    "default": {},
    "without joint centres": {"joint_centres": False},
    "small network": {_NETWORK: "blazepose_lite"},
    "larger network": {_NETWORK: "blazepose_heavy"},
    "best networks": {_NETWORK: "blazepose_best"},
    "not smoothed": {"raw": True},
    "not smoothed, without joint centres": {"raw": True, "joint_centres": False},
}


def limbs_of(data: Path) -> np.ndarray:
    """(T, 12, 3) m: the limb joints of the reference."""
    reference = read_trc(data / REFERENCE)
    return reference.xyz_world[:, [tuple(map(plain_name, reference.names)).index(name) for name in LIMBS]]


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
    found = man_found(recording, limbs)
    return {"mean_mm": float(medians.mean()), "found_of_100": found, **dict(zip(LIMBS, medians.tolist(), strict=True))}


def jumps(poses: PoseSequence, names: tuple[str, ...], xyz: np.ndarray) -> int:
    """Steps over 150 mm between frames where the reference makes none."""
    got = pick_keypoints(poses.xyz_world[: len(xyz), 0], poses.skeleton, names)
    steps, expected = (np.linalg.norm(np.diff(one, axis=0), axis=-1) for one in (got, xyz[: len(got)]))
    return int(((steps > JUMP_M) & (expected < JUMP_M)).sum())


def main() -> None:
    args = arguments(__doc__, data=DATA / "pose2sim_single", networks=(str,))
    if not (args.data / REFERENCE).is_file():
        note(f"real footage: skipped, there is no {args.data / REFERENCE}")
        print(json.dumps({"skipped": f"no {REFERENCE}"}))
        return
    reference = read_trc(args.data / REFERENCE)
    every = tuple(map(plain_name, reference.names))
    limbs = limbs_of(args.data)
    rows, others = [], []
    for name, changes in (SETTINGS | {name: network_settings(name) for name in args.networks}).items():
        recording = tracked(args.data, **changes)
        rows.append({"from": name, **row(recording.poses, recording, limbs)})
        if name == "default":
            poses, _ = joints_of(recording, BiomechanicsSettings(fit="points"))
            rows.append({"from": "default, whole-body fit to points", **row(poses, recording, limbs)})
    for weights in ("score", "robust"):
        poses = tracked(args.data, input="pose2d", rate_hz=RATE_HZ, raw=True, fuse__weights=weights).poses
        median_mm = float(np.nanmedian(distances_mm(poses, every, reference.xyz_world)))
        others.append({"weights": weights, "median_mm": median_mm, "jumps": jumps(poses, every, reference.xyz_world)})
    about = "100 frames, 4 cameras, next to Pose2Sim on OpenPose: medians of 12 limb joints"
    answer(args, {about: rows, "OpenPose's keypoints, all joints": others})


if __name__ == "__main__":
    main()
