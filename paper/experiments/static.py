"""T-pose among eight cameras, free and occluded: what weights do (the paper's table of static accuracy)."""

from __future__ import annotations

from typing import Any

import numpy as np

from paper.scenes import paper
from paper.scenes.scenes import CHECK_SEEDS, static_scene
from posefuse.evaluation import JointErrors
from posefuse.formats.page import Block, Heading, Images, Page, Table

from .runs import Context, Outcome, Run, best_errors, other_bodies, run_scene
from .tables import LANDMARKS, drawn_images, errors_row, joint_rows

TITLES = {"free": "No occlusion", "occluded": "Occluded by walls, boxes and clutter"}
_QUICK_S, _FULL_S, _CHECK_S = 0.3, 3.0, 1.0


def run(context: Context) -> Outcome:
    """Both cases with every weighting, and with other bodies as a check."""
    blocks: list[Block] = [
        Heading(
            "What is measured",
            "T-pose between eight cameras on a circle of 4.5 m. Nothing moves: time steps differ by sensor noise and coding, "
            "so ± is the repeatability of an estimate, and a longer recording gives the same. One body in one posture does not "
            "stand for others: see the other bodies below.",
        )
    ]
    figures: dict[str, Any] = {}
    for case, title in TITLES.items():
        scene = static_scene(case == "occluded", 1, _QUICK_S if context.quick else _FULL_S)
        done = run_scene(f"static-{case}-1", scene, context)
        best = best_errors(f"static-{case}-1", scene, context)
        columns = {name: errors_row(errors) for name, errors in (_columns(done) | best).items()}
        figures[case] = columns
        around = [place * len(done.recording.rig) // 8 for place in (0, 3, 6)]
        blocks += [
            Heading(title, f"{len(done.recording.poses)} time steps. {LANDMARKS}"),
            Table(*joint_rows(columns, paper.STATIC[case])),
            Images({k: v for c in around for k, v in drawn_images(done, c, [0], 400).items()}),
        ]
    if not context.quick:
        figures["check"] = _check(context, blocks)
    return Outcome(figures, Page("Static accuracy: what weights do", blocks))


def _columns(done: Run) -> dict[str, JointErrors]:
    return {
        **{weights: done.errors(weights, smoothed=False, centred=False) for weights in ("none", "score", "all", "robust")},
        "robust + centres": done.errors(smoothed=False),
        "default": done.default_errors(),
    }


def _check(context: Context, blocks: list[Block]) -> dict[str, Any]:
    """The default on other bodies and other clutter."""
    found: dict[str, Any] = {}
    for case in TITLES:
        errors = other_bodies(f"static-{case}", lambda seed, case=case: static_scene(case == "occluded", seed, _CHECK_S), context)
        found[case] = {seed: {what: one.mpjpe_mm for what, one in columns.items()} for seed, columns in errors.items()}
    rows = [
        [f"{case}, {what}", *(found[case][str(seed)][what] for seed in CHECK_SEEDS)]
        for case in TITLES
        for what in found[case][str(CHECK_SEEDS[0])]
    ]
    blocks += [
        Heading("Other bodies", "Mean over 14 joints, mm. Bodies drawn by these seeds; clutter drawn again."),
        Table(["case", *(f"seed {seed}" for seed in CHECK_SEEDS), "mean"], [[*row, float(np.mean(row[1:]))] for row in rows]),
    ]
    return found
