"""People in front of cameras, with exact truth."""

import numpy as np
import pytest

from posefuse.core import SKELETONS

# a standing person, metres: right arm forward, left arm out, so that no two keypoints mirror each other exactly
_STANDING = {
    "nose": (0.12, 0.0, 1.6), "eye": (0.1, 0.03, 1.64), "ear": (0.0, 0.08, 1.62), "shoulder": (0.0, 0.2, 1.42),
    "elbow": (0.1, 0.35, 1.2), "wrist": (0.3, 0.4, 1.05), "hip": (0.0, 0.13, 0.95), "knee": (0.06, 0.15, 0.5),
    "ankle": (-0.02, 0.16, 0.1),
}  # fmt: skip


@pytest.fixture(scope="session")
def standing() -> np.ndarray:
    """(17, 3) a coco17 person near the origin, facing +x."""
    rows = []
    for name in SKELETONS["coco17"].keypoints:
        side, _, part = name.rpartition("_")
        x, y, z = _STANDING[part]
        if side == "right":
            x, y, z = x + (0.15 if part in ("elbow", "wrist", "knee") else 0.0), -y, z
        rows.append((x, y, z))
    return np.array(rows)
