"""People in front of cameras, with exact truth."""

from collections.abc import Callable

import numpy as np
import pytest

from posefuse.core import SKELETONS, Rig, Skeleton, Views

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


@pytest.fixture(scope="session")
def views_of() -> Callable[..., Views]:
    """Builder of what a rig sees of (N, K, 3) people."""
    return _views_of


def _views_of(rig: Rig, skeleton: Skeleton, xyz: np.ndarray, sigma_px: float = 1.0, seed: int | None = None) -> Views:
    xy = np.moveaxis(rig.project(xyz), 0, 1)
    if seed is not None:
        xy = xy + np.random.default_rng(seed).normal(size=xy.shape) * sigma_px
    seen = np.isfinite(xy[..., 0])
    return Views(
        t_ns=0,
        skeleton=skeleton,
        camera_names=rig.names,
        person_id=np.arange(len(xyz)),
        xy_img=xy,
        score=np.where(seen, 0.9, 0.0),
        sigma_px=np.where(seen, sigma_px, np.nan),
    )
