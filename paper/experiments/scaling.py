"""What the error depends on, on oracle detections."""

from __future__ import annotations

from typing import Any

import numpy as np

from paper.scenes.scaling import BIAS_SHARE, ERROR_SHARE, OUTLIER_SHARE, STUDIES, SWAP_SHARE, run_study, study_figures
from posefuse.formats.page import Block, Heading, Line, Page, Plot, Plots, Table

from .runs import Context, Outcome

_LINES = {
    "robust_mm": "robust",
    "p95_mm": "robust, p95",
    "robust_same_mm": "robust, common points",
    "score_same_mm": "score, common points",
}
_SHARES = {"robust_found": "robust", "score_found": "score"}


def run(context: Context) -> Outcome:
    """All studies."""
    studies: dict[str, Any] = {}
    with context.console.progress("studies") as advance:
        for i, name in enumerate(STUDIES):
            studies[name] = study_figures(run_study(name, context.quick, context.config.fuse))
            advance(i + 1, len(STUDIES))
    blocks: list[Block] = [
        Heading(
            "Oracle detections",
            f"They err as the real network does on the walking session: {100 * ERROR_SHARE:.2f} % of the person's height in each "
            f"coordinate, {100 * BIAS_SHARE:.1f} % of it constant per camera and keypoint, {100 * OUTLIER_SHARE:g} % outliers, "
            f"{100 * SWAP_SHARE:g} % of views with left and right swapped. One time step at a time, not smoothed. Weights are "
            "compared on the points that both give: with few views, score leaves out the difficult ones.",
        ),
        Plots([_plot(study) for study in studies.values()]),
    ]
    for study in studies.values():
        columns = [study["title"], *(f"{x:g}" for x in study["x"])]
        shares = [[f"{name}, % of points", *(100 * share for share in study[key])] for key, name in _SHARES.items()]
        rows = [*([f"{name}, mm", *study[key]] for key, name in _LINES.items()), *shares]
        blocks += [Heading(study["title"]), Table(columns, rows)]
    return Outcome({"studies": studies}, Page("What the error depends on", blocks))


def _plot(study: dict[str, Any]) -> Plot:
    lines = [Line(name, np.array(study["x"]), np.array(study[key])) for key, name in _LINES.items()]
    return Plot(study["title"], lines, x_label=study["title"], y_label="mm", from_zero=True)
