"""What the error depends on, on oracle detections."""

from __future__ import annotations

from typing import Any

import numpy as np

from paper.scenes.page import Line, Page, plot
from paper.scenes.scaling import BIAS_SHARE, ERROR_SHARE, OUTLIER_SHARE, STUDIES, SWAP_SHARE, run_study, study_figures

from .runs import Context, Outcome

_LINES = {
    "robust_mm": "robust",
    "p95_mm": "robust, p95",
    "robust_same_mm": "robust, points both give",
    "score_same_mm": "score, points both give",
}
_SHARES = {"robust_found": "robust", "score_found": "score"}
SUMMARY = "error over number of cameras, distance, resolution, calibration error, clocks, dropped frames, outliers"


def run(context: Context) -> Outcome:
    """All studies."""
    studies: dict[str, Any] = {}
    with context.terminal.progress("studies") as advance:
        for i, name in enumerate(STUDIES):
            studies[name] = study_figures(run_study(name, context.quick, context.config.fuse))
            advance(i + 1, len(STUDIES))
    page = Page("What the error depends on")
    page.section(
        "Oracle detections",
        f"They err as the real network does on the walking session: {100 * ERROR_SHARE:.2f} % of the person's height in each "
        f"coordinate, {100 * BIAS_SHARE:.1f} % of it constant per camera and keypoint, {100 * OUTLIER_SHARE:g} % outliers, "
        f"{100 * SWAP_SHARE:g} % of views with left and right exchanged. One instant at a time, not smoothed. Weights are "
        "compared on the points that both give: with few views, score is silent about the difficult ones.",
    )
    page.plots(
        [
            plot(
                study["title"], study["title"], "mm",
                [Line(name, np.array(study["x"]), np.array(study[key])) for key, name in
                 _LINES.items()],
                from_zero=True,
            )
            for study in studies.values()
        ]
    )  # fmt: skip
    for study in studies.values():
        page.section(study["title"])
        columns = [study["title"], *(f"{x:g}" for x in study["x"])]
        shares = [[f"{name}, % of points", *(100 * share for share in study[key])] for key, name in _SHARES.items()]
        page.table(columns, [*([f"{name}, mm", *study[key]] for key, name in _LINES.items()), *shares])
    return Outcome(files={"studies": studies}, failed=page)
