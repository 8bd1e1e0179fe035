"""Three paths, compared with a simulated inertial suit: what drifts and what does not (the paper's comparison with a suit)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from paper.scenes.inertial import Drift, SuitNoise, drift, suit_joints
from paper.scenes.scenes import PATHS, path_scene
from posefuse.core import PAPER14, Array, pick_keypoints
from posefuse.evaluation import true_xyz_at
from posefuse.formats.page import Block, Facts, Heading, Images, Line, Plot, Plots, Table

from .runs import Context, Outcome, run_scene
from .tables import drawn_images

_QUICK_S, _FULL_S = 2.0, 40.0
_SUIT_SEEDS = 20
_PELVIS = PAPER14.keypoints.index("mid_hip")


def run(context: Context) -> Outcome:
    """Pelvis of all three paths from cameras and from the suit."""
    noise = SuitNoise()
    blocks: list[Block] = [Heading("The suit"), Facts({name: f"{value:g}" for name, value in vars(noise).items()})]
    figures: dict[str, Any] = {"paths": {}, "suit": vars(noise), "suits": _SUIT_SEEDS}
    for path in PATHS:
        done = run_scene(f"drift-{path}", path_scene(path, _QUICK_S if context.quick else _FULL_S), context)
        poses, truth = done.recording.poses, done.truth
        inside = (poses.t_ns >= truth.t_ns[0]) & (poses.t_ns <= truth.t_ns[-1])
        t_ns = poses.t_ns[inside]
        true = pick_keypoints(true_xyz_at(truth, t_ns)[:, 0], truth.skeleton, ["mid_hip"])[:, 0]
        seen = pick_keypoints(poses.xyz_world[inside, 0], poses.skeleton, ["mid_hip"])[:, 0]
        exact = pick_keypoints(truth.xyz_world[:, 0], truth.skeleton, ["mid_hip"])[:, 0]
        suits = [suit_joints(truth, noise, seed)[:, _PELVIS] for seed in range(_SUIT_SEEDS)]
        ends = [drift(suit, exact).end_m for suit in suits]
        suit = suits[int(np.argsort(ends)[len(ends) // 2])]
        vision = drift(seen, true)
        worn = drift(suit, exact)
        of_vision, of_suit = ({"drift_mm_per_m": one.mm_per_m, "end_m": one.end_m} for one in (vision, worn))
        figures["paths"][path] = {
            "distance_m": float(vision.walked_m[-1]),
            "vision": {**of_vision, "mean_mm": 1000 * float(np.nanmean(vision.error_m))},
            "suit": {**of_suit, "end_m_of_all": [float(np.min(ends)), float(np.max(ends))]},
        }
        drawn = _drawn(true, seen, suit, vision, worn)
        moments = [len(poses) // 3, 2 * len(poses) // 3]
        blocks += [Heading(path.replace("_", " ")), Plots(drawn), Images(drawn_images(done, 0, moments, 380))]
    return Outcome("Drift: cameras compared with an inertial suit", figures, blocks)


def report(figures: Mapping[str, Any]) -> list[Block]:
    """Path, metres walked, drift of cameras and suit, error at the end of both in mm."""
    columns = ["path", "walked m", "drift mm per m", "suit: drift mm per m", "error at the end mm", "suit: error at the end mm"]
    rows = []
    for path, one in figures["paths"].items():
        both = one["vision"], one["suit"]
        drifts, ends = [each["drift_mm_per_m"] for each in both], [1000 * each["end_m"] for each in both]
        rows.append([path.replace("_", " "), one["distance_m"], *drifts, *ends])
    return [Heading("Drift on three paths, compared with a simulated inertial suit"), Table(columns, rows)]


def _drawn(true: Array, seen: Array, suit: Array, vision: Drift, worn: Drift) -> list[Plot]:
    paths = [Line(name, xyz[:, 0], xyz[:, 1]) for name, xyz in (("truth", true), ("cameras", seen), ("suit", suit))]
    error = [
        Line("cameras", vision.walked_m, 1000 * vision.error_m, colour="c1"),
        Line("suit", worn.walked_m, 1000 * worn.error_m, colour="c2"),
    ]
    return [
        Plot("From above", paths, x_label="x, m", y_label="y, m", equal=True),
        Plot("Error", error, x_label="distance walked, m", y_label="mm", from_zero=True),
    ]
