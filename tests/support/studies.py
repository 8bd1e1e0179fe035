"""Sessions for studies: 2D poses of another tool, so that no network runs."""

import json
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
        place = folder / "pose2d" / camera.name
        place.mkdir(parents=True)
        for t in range(FRAMES):
            xy = camera.project(body + [0.02 * t, 0, 0])
            points = np.column_stack([xy, np.full(len(xy), 0.9)]).ravel().tolist()
            text = json.dumps({"people": [{"pose_keypoints_2d": points}]})
            (place / f"{camera.name}_{t:06d}_keypoints.json").write_text(text)
