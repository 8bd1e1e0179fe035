"""Views that confuse the legs while they pass each other: what one round of naming leaves wrong, the next ones put right."""

import numpy as np
import pytest

import posefuse.pipeline.second_pass as second_pass
from posefuse.core import Rig, ViewSequence
from posefuse.core.skeleton import COCO17
from posefuse.fusion import FuseSettings
from posefuse.pipeline.second_pass import poses_over_time

T, K = 90, len(COCO17)
LEFT = COCO17.indices(["left_hip", "left_knee", "left_ankle"])
LEGS, MIRRORED = [*LEFT, *COCO17.mirror[LEFT]], [*COCO17.mirror[LEFT], *LEFT]
T_S = np.arange(T) / 30
CROSSINGS = (17, 33, 50, 67)


def walker() -> np.ndarray:
    """(T, K, 3) m: legs that swing past each other at 0.9 Hz, walking 1 m/s."""
    xyz = np.tile(np.random.default_rng(5).normal(size=(1, K, 3)) * 0.05 + [-1.5, 0, 1], (T, 1, 1))
    xyz[..., 0] += T_S[:, None]
    swing = 0.3 * np.sin(2 * np.pi * 0.9 * T_S)[:, None] * [0.1, 0.6, 1.0]
    for limb, sign in ((LEFT, 1), (COCO17.mirror[LEFT], -1)):
        xyz[:, limb, 0] += sign * swing
        xyz[:, limb, 1] += sign * 0.1
    return xyz


def confused_views(rig: Rig, xyz: np.ndarray, seed: int) -> ViewSequence:
    """Four in ten views have the legs exchanged, each for its own time, whenever they cross; noise of 2 px."""
    rng = np.random.default_rng(seed)
    xy = np.stack([camera.project(xyz) for camera in rig], axis=1) + rng.normal(size=(T, len(rig), K, 2)) * 2
    for crossing in CROSSINGS:
        for c in np.flatnonzero(rng.uniform(size=len(rig)) < 0.4):
            length = rng.integers(4, 16)
            first = crossing - rng.integers(0, length + 1)
            seen = xy[max(first, 0) : first + length, c]
            seen[:, LEGS] = seen[:, MIRRORED]
    return ViewSequence(
        t_ns=(T_S * 1e9).astype(np.int64), skeleton=COCO17, camera_names=rig.names, person_id=np.array([0]), xy_img=xy[:, None],
        score=np.ones((T, 1, len(rig), K)), sigma_px=np.full((T, 1, len(rig), K), 2.0),
    )  # fmt: skip


def worst_mm(rig: Rig, seed: int) -> float:
    xyz = walker()
    found = poses_over_time(confused_views(rig, xyz, seed), rig, FuseSettings(), None).xyz_world[:, 0]
    return float(1000 * np.nanmax(np.linalg.norm(found - xyz, axis=-1)[:, LEGS]))


# drawn first to last, none left out; in 16 of them one was not mended, where nearly all views were confused at once
SEEDS = range(10)


def test_legs_that_several_views_confuse_at_once_are_named_right(ring_rig) -> None:
    rig = ring_rig(4)
    assert max(worst_mm(rig, seed) for seed in SEEDS) < 100


def test_one_or_two_rounds_would_not_do(ring_rig, monkeypatch: pytest.MonkeyPatch) -> None:
    rig = ring_rig(4)
    wrong = []
    for rounds in (1, 2):
        monkeypatch.setattr(second_pass, "_NAMING_ROUNDS", rounds)
        wrong.append(sum(worst_mm(rig, seed) > 100 for seed in SEEDS))
    assert wrong[0] > wrong[1] > 0
