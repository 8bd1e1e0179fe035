"""Half of the body hidden, a false arm in its place, compared with a simulated inertial suit (the paper's other comparison)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from paper.scenes.inertial import SuitNoise, suit_joints
from paper.scenes.scenes import HALF_HIDDEN, HIDDEN_JOINTS, half_hidden_scene
from posefuse.core import PAPER14, Truth, pick_keypoints
from posefuse.evaluation import JointErrors, summary, typical_nees
from posefuse.formats.page import Block, Heading, Images, Note, Plots, Table

from .runs import Context, Outcome, best_errors, run_scene
from .tables import drawn_images, errors_row, joint_rows, trajectories

TITLES = {
    "free": "No occlusion",
    "screen": "Screens hide the left half from two of four cameras",
    "false_arm": "Screens, and false arms in the colour of the shirt",
}
_QUICK_S, _FULL_S = 1.0, 10.0
_SUIT_SEEDS = 20
_FOLLOWED = "left_wrist"


def run(context: Context) -> Outcome:
    """Errors of every joint with no occlusion, screens, and false arms; compared with the suit."""
    blocks: list[Block] = []
    figures = {case: _case(case, context, blocks) for case in HALF_HIDDEN}
    return Outcome("Half of the body hidden: cameras compared with an inertial suit", figures, blocks)


def _case(case: str, context: Context, blocks: list[Block]) -> dict[str, Any]:
    scene = half_hidden_scene(case, _QUICK_S if context.quick else _FULL_S)
    done = run_scene(f"occlusion-{case}", scene, context)
    errors = {
        **{weights: done.errors(weights, smoothed=False, centred=False) for weights in ("score", "all", "robust")},
        "default": done.default_errors(),
        **best_errors(f"occlusion-{case}", scene, context),
        "suit": _suit_errors(done.truth),
    }
    columns = {name: errors_row(error) for name, error in errors.items()}
    nees = {
        "left arm and leg": typical_nees(done.recording.poses, done.truth, HIDDEN_JOINTS),
        "right arm and leg": typical_nees(done.recording.poses, done.truth, [j.replace("left", "right") for j in HIDDEN_JOINTS]),
    }
    followed = {"estimate": done.recording.poses, "weights all": done.poses("all", smoothed=False, centred=False)}
    middle = len(done.recording.poses) // 2
    blocks += [
        Heading(TITLES[case]),
        Table(*joint_rows(columns, {})),
        Plots(trajectories(done, (_FOLLOWED,), followed, scene.duration_s)),
        Images({k: v for c in range(len(done.recording.rig)) for k, v in drawn_images(done, c, [middle], 400).items()}),
    ]
    return {"columns": columns, "nees": nees}


def _suit_errors(truth: Truth) -> JointErrors:
    true = pick_keypoints(truth.xyz_world[:, 0], truth.skeleton, PAPER14.keypoints)
    apart = [np.linalg.norm(suit_joints(truth, SuitNoise(), seed) - true, axis=-1) for seed in range(_SUIT_SEEDS)]
    return summary(PAPER14.keypoints, 1000 * np.array(apart))


def report(figures: Mapping[str, Any]) -> list[Block]:
    """Case, which joints, and the mean of every column; and whether the stated uncertainty is right."""
    rows: list[list[Any]] = []
    for case, title in TITLES.items():
        for part, hidden in (("left arm and leg", True), ("other joints", False)):
            joints = [joint for joint in PAPER14.keypoints if (joint in HIDDEN_JOINTS) == hidden]
            means = [
                float(np.mean([column["joints"][joint]["mean_mm"] for joint in joints]))
                for column in figures[case]["columns"].values()
            ]
            rows.append([title, part, *means])
    nees = "; ".join(
        f"{title.lower()}: " + ", ".join(f"{value:.1f} {part}" for part, value in figures[case]["nees"].items())
        for case, title in TITLES.items()
    )
    return [
        Heading("Half of the body hidden, compared with a simulated inertial suit"),
        Note("Four cameras in the corners of a room; a person waves with the left arm. Mean error over joints."),
        Table(["", "joints", *figures["free"]["columns"]], rows),
        Note(f"Stated uncertainty of the default (typical NEES; 3 is right): {nees}."),
    ]
