"""A random walk among four cameras (the paper's walking experiment)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from paper.scenes import paper
from paper.scenes.scenes import walking_scene
from posefuse.core import PAPER14
from posefuse.evaluation import typical_nees
from posefuse.formats.page import Block, Heading, Images, Note, Plots, Table

from .runs import Context, Outcome, best_errors, other_bodies, run_scene
from .tables import CHECKED, drawn_images, errors_row, joint_rows, shown, trajectories

_SHOWN = ("right_wrist", "left_hip", "left_ankle")
# joints that have a covariance of their own
_ASKED = tuple(joint for joint in PAPER14.keypoints if joint not in ("neck", "mid_hip"))
_QUICK_S, _FULL_S, _CHECK_S = 2.0, 60.0, 12.0
_MOMENTS = 6
_STATED = {"paper: all": (paper.WALKING_MEAN, paper.WALKING_BEST, paper.WALKING_WORST)}
_SHOWN_S = 12.0


def run(context: Context) -> Outcome:
    """Errors per joint and weighting, trajectories against the truth, six moments."""
    scene = walking_scene(1, _QUICK_S if context.quick else _FULL_S)
    done = run_scene("walking-1", scene, context)
    columns = {
        **{weights: done.errors(weights, smoothed=False, centred=False) for weights in ("none", "score", "all", "robust")},
        "robust, smoothed": done.errors(centred=False),
        "robust + centres": done.errors(smoothed=False),
        "default": done.default_errors(),
        **best_errors("walking-1", scene, context),
    }
    figures: dict[str, Any] = {"columns": {name: errors_row(errors) for name, errors in columns.items()}}
    figures["nees"] = {
        name: typical_nees(done.poses(smoothed=smoothed), done.truth, _ASKED)
        for name, smoothed in (("time step by time step", False), ("smoothed", True))
    }
    if not context.quick:
        errors = other_bodies("walking", lambda seed: walking_scene(seed, _CHECK_S), context)
        figures["check"] = {seed: {what: errors_row(one) for what, one in each.items()} for seed, each in errors.items()}
    moments = np.linspace(0, len(done.recording.poses) - 1, _MOMENTS + 2).astype(int)[1:-1].tolist()
    blocks: list[Block] = [
        Heading("Trajectories against the truth", f"Default result; the first {_SHOWN_S:g} s."),
        Plots(trajectories(done, _SHOWN, {"estimate": done.recording.poses}, _SHOWN_S), small=True),
        Heading("Six moments", "The default result."),
        Images(drawn_images(done, 0, moments, 420)),
    ]
    return Outcome("Walking between four cameras", figures, blocks)


def report(figures: Mapping[str, Any]) -> list[Block]:
    """Means, other bodies and paths, errors per joint, and whether the stated uncertainty is right."""
    columns = dict(figures["columns"])
    for what in CHECKED:
        found = {seed: one[what] for seed, one in figures.get("check", {}).items() if what in one}
        columns |= {f"{what}, body and movement of seed {seed}": one for seed, one in found.items()}
    rows = [[name, one["mean_mm"], one["worst_mm"], one["worst_joint"].replace("_", " ")] for name, one in columns.items()]
    stated = ", ".join(f"{value:.1f} {name}" for name, value in figures["nees"].items())
    return [
        Heading("Walking, four cameras"),
        Table(["", "mean", "worst joint", "which"], [*rows, ["paper", paper.WALKING_MEAN, paper.WALKING_WORST, None]]),
        Note("Per joint, mean ± standard deviation:"),
        Table(*joint_rows(shown(figures["columns"]), {}, _STATED)),
        Note(f"Stated uncertainty against these errors (typical NEES; 3 is right, more is overconfident): {stated}."),
    ]
