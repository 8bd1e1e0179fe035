"""What the error depends on, on oracle detections."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from paper.scenes.scaling import STUDIES, run_study, study_figures
from posefuse.formats.page import Block, Heading, Line, Note, Plot, Plots, Table

from .runs import Context, Outcome

_LINES = {
    "robust_mm": "robust",
    "p95_mm": "robust, p95",
    "robust_same_mm": "robust, common points",
    "score_same_mm": "score, common points",
}


def run(context: Context) -> Outcome:
    """All studies."""
    studies: dict[str, Any] = {}
    with context.console.stages() as report:
        for i, name in enumerate(STUDIES):
            studies[name] = study_figures(run_study(name, context.quick, context.config.fuse))
            report("studies", i + 1, len(STUDIES))
    return Outcome("What the error depends on", {"studies": studies}, [Plots([_plot(study) for study in studies.values()])])


def report(figures: Mapping[str, Any]) -> list[Block]:
    """Errors by what is changed."""

    def listed(study: Mapping[str, Any], key: str) -> str:
        return ", ".join(f"{x:g}: {mm:.1f}" for x, mm in zip(study["x"], study[key], strict=True))

    keys = ("robust_mm", "robust_same_mm", "score_same_mm")
    rows = [[study["title"], *(listed(study, key) for key in keys)] for study in figures["studies"].values()]
    about = (
        "Oracle detections, not smoothed; value: mm. Weights are compared on the points that both methods return: with few "
        "views score returns none for the difficult ones."
    )
    columns = ["", "robust", "robust, common points", "score, common points"]
    return [Heading("What the error depends on"), Note(about), Table(columns, rows, text=True)]


def _plot(study: dict[str, Any]) -> Plot:
    lines = [Line(name, np.array(study["x"]), np.array(study[key])) for key, name in _LINES.items()]
    return Plot(study["title"], lines, x_label=study["title"], y_label="mm", from_zero=True)
