"""A random walk among four cameras (the paper's walking experiment)."""

from __future__ import annotations

from typing import Any

import numpy as np

from paper.scenes import paper
from paper.scenes.scenes import CHECK_SEEDS, walking_scene
from posefuse.core import PAPER14
from posefuse.evaluation import typical_nees
from posefuse.formats.page import Block, Facts, Heading, Images, Page, Plots, Table

from .runs import Context, Outcome, best_errors, other_bodies, run_scene
from .tables import LANDMARKS, drawn_images, errors_row, joint_rows, trajectories

_SHOWN = ("right_wrist", "left_hip", "left_ankle")
# joints that have a covariance of their own
_ASKED = tuple(joint for joint in PAPER14.keypoints if joint not in ("neck", "mid_hip"))
_QUICK_S, _FULL_S, _CHECK_S = 2.0, 60.0, 12.0
_MOMENTS = 6
STATED = {"paper: all": (paper.WALKING_MEAN, paper.WALKING_BEST, paper.WALKING_WORST)}
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
    shown = np.linspace(0, len(done.recording.poses) - 1, _MOMENTS + 2).astype(int)[1:-1].tolist()
    blocks: list[Block] = [
        Heading(
            "Error per joint",
            f"{done.truth.t_ns[-1] / 1e9:.0f} s of walking. {LANDMARKS} The paper's text gives its average, best and "
            "worst joint; the others are in a figure only.",
        ),
        Table(*joint_rows(figures["columns"], {}, STATED)),
        Heading(
            "Stated uncertainty", "Typical squared error in units of the stated covariance: 3 is right, more is overconfident."
        ),
        Facts(figures["nees"]),
        Heading("Trajectories against the truth", f"Default result; the first {_SHOWN_S:g} s."),
        Plots(trajectories(done, _SHOWN, {"estimate": done.recording.poses}, _SHOWN_S), small=True),
        Heading("Six moments", "The default result."),
        Images(drawn_images(done, 0, shown, 420)),
    ]
    if not context.quick:
        figures["check"] = _check(context, blocks)
    return Outcome(figures, Page("Walking between four cameras", blocks))


def _check(context: Context, blocks: list[Block]) -> dict[str, Any]:
    errors = other_bodies("walking", lambda seed: walking_scene(seed, _CHECK_S), context)
    found = {seed: {what: errors_row(one) for what, one in columns.items()} for seed, columns in errors.items()}
    rows = [
        [f"{what}: {label}", *(found[str(seed)][what][key] for seed in CHECK_SEEDS)]
        for what in found[str(CHECK_SEEDS[0])]
        for label, key in (("mean over 14 joints", "mean_mm"), ("worst joint", "worst_mm"))
    ]
    blocks += [
        Heading("Other bodies and paths", f"{_CHECK_S:g} s each; mm."),
        Table(["", *(f"seed {seed}" for seed in CHECK_SEEDS), "mean"], [[*row, float(np.mean(row[1:]))] for row in rows]),
    ]
    return found
