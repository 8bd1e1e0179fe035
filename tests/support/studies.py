"""Sessions for studies: 2D poses of another tool, so that no network runs."""

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from posefuse.core import SKELETONS, Rig

HALPE = SKELETONS["halpe_26"]
FRAMES = 14
SETTINGS = {"rate_hz": 50.0}


def write_session(folder: Path, rig: Rig) -> None:
    """2D poses of a body that glides along x, as each camera sees it."""
    body = np.random.default_rng(3).normal(size=(len(HALPE), 3)) * [0.1, 0.15, 0.45] + [0, 0, 1.0]
    for camera in rig:
        seen = {t: camera.project(body + [0.02 * t, 0, 0])[None] for t in range(FRAMES)}
        write_openpose(folder / "pose2d" / camera.name, seen)


def write_openpose(folder: Path, frames: Mapping[int, np.ndarray]) -> None:
    """OpenPose's file for each frame by its number: people (N, K, 2), of score 0.9, or (N, K, 3)."""
    folder.mkdir(parents=True, exist_ok=True)
    for number, seen in frames.items():
        points = seen if seen.shape[-1] == 3 else np.concatenate([seen, np.full((*seen.shape[:-1], 1), 0.9)], axis=-1)
        people = [{"person_id": [-1], "pose_keypoints_2d": one.ravel().tolist()} for one in points]
        (folder / f"cam_{number:012d}_keypoints.json").write_text(json.dumps({"version": 1.3, "people": people}))
