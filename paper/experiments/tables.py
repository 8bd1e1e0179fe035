"""Errors per joint in the paper's layout, for pages and for text."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from paper.scenes.paper import Column
from posefuse.core import PAPER14
from posefuse.evaluation import JointErrors

LANDMARKS = (
    "none, score, all: the paper's weights on the landmarks as they are, time step by time step. robust: our fusion on the same. "
    "+ centres: landmarks moved to joint centres. default: that, smoothed over time, as `posefuse track` does with the "
    "settings named below. best networks: that, with the largest detector (of a long scene its first 20 s)."
)


def errors_row(errors: JointErrors) -> dict[str, Any]:
    """Plain figures of a column of the tables."""
    return {
        "mean_mm": errors.mpjpe_mm,
        "worst_joint": errors.joints[int(np.nanargmax(errors.mean_mm))],
        "worst_mm": float(np.nanmax(errors.mean_mm)),
        "found": float(errors.found.mean()),
        "joints": {
            joint: {"mean_mm": float(errors.mean_mm[i]), "sd_mm": float(errors.sd_mm[i]), "p95_mm": float(errors.p95_mm[i])}
            for i, joint in enumerate(errors.joints)
        },
    }


def joint_rows(
    columns: Mapping[str, Mapping[str, Any]],
    paper: Mapping[str, Column],
    stated: Mapping[str, tuple[float, float, float]] | None = None,
) -> tuple[list[str], list[list[str]]]:
    """Heads and rows of the paper's table: 14 joints with mean +- sd, then average, best and worst joint.

    Args:
        columns: ours, as `errors_row` gives them. paper: its columns, shown behind ours.
        stated: columns of which only average, best and worst are known.
    """
    ours = {
        name: {joint: (of["mean_mm"], of["sd_mm"]) for joint, of in column["joints"].items()} for name, column in columns.items()
    }
    known: dict[str, Column] = {**ours, **{f"paper: {name}": column for name, column in paper.items()}}
    stated = stated or {}
    rows = [
        [joint.replace("_", " "), *(_mean_sd(*column[joint]) for column in known.values()), *("–" for _ in stated)]
        for joint in PAPER14.keypoints
    ]
    sums = [[np.nanmean(means), np.nanmin(means), np.nanmax(means)] for means in map(_means, known.values())]
    for i, what in enumerate(("average", "best joint", "worst joint")):
        rows.append([what, *(f"{one[i]:.2f}" for one in (*sums, *stated.values()))])
    return ["joint (mm)", *known, *stated], rows


def _means(column: Column) -> list[float]:
    return [mean for mean, _ in column.values()]


def _mean_sd(mean: float | None, sd: float | None) -> str:
    return "–" if mean is None or sd is None or not np.isfinite(mean) else f"{mean:.1f} ± {sd:.1f}"
