"""A random walk among four cameras (the paper's walking experiment)."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from paper.scenes import paper
from paper.scenes.scenes import CHECK_SEEDS, walking_scene
from posefuse.core import PAPER14, Array, Pose3D
from posefuse.evaluation import typical_nees
from posefuse.formats.page import Block, Dots, Facts, Heading, Images, Page, Plot, Plots, Table
from posefuse.fusion import FuseSettings, fuse

from .runs import Context, Outcome, Run, best_errors, run_scene
from .tables import LANDMARKS, drawn_people, errors_row, joint_rows, trajectories

_SHOWN = ("right_wrist", "left_hip", "left_ankle")
# joints that have a covariance of their own
_ASKED = tuple(joint for joint in PAPER14.keypoints if joint not in ("neck", "mid_hip"))
_QUICK_S, _FULL_S, _CHECK_S = 2.0, 60.0, 12.0
_MOMENTS = 6
STATED = {"paper: all": (paper.WALKING_MEAN, paper.WALKING_BEST, paper.WALKING_WORST)}
_SHOWN_S = 12.0


def run(context: Context) -> Outcome:
    """Errors per joint and weighting, trajectories against the truth, rate of the fusion, six moments."""
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
    figures["fusion"], rates = _fusion(done)
    rate = Dots("rate", *rates)
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
        Heading("Rate of the fusion", "All keypoints of one time step solved, timed one after the other in one process."),
        Facts({"median": f"{figures['fusion']['median_ms']:.2f} ms per time step", "paper": f"< {paper.TRIANGULATE_MS:g} ms"}),
        Plots([Plot("Fusion", [rate], x_label="s of the walk", y_label="time steps per s", from_zero=True, wide=True)]),
        Heading("Six moments", "Blue: the default result. Red: the truth."),
        Images(drawn_people(done, 0, shown)),
    ]
    if not context.quick:
        figures["check"] = _check(context, blocks)
    return Outcome(figures, Page("Walking between four cameras", blocks))


def _fusion(done: Run) -> tuple[dict[str, float], tuple[Array, Array]]:
    views, rig, settings = done.recording.views, done.recording.rig, FuseSettings()
    previous: Pose3D | None = None
    seconds = []
    for i in range(len(views.t_ns)):
        began_s = time.perf_counter()
        previous = fuse(views.at(i), rig, settings, previous)
        seconds.append(time.perf_counter() - began_s)
    took = np.array(seconds)
    figures = {"median_ms": float(1000 * np.median(took)), "p99_ms": float(1000 * np.percentile(took, 99))}
    return figures, ((views.t_ns - views.t_ns[0]) / 1e9, 1 / took)


def _check(context: Context, blocks: list[Block]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for seed in CHECK_SEEDS:
        scene = walking_scene(seed, _CHECK_S)
        done = run_scene(f"walking-{seed}", scene, context)
        best = best_errors(f"walking-{seed}", scene, context)
        columns = {"landmarks": done.errors(centred=False), "default": done.default_errors(), **best}
        found[str(seed)] = {name: errors_row(errors) for name, errors in columns.items()}
    rows = [
        [f"{what}: {label}", *(found[str(seed)][what][key] for seed in CHECK_SEEDS)]
        for what in columns
        for label, key in (("mean over 14 joints", "mean_mm"), ("worst joint", "worst_mm"))
    ]
    blocks += [
        Heading("Other bodies and paths", f"{_CHECK_S:g} s each; mm."),
        Table(["", *(f"seed {seed}" for seed in CHECK_SEEDS), "mean"], [[*row, float(np.mean(row[1:]))] for row in rows]),
    ]
    return found
