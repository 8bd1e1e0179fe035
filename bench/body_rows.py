"""The rows of `bench/body_held_out.py`: scenes of one body each, networks, and what is wanted of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from paper.scenes.scenes import HIDDEN_JOINTS, half_hidden_scene, ring
from posefuse.core.skeleton import PAPER14
from posefuse.foundation.settings import settings_from_mapping
from posefuse.simulation.scene import Scene

BEST = "blazepose_best"
_SIDES = ("left", "right")
_WALK = {"kind": "walk", "speed_mps": 1.35, "path": {"shape": "random", "low_m": [-1.8, -1.8], "high_m": [1.8, 1.8]}}
_OCCLUDERS = (
    {"kind": "wall", "from_m": [1.5, -0.6], "to_m": [1.4, 0.8], "height_m": 1.3},
    {"kind": "wall", "from_m": [-0.5, 1.6], "to_m": [-1.4, 1.2], "height_m": 1.5},
    {"kind": "box", "position_m": [-1.6, -0.8, 0.6], "size_m": [0.5, 0.7, 1.2], "yaw_deg": 20},
)
_HIDDEN_S, _HIDDEN_HZ = 3.0, 10.0


@dataclass(frozen=True, kw_only=True)
class Row:
    """One line of the table.

    Attributes:
        scene: name of its scene, see `scene_of`; rows of one scene share what is rendered.
        network: a model card; "" is the default.
        joints: whose mean error is the figure of the row.
        must_mm, aim_mm: what the mean over bodies is wanted to be; NaN where nothing was asked.
    """

    scene: str
    network: str = ""
    joints: tuple[str, ...] = PAPER14.keypoints
    must_mm: float = float("nan")
    aim_mm: float = float("nan")


# the last six are judged by the worst of them
ACTIONS = ("squat", "reach", "wave", "overhead", "sit", "turn")
ROWS: Mapping[str, Row] = {
    "walk": Row(scene="walk", must_mm=11.5, aim_mm=10.0),
    "walk-best": Row(scene="walk", network=BEST, must_mm=10.0, aim_mm=8.5),
    "T-pose": Row(scene="T-pose", must_mm=8.0, aim_mm=6.0),
    "T-pose-occluded": Row(scene="T-pose-occluded", must_mm=11.0, aim_mm=8.0),
    "half-hidden": Row(scene="screen", joints=HIDDEN_JOINTS, must_mm=22.0),
    "false-arm": Row(scene="false_arm", joints=HIDDEN_JOINTS, must_mm=28.0),
    **{action: Row(scene=action, must_mm=13.0, aim_mm=10.0) for action in ACTIONS},
}


def scene_of(name: str, seed: int) -> Scene:
    """One body doing one thing; the rest of the scene is drawn by the same seed."""
    if name in ("screen", "false_arm"):
        scene = half_hidden_scene(name, _HIDDEN_S, _HIDDEN_HZ)
        person = replace(scene.people[0], body=replace(scene.people[0].body, random_seed=seed))
        return replace(scene, people=(person,), seed=seed)
    still = name.startswith("T-pose")
    content = {
        "duration_s": 0.5 if still else 10.0 if name == "walk" else 3.0,
        "rate_hz": 10,
        "seed": seed,
        "cameras": ring(8, 60.0) if still else ring(4, 66.0),
        "people": [{"body": {"random_seed": seed}, "motion": _motion(name, seed)}],
        "occluders": list(_OCCLUDERS) if name == "T-pose-occluded" else [],
    }
    return settings_from_mapping(content, Scene, where=f"{name} {seed}")


def _motion(name: str, seed: int) -> dict[str, Any]:
    """Where a person faces, with which arm, and how fast, differ from body to body."""
    rng = np.random.default_rng([seed, 5])
    heading, side, pace = float(rng.uniform(0, 360)), _SIDES[int(rng.integers(2))], float(rng.uniform(0.85, 1.15))
    if name == "walk":
        return _WALK
    if name.startswith("T-pose"):
        return {"kind": "tpose", "heading_deg": heading}
    if name == "idle":
        return {"kind": "idle", "heading_deg": heading}
    period_s = {"squat": 2.7, "reach": 1.5, "wave": 0.9, "overhead": 2.6, "sit": 3.0, "turn": 4.0}[name] * pace
    one_arm = {"side": side} if name in ("reach", "wave") else {}
    return {"kind": name, "heading_deg": heading, "period_s": period_s, **one_arm}
