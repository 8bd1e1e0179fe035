"""T-pose among eight cameras, free and occluded: what weights do (the paper's table of static accuracy)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from paper.scenes import paper
from paper.scenes.scenes import static_scene
from posefuse.evaluation import JointErrors
from posefuse.formats.page import Block, Heading, Images, Note, Table

from .runs import Context, Outcome, Run, best_errors, other_bodies, run_scene
from .tables import CHECKED, drawn_images, errors_row, joint_rows, shown

TITLES = {"free": "No occlusion", "occluded": "Occluded by walls, boxes and clutter"}
_QUICK_S, _FULL_S, _CHECK_S = 0.3, 3.0, 1.0


def run(context: Context) -> Outcome:
    """Both cases with every weighting, and with other bodies as a check."""
    figures: dict[str, Any] = {}
    blocks: list[Block] = []
    for case, title in TITLES.items():
        scene = static_scene(case == "occluded", 1, _QUICK_S if context.quick else _FULL_S)
        done = run_scene(f"static-{case}-1", scene, context)
        best = best_errors(f"static-{case}-1", scene, context)
        figures[case] = {name: errors_row(errors) for name, errors in (_columns(done) | best).items()}
        around = [place * len(done.recording.rig) // 8 for place in (0, 3, 6)]
        blocks += [Heading(title), Images({k: v for c in around for k, v in drawn_images(done, c, [0], 400).items()})]
    if not context.quick:
        figures["check"] = {case: _check(case, context) for case in TITLES}
    return Outcome("Static accuracy: what weights do", figures, blocks)


def _columns(done: Run) -> dict[str, JointErrors]:
    return {
        **{weights: done.errors(weights, smoothed=False, centred=False) for weights in ("none", "score", "all", "robust")},
        "robust + centres": done.errors(smoothed=False),
        "default": done.default_errors(),
    }


def _check(case: str, context: Context) -> dict[str, Any]:
    """Other bodies and other clutter, mm."""
    errors = other_bodies(f"static-{case}", lambda seed: static_scene(case == "occluded", seed, _CHECK_S), context)
    return {seed: {what: one.mpjpe_mm for what, one in columns.items()} for seed, columns in errors.items()}


def report(figures: Mapping[str, Any]) -> list[Block]:
    """Means, other bodies, and the paper's tables."""
    rows: list[list[Any]] = []
    blocks: list[Block] = []
    for case, title in TITLES.items():
        for name, column in figures[case].items():
            rows.append([f"{case}, {name}", column["mean_mm"], column["worst_mm"], paper.STATIC_AVERAGE[case].get(name)])
        for what in CHECKED:
            seeds = [one[what] for one in figures.get("check", {}).get(case, {}).values() if what in one]
            if seeds:
                rows.append([f"{case}, {what}, other bodies", ", ".join(f"{mm:.1f}" for mm in seeds), None, None])
        blocks += [
            Note(f"{title}, per joint, mean ± standard deviation:"),
            Table(*joint_rows(shown(figures[case]), paper.STATIC[case])),
        ]
    return [Heading("T-pose, eight cameras"), Table(["", "mean", "worst joint", "paper"], rows), *blocks]
